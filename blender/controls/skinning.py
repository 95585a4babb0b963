"""Weights of a head's meshes for a rig that was placed in it: the skin by Blender's heat, other parts by their kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.heads.rig import HeadRig, Part
from ...core.mesh.surface import NearestPoints
from ...core.numeric.arrays import FloatArray, IntArray
from ..characters import objects_of, parts_of, read_kinds
from ..contexts import scene_of
from ..frames import to_blender
from ..meshes import armature_data, mesh_of, read_vertices

_PREFIX, _TONGUE = "DEF-", "DEF-tongue"
_LID, _LIP = "DEF-lid.", "DEF-lip."
_HEAD = "DEF-spine.006"
"""Bone that moves what no other does: hair, and skin that no heat reaches."""
_PARTS = {
    Part.EYE_RIGHT: "ORG-eye.R",
    Part.EYE_LEFT: "ORG-eye.L",
    Part.TEETH_UPPER: "ORG-teeth.T",
    Part.TEETH_LOWER: "ORG-teeth.B",
    Part.ON_HEAD: _HEAD,
}
"""Bones of parts within meshes."""
_OBJECTS = {
    "eye_right": "ORG-eye.R",
    "eye_left": "ORG-eye.L",
    "teeth_upper": "ORG-teeth.T",
    "teeth_lower": "ORG-teeth.B",
    "tongue": "ORG-tongue",
    "hair": "ORG-spine.006",
}
"""Bones of separate parts, by their key."""
_LEAST = 1e-3
"""Smallest weight."""
_REACHED = 0.01
"""Sum of the weights of a vertex from which heat has reached it."""
_NEAR = 0.3
"""Distance of skin from which skin without heat takes its weights, in eye distances."""
_WIDTH = 0.15
"""Width of the weights of bones where heat fails altogether, in eye distances."""


@dataclass(frozen=True)
class _Skin:
    """Vertices of the skin (S, 3) in Blender's axes, their weights (S, B), and the names of the B bones.

    `number` (V,) is the vertex of the skin of each vertex of the head's mesh, -1 for those of other parts.
    """

    vertices: FloatArray
    weights: FloatArray
    bones: list[str]
    number: IntArray

    def of_head(self, places: FloatArray) -> FloatArray:
        """Return the weights of the vertices of the head's mesh, at places (V, 3): lips that touch stay apart."""
        return np.asarray(np.where(self.number[:, None] < 0, self.near(places), self.weights[self.number]))

    def near(self, places: FloatArray) -> FloatArray:
        """Return the weights of the skin nearest to places, (N, B)."""
        found = NearestPoints(self.vertices).query(places)[0][:, 0]
        return np.asarray(self.weights[found])


def bind_to_rig(head: bpy.types.Object, armature: bpy.types.Object, rig: HeadRig) -> None:
    """Let the bones of Rigify's face, at rest, move the meshes of a head, and carry its parts."""
    skin = _skin(rig, armature)
    rigid = [obj for key, obj in parts_of(head).items() if key in _OBJECTS]
    for obj in [head, *(other for other in objects_of(head) if other not in rigid)]:
        _deform(obj, head, armature, skin)
    for key, obj in parts_of(head).items():
        if key in _OBJECTS:
            _carry(obj, armature, _OBJECTS[key])
    _parent(head, armature)
    for obj in objects_of(head):
        if obj.parent is None and obj not in rigid:
            _parent(obj, armature)
    bpy.context.view_layer.update()


def _skin(rig: HeadRig, armature: bpy.types.Object) -> _Skin:
    """Weight the skin of a head: by heat, and where that does not reach, as the nearest skin or the head itself."""
    alone, skin = rig.skin()
    vertices = np.asarray(to_blender(alone.vertices), dtype=np.float64)
    bones = [bone.name for bone in armature_data(armature).bones if bone.use_deform and bone.name.startswith(_PREFIX)]
    weights = _heat(vertices, _faces(alone), armature, bones)
    reached = weights.sum(axis=1) > _REACHED
    if not reached.any():
        weights = _by_distance(vertices, armature, bones, rig.eye_distance)
        reached = weights.sum(axis=1) > _REACHED
    if not reached.all():
        found, squared = NearestPoints(vertices[reached]).query(vertices[~reached])
        weights[~reached] = weights[reached][found[:, 0]]
        far = np.flatnonzero(~reached)[squared[:, 0] > (_NEAR * rig.eye_distance) ** 2]
        weights[far] = 0.0
        weights[far, bones.index(_HEAD)] = 1.0
    weights = _without_other_side(weights, bones, alone.region_weights)
    number = np.arange(len(vertices)) if skin is None else skin.number
    return _Skin(vertices, weights / weights.sum(axis=1, keepdims=True), bones, number)


def _without_other_side(weights: FloatArray, bones: list[str], regions: FloatArray) -> FloatArray:
    """Keep the bones of a lid or lip from the one on the other side of the slit, which may touch it.

    Regions are (3, V): upper, middle and lower. What no other bone moves is left as it is.
    """
    upper, middle, lower = np.asarray(regions, dtype=np.float64)
    others = {_LID + "T": middle + lower, _LID + "B": upper, _LIP + "T": lower, _LIP + "B": upper + middle}
    kept = weights.copy()
    for column, name in enumerate(bones):
        for start, other in others.items():
            if name.startswith(start):
                kept[:, column] *= np.clip(1.0 - other, 0.0, 1.0)
    lost = kept.sum(axis=1) < _LEAST
    kept[lost] = weights[lost]
    return kept


def _faces(alone: HeadRig) -> list[list[int]]:
    faces = np.empty((0, 3), dtype=np.intp) if alone.faces is None else np.asarray(alone.faces)
    return [[corner for corner in face if corner >= 0] for face in faces.tolist()]


def _heat(vertices: FloatArray, faces: list[list[int]], armature: bpy.types.Object, bones: Sequence[str]) -> FloatArray:
    """Return the automatic weights (V, B) of a mesh of its own; zeros where Blender finds none."""
    mesh = bpy.data.meshes.new("Facemime Skin")
    mesh.from_pydata(vertices.tolist(), [], faces)
    obj = bpy.data.objects.new("Facemime Skin", mesh)
    scene_of(armature).collection.objects.link(obj)
    obj.matrix_world = armature.matrix_world
    unused = _outside(vertices, armature, bones)
    try:
        for name in unused:
            armature_data(armature).bones[name].use_deform = False
        for other in bpy.context.view_layer.objects:
            other.select_set(other in (obj, armature))
        bpy.context.view_layer.objects.active = armature
        _parent_by_heat()
        return _weights_of(obj, bones)
    finally:
        for name in unused:
            armature_data(armature).bones[name].use_deform = True
        bpy.data.meshes.remove(mesh)


def _parent_by_heat() -> None:
    """Run Blender's automatic weights, which report an error if they find no solution for a bone."""
    try:
        bpy.ops.object.parent_set(type="ARMATURE_AUTO")
    except RuntimeError:
        return


def _outside(vertices: FloatArray, armature: bpy.types.Object, bones: Sequence[str]) -> list[str]:
    """Return bones that move no skin: of the tongue, and of a spine below a bust."""
    lowest = vertices[:, 2].min()
    rest = armature_data(armature).bones
    return [name for name in bones if name.startswith(_TONGUE) or rest[name].tail_local.z < lowest]


def _weights_of(obj: bpy.types.Object, bones: Sequence[str]) -> FloatArray:
    columns = {obj.vertex_groups[name].index: column for column, name in enumerate(bones) if name in obj.vertex_groups}
    weights = np.zeros((len(mesh_of(obj).vertices), len(bones)))
    for vertex in mesh_of(obj).vertices:
        for element in vertex.groups:
            if (column := columns.get(element.group)) is not None:
                weights[vertex.index, column] = element.weight
    return weights


def _by_distance(vertices: FloatArray, armature: bpy.types.Object, bones: Sequence[str], unit: float) -> FloatArray:
    """Weights (V, B) by the distance from each bone, where heat finds none."""
    weights = np.zeros((len(vertices), len(bones)))
    rest = armature_data(armature).bones
    for column, name in enumerate(bones):
        start, end = np.array(rest[name].head_local), np.array(rest[name].tail_local)
        along = end - start
        share = np.clip((vertices - start) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
        away = np.linalg.norm(vertices - start - share[:, None] * along, axis=1)
        weights[:, column] = np.exp(-np.square(away / (_WIDTH * unit)))
    return weights


def _deform(obj: bpy.types.Object, head: bpy.types.Object, armature: bpy.types.Object, skin: _Skin) -> None:
    """Weight a mesh, and let the armature deform it before it is subdivided."""
    places = np.asarray(to_blender(read_vertices(mesh_of(obj))), dtype=np.float64)
    matrix = np.array(head.matrix_world.inverted_safe() @ obj.matrix_world)
    placed = places @ matrix[:3, :3].T + matrix[:3, 3]
    weights = skin.of_head(placed) if obj == head else skin.near(placed)
    kinds, groups = read_kinds(mesh_of(obj)), dict[str, NDArray[np.float64]]()
    for part, bone in _PARTS.items():
        own = (kinds == part).astype(np.float64)
        if own.any():
            weights[own > 0.0] = 0.0
            groups[bone] = groups.get(bone, 0.0) + own
            armature_data(armature).bones[bone].use_deform = True
    for column, name in enumerate(skin.bones):
        groups[name] = groups.get(name, 0.0) + weights[:, column]
    for name, column_weights in groups.items():
        _write(obj, name, np.asarray(column_weights))
    modifier = obj.modifiers.new(armature.name, "ARMATURE")
    assert isinstance(modifier, bpy.types.ArmatureModifier)
    modifier.object = armature
    _before_subdivision(obj)


def _before_subdivision(obj: bpy.types.Object) -> None:
    """Move the last modifier before those that subdivide."""
    first = next((i for i, other in enumerate(obj.modifiers) if other.type in ("SUBSURF", "MULTIRES")), None)
    if first is not None:
        obj.modifiers.move(len(obj.modifiers) - 1, first)


def _write(obj: bpy.types.Object, name: str, weights: FloatArray) -> None:
    if (before := obj.vertex_groups.get(name)) is not None:
        obj.vertex_groups.remove(before)
    chosen = np.flatnonzero(weights > _LEAST)
    if len(chosen):
        group = obj.vertex_groups.new(name=name)
        for vertex, weight in zip(chosen.tolist(), weights[chosen].tolist(), strict=True):
            group.add([vertex], weight, "REPLACE")


def _carry(obj: bpy.types.Object, armature: bpy.types.Object, bone: str) -> None:
    """Parent a part to a bone, where it is."""
    placed = obj.matrix_world.copy()
    obj.parent, obj.parent_type, obj.parent_bone = armature, "BONE", bone
    bpy.context.view_layer.update()
    obj.matrix_world = placed


def _parent(obj: bpy.types.Object, armature: bpy.types.Object) -> None:
    """Let an object follow the armature, which follows what the object did."""
    if obj.parent is not None and armature.parent is None:
        armature.parent = obj.parent
        armature.matrix_parent_inverse = obj.parent.matrix_world.inverted_safe()
    obj.parent, obj.parent_type = armature, "OBJECT"
    obj.matrix_parent_inverse = armature.matrix_world.inverted_safe()

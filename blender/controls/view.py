"""The face as its rig shows it, in the axes of the head, while controls are moved."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.heads.rig import HeadRig, Part
from ...core.heads.symmetry import face_images, symmetry_of
from ...core.numeric.arrays import FloatArray, IntArray
from ..characters import members_of, objects_of, read_bones
from ..contexts import evaluated_depsgraph
from ..frames import from_blender
from ..meshes import mesh_of, posed_bones, rest_bones
from ..names import PART_PROPERTY

_OTHERS = 300
"""Vertices of the face that are looked at beside the landmarks."""
_MOST_OUTSIDE = 2000
"""Vertices outside the face that are looked at."""
_OF_EYE = 12
"""Vertices of an eyeball that are looked at."""
_INSIDE = 0.5
"""Sum of the weights of the regions from which a vertex is inside the face."""
_OUTSIDE = 0.02
"""Sum of the weights up to which a vertex is outside the face."""
_SHAPES = {"ARMATURE", "LATTICE", "MESH_DEFORM", "SURFACE_DEFORM", "HOOK", "SHRINKWRAP", "CORRECTIVE_SMOOTH", "SMOOTH"}
"""Modifiers that move vertices, which stay enabled; others may change their number."""


@dataclass(frozen=True)
class Seen:
    """Positions in the axes and the unit of the mesh: sampled vertices (S, 3), vertices inside (I, 3) and outside the
    face (O, 3), and of eyeballs, (E, 3); the pose of the head's bone, (4, 4).
    """

    face: FloatArray
    inside: FloatArray
    outside: FloatArray
    eyes: FloatArray
    head: FloatArray


class PosedFace:
    """A face as its rig shows it, without the motion of the bone of the head.

    Modifiers that make other vertices are disabled until `close`. Raises HeadError if the mesh has another number of
    vertices even so.
    """

    def __init__(self, head: bpy.types.Object, rig: HeadRig) -> None:
        self._head, self.unit = head.name, rig.eye_distance
        self.sample = sampled_vertices(rig)
        self.symmetry = symmetry_of(rig.vertices, rig.landmarks, self.sample)
        inside = rig.region_weights.sum(axis=0)
        self._inside = np.flatnonzero(inside > _INSIDE)
        self._outside = _spread(np.flatnonzero(inside <= _OUTSIDE), _MOST_OUTSIDE)
        self._count = len(rig.vertices)
        self._eyes = _eyes(head, rig)
        self._disabled = [
            (obj.name, modifier.name)
            for obj in [member.obj for member in members_of(head)]
            for modifier in obj.modifiers
            if modifier.show_viewport and modifier.type not in _SHAPES
        ]
        self._show(False)

    def close(self) -> None:
        """Enable what was disabled."""
        self._show(True)
        bpy.context.view_layer.update()

    def _show(self, shown: bool) -> None:
        for name, modifier in self._disabled:
            if (obj := bpy.data.objects.get(name)) is not None and modifier in obj.modifiers:
                obj.modifiers[modifier].show_viewport = shown

    @property
    def head(self) -> bpy.types.Object:
        """The head."""
        return bpy.data.objects[self._head]

    def look(self) -> Seen:
        """Evaluate the rig, and return what is seen."""
        bpy.context.view_layer.update()
        graph = evaluated_depsgraph(bpy.context)
        posed = _pose_of_head(self.head, graph)
        points = _points(self.head, graph)
        if len(points) != self._count:
            raise HeadError(
                "The modifiers of {name} change its number of vertices. Disable them in the viewport, and try again.",
                name=self._head,
            )
        back = np.array(posed.inverted_safe())
        to_head = posed.inverted_safe() @ self.head.matrix_world.inverted_safe()
        eyes = [np.empty((0, 3))]
        for name, chosen in self._eyes:
            if (obj := bpy.data.objects.get(name)) is not None and len(own := _points(obj, graph)) > chosen.max():
                matrix = np.array(to_head @ obj.evaluated_get(graph).matrix_world)
                eyes.append(_placed(matrix, own[chosen]))
        return Seen(
            from_blender(_placed(back, points[self.sample])),
            _placed(back, points[self._inside]),
            _placed(back, points[self._outside]),
            np.concatenate(eyes),
            np.array(posed),
        )


def look_at(head: bpy.types.Object, sample: IntArray) -> FloatArray | None:
    """Evaluate the rig, and return sampled vertices of a head, (S, 3), as `PosedFace` does, but with all its modifiers.

    Modifiers that add vertices are taken to add them behind those of the mesh, as subdivisions, mirrors and shells do.
    None if there are fewer.
    """
    bpy.context.view_layer.update()
    graph = evaluated_depsgraph(bpy.context)
    points = _points(head, graph)
    if len(points) < len(mesh_of(head).vertices):
        return None
    return from_blender(_placed(np.array(_pose_of_head(head, graph).inverted_safe()), points[sample]))


def seen_vertices(head: bpy.types.Object) -> NDArray[np.float32] | None:
    """Evaluate the rig, and return all vertices of a head, (A, 3), as `look_at` does."""
    bpy.context.view_layer.update()
    graph, found = evaluated_depsgraph(bpy.context), []
    back = _pose_of_head(head, graph).inverted_safe() @ head.matrix_world.inverted_safe()
    for member in members_of(head):
        points = _points(member.obj, graph)
        if len(points) != len(mesh_of(member.obj).vertices):
            return None
        found.append(_placed(np.array(back @ member.obj.evaluated_get(graph).matrix_world), points))
    return np.asarray(from_blender(np.concatenate(found)), dtype=np.float32)


def _points(obj: bpy.types.Object, graph: bpy.types.Depsgraph) -> NDArray[np.float64]:
    """Return the evaluated vertices of a mesh, (V, 3), in Blender's axes."""
    mesh = obj.evaluated_get(graph).data
    assert isinstance(mesh, bpy.types.Mesh)
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", flat)
    return flat.reshape(-1, 3).astype(np.float64)


def _placed(matrix: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _pose_of_head(head: bpy.types.Object, graph: bpy.types.Depsgraph) -> Matrix:
    """Return how the bone of a head moves its mesh, in the space of the mesh; identity without one."""
    armature, bones = read_bones(head)
    if armature is None or not bones.head:
        return Matrix.Identity(4)
    to_mesh = head.matrix_world.inverted_safe() @ armature.matrix_world
    rest, posed = rest_bones(armature)[bones.head], posed_bones(armature.evaluated_get(graph))[bones.head]
    return to_mesh @ posed.matrix @ rest.matrix_local.inverted_safe() @ to_mesh.inverted_safe()


def _eyes(head: bpy.types.Object, rig: HeadRig) -> list[tuple[str, IntArray]]:
    """Return vertices of the eyeballs: names of meshes, and indices."""
    found = []
    for member in members_of(head):
        kinds = rig.kinds[member.part]
        found += [(member.obj.name, np.flatnonzero(kinds == part)) for part in (Part.EYE_LEFT, Part.EYE_RIGHT)]
    others = {*head.children_recursive, *objects_of(head), *bpy.data.objects}
    for obj in sorted(others, key=lambda obj: obj.name):
        if str(obj.get(PART_PROPERTY, "")).startswith("eye") and obj.type == "MESH" and obj.visible_get():
            found.append((obj.name, np.arange(len(mesh_of(obj).vertices))))
    return [(name, _spread(vertices, _OF_EYE)) for name, vertices in found if len(vertices)]


def sampled_vertices(rig: HeadRig) -> IntArray:
    """Return the landmarks and other vertices of the face, spread evenly over its indices, (S,).

    Of a symmetric face, the others have their mirror images among them.
    """
    face = np.flatnonzero(rig.region_weights.sum(axis=0) > 0.0)
    images = face_images(rig.vertices, rig.landmarks, face)
    other = np.isin(face, rig.landmarks, invert=True)
    if images is None:
        chosen = _spread(face[other], _OTHERS)
    else:
        half = _spread(face[other & (face <= images)], _OTHERS // 2)
        chosen = np.union1d(half, images[np.searchsorted(face, half)])
    return np.asarray(np.concatenate([rig.landmarks, chosen]), dtype=np.intp)


def _spread(vertices: IntArray, most: int) -> NDArray[np.intp]:
    """Return at most `most` of some vertices."""
    chosen = np.linspace(0, len(vertices) - 1, most).astype(np.intp) if len(vertices) > most else slice(None)
    return np.asarray(vertices[chosen], dtype=np.intp)

"""Search for the parts of a character: the part to which each vertex of its meshes belongs, and its bones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.face.landmarks import JAW, NOSE, outer_eye_distance
from ...core.heads.hollow import hollow_rim
from ...core.heads.part_names import FaceBones, find_bones, named_part, names_body, names_brow, names_neck
from ...core.heads.proposal import propose_regions
from ...core.heads.rig import Part, Skin, neck_of, skin_of
from ...core.heads.sorting import Piece, lower_row, sort_pieces
from ...core.mesh.surface import NearestPoints, SurfaceGraph, border_twins, islands
from ...core.numeric.arrays import FloatArray, IntArray
from ..carriers import follows_head
from ..characters import (
    mesh_within,
    objects_of,
    parts_of,
    places_in,
    read_bones,
    read_kinds,
    write_bones,
    write_kinds,
)
from ..eye_bones import aim_of, looks_only, turned_by
from ..frames import to_blender
from ..meshes import (
    group_weights,
    mesh_of,
    posed_bones,
    read_faces,
    read_landmarks,
    read_places,
    read_vertices,
    rest_bones,
)
from ..names import HEAD_PROPERTY, PART_PROPERTY, PIVOT_PROPERTY
from ..part_order import remove_from_character
from .family import armature_of, copies_of, family_of, material_names

_FACE_LANDMARKS = np.concatenate([JAW, NOSE])
"""Landmarks that lie on the skin of any face."""
_MIN_ON_SKIN = 3
"""Minimum number of these on a piece that is skin."""
_STILL = 0.05
"""Sum of the region weights below which skin counts as still."""
_JOINED = 0.002
"""Distance from the skin, in outer-eye distances, below which a vertex coincides with it."""
_MIN_JOINED = 4
"""Minimum number of such vertices of a piece that is joined to the skin."""
_REACH = 1.5
"""Distance from the skin, in outer-eye distances, beyond which an object does not belong to a head."""
_OWN_SHARE = 0.5
"""Minimum share of the weights of a piece for a bone to be the bone of that piece."""


@dataclass(frozen=True)
class _Pieces:
    """Pieces of an object: number of the piece of each vertex (V,), and each piece."""

    obj: bpy.types.Object
    number: NDArray[np.intp]
    pieces: list[Piece]


def named_others(obj: bpy.types.Object) -> NDArray[np.bool_]:
    """Return (V,) whether the name of a vertex's material rules out skin, before landmarks are known."""
    kinds = _of_materials(obj, lambda name: named_part([name]) is not None)
    return kinds if not kinds.all() else np.zeros_like(kinds)


def brow_mesh(head: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices and faces of pieces that are named after the brows, as `part_mesh` does."""

    def named(obj: bpy.types.Object) -> NDArray[np.bool_]:
        on_skin = read_kinds(mesh_of(obj)) == Part.ON_SKIN
        chosen = on_skin if names_brow(obj.name) else on_skin & _of_materials(obj, names_brow)
        return np.asarray(chosen)

    return mesh_within(head, named)


def skin_of_object(obj: bpy.types.Object, others: NDArray[np.bool_], landmarks: IntArray | None = None) -> Skin:
    """Return the skin of `obj` without the vertices `others` (V,); see `core.heads.rig.skin_of`."""
    return skin_of(read_vertices(mesh_of(obj)), read_faces(mesh_of(obj)), others, landmarks)


def current_skin(obj: bpy.types.Object) -> Skin:
    """Return the skin of `obj` by its landmarks and stored parts; HeadError if a landmark lies on another part."""
    landmarks = read_landmarks(obj)
    skin = skin_of_object(obj, read_kinds(mesh_of(obj)) != Part.SKIN, landmarks)
    if (skin.number[landmarks] < 0).any():
        raise HeadError("Landmarks lie on parts that are not skin. Set these parts to Skin, or find the face again.")
    return skin


def open_border(obj: bpy.types.Object) -> IntArray:
    """Return the vertices of a head along its lips, (N,), if nothing is behind them; otherwise it is empty."""
    mesh, landmarks, skin = mesh_of(obj), read_landmarks(obj), current_skin(obj)
    places = read_vertices(mesh)
    apart = np.ones(len(places), dtype=bool)
    apart[skin.number >= 0] = False
    meshes = [other for other in (*objects_of(obj), *parts_of(obj).values()) if other.type == "MESH"]
    others = np.concatenate([places[apart], *(places_in(obj, other) for other in meshes)])
    graph = SurfaceGraph(places[skin.kept], skin.faces)
    rim = hollow_rim(graph, skin.number[landmarks], others)
    return np.flatnonzero(np.isin(skin.number, rim))


def sort_character(head: bpy.types.Object, landmarks: IntArray, weights: NDArray[np.floating[Any]], skin: Skin) -> None:
    """Sort the meshes of the character of `head` into parts, find its bones, and store both.

    The weights (3, U) are of the skin, as far as it is known.
    """
    vertices = read_vertices(mesh_of(head))
    points = vertices[landmarks].astype(np.float64)
    armature = armature_of(head)
    bones = bones_of(head, armature, landmarks)
    number, on_skin = _numbered(head, vertices, landmarks)
    sure = on_skin[number[skin.kept]] >= _MIN_ON_SKIN
    nearest = _SkinDistance(vertices[skin.kept[sure]], weights[:, sure], outer_eye_distance(points))
    copies = copies_of(head)
    names = [group.name for group in head.vertex_groups]
    of_face = {name for name in names if group_weights(head, name)[landmarks].mean() > _OWN_SHARE}
    groups = [
        _pieces_of(obj, head, landmarks if obj == head else None, nearest, of_face)
        for obj in dict.fromkeys([head, *family_of(head)])
        if obj == head or not (names_body(obj.name) or obj in copies)
    ]
    everything = [piece for group in groups for piece in group.pieces]
    parts = sort_pieces(everything, points)
    owners = [bone for group in groups for bone in _owners(group, armature, bones)]
    parts = [_by_bone(part, owner, bones) for part, owner in zip(parts, owners, strict=True)]
    turned = {part for part, owner in zip(parts, owners, strict=True) if owner and owner == _eye_bone(part, bones)}
    start = 0
    for group in groups:
        if group.obj == head or min(piece.away for piece in group.pieces) < _REACH:
            _store(group, parts[start : start + len(group.pieces)], head, points)
        start += len(group.pieces)
    bones = replace(
        bones,
        eye_right=bones.eye_right if Part.EYE_RIGHT in turned else "",
        eye_left=bones.eye_left if Part.EYE_LEFT in turned else "",
    )
    write_bones(head, armature if bones.head else None, bones)
    head[PIVOT_PROPERTY] = to_blender(neck_of(points)).tolist()


def sort_again(head: bpy.types.Object) -> None:
    """Sort the parts of a head whose landmarks are bound; raises HeadError if they are not."""
    landmarks = read_landmarks(head)
    skin = skin_of_object(head, named_others(head), landmarks)
    if (skin.number[landmarks] < 0).any():
        skin = skin_of_object(head, np.zeros(len(mesh_of(head).vertices), dtype=bool), landmarks)
    places = read_vertices(mesh_of(head))[skin.kept]
    sort_character(head, landmarks, propose_regions(places, skin.faces, skin.number[landmarks]), skin)


def is_sorted(head: bpy.types.Object) -> bool:
    """Return whether the parts of `head` were sorted, or changed by the user, before."""
    return PIVOT_PROPERTY in head


def forget_parts(head: bpy.types.Object) -> None:
    """Discard the parts and bones of `head`, so that binding finds them again; those of a built-in head are known."""
    for obj in (obj for obj in objects_of(head) if PART_PROPERTY not in obj):
        write_kinds(mesh_of(obj), np.zeros(len(mesh_of(obj).vertices), dtype=np.int8))
        remove_from_character(obj)
    write_kinds(mesh_of(head), np.zeros(len(mesh_of(head).vertices), dtype=np.int8))
    write_bones(head, None, FaceBones())
    if PIVOT_PROPERTY in head:
        del head[PIVOT_PROPERTY]


class _SkinDistance:
    """Distance of pieces from the skin of the face, whether the skin there moves, and whether they are joined to it."""

    def __init__(self, skin: FloatArray, weights: NDArray[np.floating[Any]], unit: float) -> None:
        self._nearest, self._moving, self._unit = NearestPoints(skin), weights.sum(axis=0) > _STILL, unit

    def of(self, points: FloatArray) -> tuple[float, bool, bool]:
        """Return the 90th percentile of the distances, in outer-eye distances, whether most skin there moves, and
        whether some points coincide with the skin.
        """
        found, squared = self._nearest.query(points)
        away = np.sqrt(np.maximum(squared[:, 0], 0.0)) / self._unit
        moving, joined = self._moving[found[:, 0]].mean() > 0.5, (away < _JOINED).sum() >= _MIN_JOINED
        return float(np.quantile(away, 0.9)), bool(moving), bool(joined)


def _pieces_of(
    obj: bpy.types.Object,
    head: bpy.types.Object,
    landmarks: IntArray | None,
    nearest: _SkinDistance,
    of_face: set[str],
) -> _Pieces:
    """Return the pieces of an object in the frame of `head`; those with landmarks are skin.

    `of_face` are the vertex groups that have the face as well, so that their names say nothing about pieces.
    """
    faces = read_faces(mesh_of(obj))
    places = places_in(head, obj)
    number, on_skin = _numbered(obj, places, landmarks)
    materials = _material_of_pieces(obj, faces, number)
    order = np.argsort(number, kind="stable")
    borders = np.searchsorted(number[order], np.arange(len(on_skin) + 1))
    # The name of the mesh with the face says nothing about its pieces: joined meshes keep the name of one of them.
    of_object = () if obj == head else (obj.name,)
    necks = _necks(obj, number, of_face)
    pieces = []
    for i, material in enumerate(materials):
        own = places[order[borders[i] : borders[i + 1]]]
        away, moving, joined = nearest.of(own)
        skin = bool(on_skin[i] >= _MIN_ON_SKIN) and named_part([material]) is None
        pieces.append(Piece(own, (material, *of_object, *necks[i]), skin, away, moving, joined))
    return _Pieces(obj, number, pieces)


def _necks(obj: bpy.types.Object, number: NDArray[np.intp], of_face: set[str]) -> list[list[str]]:
    """Return the names of the neck's vertex groups that have most of each piece, without those `of_face`."""
    sizes = np.maximum(np.bincount(number), 1)
    found: list[list[str]] = [[] for _ in sizes]
    for name in [group.name for group in obj.vertex_groups if names_neck(group.name) and group.name not in of_face]:
        for piece in np.flatnonzero(np.bincount(number, group_weights(obj, name)) / sizes > _OWN_SHARE):
            found[piece].append(name)
    return found


def _numbered(
    obj: bpy.types.Object, places: FloatArray, landmarks: IntArray | None
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the number of the piece of each vertex, (V,), and how many landmarks of the face each piece has."""
    faces = read_faces(mesh_of(obj))
    number = islands(len(places), faces, border_twins(places, faces, np.flatnonzero(named_others(obj))))
    count = int(number.max(initial=0)) + 1
    if landmarks is None:
        return number, np.zeros(count, dtype=np.intp)
    return number, np.bincount(number[landmarks[_FACE_LANDMARKS]], minlength=count)


def _faces_of(group: _Pieces, piece: int) -> IntArray:
    """Return the faces of a piece, as indices into its own vertices."""
    faces = read_faces(mesh_of(group.obj))
    own = np.append(np.cumsum(group.number == piece) - 1, -1)
    return np.asarray(own[faces[group.number[faces[:, 0]] == piece]])


def _store(group: _Pieces, parts: Sequence[Part | None], head: bpy.types.Object, points: FloatArray) -> None:
    """Store the part of each vertex of an object, and that it belongs to `head`."""
    kinds = np.array([Part.TEETH_UPPER if part is None else part for part in parts], dtype=np.int8)[group.number]
    for i in (i for i, part in enumerate(parts) if part is None):
        within = np.flatnonzero(group.number == i)
        kinds[within[lower_row(group.pieces[i].vertices, _faces_of(group, i), points)]] = Part.TEETH_LOWER
    write_kinds(mesh_of(group.obj), kinds)
    if group.obj != head:
        group.obj[HEAD_PROPERTY] = head


def _by_bone(part: Part | None, owner: str, bones: FaceBones) -> Part | None:
    """Return the part of a piece, given the bone that moves most of it; the bone of an eye makes it an eye."""
    if owner and owner in (bones.eye_right, bones.eye_left):
        return Part.EYE_RIGHT if owner == bones.eye_right else Part.EYE_LEFT
    return part


def _eye_bone(part: Part | None, bones: FaceBones) -> str:
    return "" if part is None else {Part.EYE_RIGHT: bones.eye_right, Part.EYE_LEFT: bones.eye_left}.get(part, "")


def _owners(group: _Pieces, armature: bpy.types.Object | None, bones: FaceBones) -> list[str]:
    """Return the bone that moves most of each piece; "" if there is none. Only bones of eyes are considered."""
    names = [name for name in (bones.eye_right, bones.eye_left) if name]
    if armature is None or not names:
        return [""] * len(group.pieces)
    turned = {name: turned_by(armature, name) for name in names}
    if group.obj.parent_type == "BONE":
        own = next((name for name in names if group.obj.parent_bone in turned[name]), "")
        if own:
            return [own] * len(group.pieces)
    shares = {name: np.sum([group_weights(group.obj, bone) for bone in turned[name]], axis=0) for name in names}
    count = len(group.pieces)
    sizes = np.maximum(np.bincount(group.number, minlength=count), 1)
    means = np.stack([np.bincount(group.number, shares[name], count) / sizes for name in names])
    best = means.argmax(axis=0)
    return [names[row] if mean > _OWN_SHARE else "" for row, mean in zip(best, means.max(axis=0), strict=True)]


def bones_of(head: bpy.types.Object, armature: bpy.types.Object | None, landmarks: IntArray) -> FaceBones:
    """Return the bones of the armature for head, eyes and jaw, except those that something else moves."""
    if armature is None:
        return FaceBones()
    free = [bone.name for bone in posed_bones(armature) if not bone.constraints or follows_head(bone)]
    weights: dict[str, float] = {}
    for vertex in (mesh_of(head).vertices[i] for i in landmarks.tolist()):
        for element in vertex.groups:
            name = head.vertex_groups[element.group].name
            if name in free:
                weights[name] = weights.get(name, 0.0) + element.weight
    if head.parent_type == "BONE" and head.parent_bone in free:
        weights.setdefault(head.parent_bone, 1.0)
    found = find_bones(free, weights)
    looking = [bone.name for bone in posed_bones(armature) if looks_only(bone)]
    turning = [*free, *(name for name in looking if aim_of(armature, name, found.head))]
    # A bone that moves no mesh is one at which an eye looks. In Rigify, that is `eye.L`, and `ORG-eye.L` moves the eye.
    moving, named = _bones_with_meshes(head), dict[str, str]()
    for name in sorted(turning, key=lambda name: not name.startswith("ORG-")):
        plain = name.removeprefix("ORG-")
        one = find_bones([plain], {})
        if (one.eye_right or one.eye_left) and not moving.isdisjoint(turned_by(armature, name)):
            named[plain] = name
    eyes = find_bones(list(named), {})
    return replace(found, eye_right=named.get(eyes.eye_right, ""), eye_left=named.get(eyes.eye_left, ""))


def held_by_head(obj: bpy.types.Object) -> NDArray[np.bool_] | None:
    """Return (V,) whether the bone of the head, or one below, moves most of a vertex; None if of none or of all."""
    armature = armature_of(obj)
    if armature is None or not (name := find_bones(list(rest_bones(armature).keys()), {}).head):
        return None
    bone = rest_bones(armature)[name]
    bones = [name, *(child.name for child in bone.children_recursive)]
    held = np.sum([group_weights(obj, each) for each in bones], axis=0) > _OWN_SHARE
    return None if held.all() or not held.any() else held


def _bones_with_meshes(head: bpy.types.Object) -> set[str]:
    """Return the names of bones that a mesh of the character names: by a group, as its parent, or in a constraint."""
    names: set[str] = set()
    for obj in {*family_of(head), *parts_of(head).values()}:
        names.update(group.name for group in obj.vertex_groups)
        names.update(getattr(constraint, "subtarget", "") for constraint in obj.constraints)
        names.add(obj.parent_bone if obj.parent_type == "BONE" else "")
    return names


def ensure_bones(head: bpy.types.Object) -> None:
    """Find the bones of head and eyes of a head that an armature deforms, unless they are known."""
    if read_bones(head)[0] is None and (armature := armature_of(head)) is not None:
        bones = bones_of(head, armature, read_places(head))
        write_bones(head, armature if bones.head else None, bones)


def _material_numbers(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    """Return (F,) the number of each face's material."""
    numbers = np.zeros(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", numbers)
    return numbers


def _of_materials(obj: bpy.types.Object, wanted: Callable[[str], bool]) -> NDArray[np.bool_]:
    """Return (V,) whether a vertex is of a face with a material whose name is `wanted`."""
    faces, kinds = read_faces(mesh_of(obj)), np.zeros(len(mesh_of(obj).vertices), dtype=bool)
    materials = np.array([wanted(name) for name in material_names(obj)] or [False])
    chosen = materials[np.minimum(_material_numbers(mesh_of(obj)), len(materials) - 1)]
    kinds[np.unique(faces[chosen][faces[chosen] >= 0])] = True
    return kinds


def _material_of_pieces(obj: bpy.types.Object, faces: IntArray, number: IntArray) -> list[str]:
    """Return the name of the material of most faces of each piece; "" if it has none."""
    names = material_names(obj) or [""]
    materials = np.minimum(_material_numbers(mesh_of(obj)), len(names) - 1)
    counts = np.zeros((int(number.max(initial=0)) + 1, len(names)), dtype=np.intp)
    np.add.at(counts, (number[faces[:, 0]], materials), 1)
    return [names[row] for row in counts.argmax(axis=1)]

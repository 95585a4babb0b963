"""Keys that turn the eyes of characters with keys for the whole face, if the eyes are separate meshes.

The files of phones' captures and many avatars rotate such eyes as objects, so that their keys move the lids alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import Message
from ...core.face.landmarks import MOUTH_CORNERS
from ...core.face.names import COEFFICIENTS
from ...core.heads.built_in import LOOK_ANGLES, LOOKS
from ...core.heads.eyeballs import part_eyeball
from ...core.heads.key_map import KeyMap
from ...core.heads.rig import Part
from ...core.heads.sorting import Piece, sort_pieces
from ...core.numeric.arrays import FloatArray
from ..characters import Member, members_of, places_in, read_bones, read_kinds, write_kinds
from ..meshes import group_weights, key_names, keys_of, mesh_of, posed_bones, read_places, read_vertices
from ..muting import animated_paths
from ..names import LOOKS_PROPERTY
from .expression_keys import add_keys
from .family import copies_of, family_of, material_names, moved_by_key

_LEAST = 8
"""Smallest number of vertices of an eye."""
_EYES = Part.EYE_RIGHT, Part.EYE_LEFT


def give_eyes_keys(head: bpy.types.Object, table: KeyMap | None) -> list[bpy.types.Object]:
    """Add keys to the separate eyes of a head that look where the keys of its mapping do; return these eyes.

    Eyes that their own keys, a bone or an armature turn are left as they are.
    """
    looks = [
        (row.key, *LOOK_ANGLES[place])
        for place, column in enumerate(LOOKS.tolist())
        for row in (() if table is None else table.rows)
        if row.source == COEFFICIENTS[column] and row.gain > 0.0
    ]
    if not looks or len({side for _, side, _, _ in looks}) < len(_EYES):
        return []
    found = list(_still_eyes(head, {name for name, *_ in looks}))
    for side in range(len(_EYES)):
        _turn_with(
            head, [(obj, own) for obj, own, of in found if of == side], [look for look in looks if look[1] == side]
        )
    return list(dict.fromkeys(obj for obj, _, _ in found))


def look_keys_note(eyes: Sequence[bpy.types.Object]) -> str:
    """Return a text that says which eyes were given keys; "" if none were."""
    if not eyes:
        return ""
    return Message("Shape keys were added that turn the eyes: {names}", names=", ".join(eye.name for eye in eyes))


def eyes_with_look_keys(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the separate eyes of a head to which Facemime added keys."""
    return [obj for obj in family_of(head) if LOOKS_PROPERTY in mesh_of(obj)]


def take_back_look_keys(head: bpy.types.Object) -> None:
    """Remove the keys that `give_eyes_keys` added, except those that the user has animated since."""
    for obj in eyes_with_look_keys(head):
        mesh = mesh_of(obj)
        added = str(mesh[LOOKS_PROPERTY]).split("\n")
        del mesh[LOOKS_PROPERTY]
        for name in (name for name in added if name in key_names(obj)):
            key = keys_of(obj).key_blocks[name]
            if not animated_paths(keys_of(obj), [key.path_from_id("value")]):
                obj.shape_key_remove(key)
        if mesh.shape_keys is not None and len(keys_of(obj).key_blocks) == 1:
            obj.shape_key_clear()


def _still_eyes(head: bpy.types.Object, looks: set[str]) -> Iterator[tuple[bpy.types.Object, NDArray[np.bool_], int]]:
    """Yield objects with vertices of an eye that nothing turns, which these are, (V,), and the side of the eye."""
    points = read_vertices(mesh_of(head))[read_places(head)].astype(np.float64)
    middle, bones, copies = float(points[MOUTH_CORNERS][:, 0].mean()), read_bones(head)[1], copies_of(head)
    turned = [bool(bones.eye_right), bool(bones.eye_left)]
    for obj in family_of(head):
        mesh = mesh_of(obj)
        if obj == head or obj in copies or mesh.library is not None or mesh.override_library is not None:
            continue
        if any(name in looks and moved_by_key(obj, name).any() for name in key_names(obj)):
            continue
        places, kinds, deformed = places_in(head, obj), read_kinds(mesh), _deformed(obj)
        for side, beside in enumerate((places[:, 0] <= middle, places[:, 0] > middle)):
            own = beside & ~deformed
            if own.sum() < _LEAST or turned[side]:
                continue
            if not (kinds[own] == _EYES[side]).all():
                piece = Piece(places[own], (*material_names(obj), obj.name))
                if sort_pieces([piece], points)[0] != _EYES[side]:
                    continue
            yield obj, own, side


def _deformed(obj: bpy.types.Object) -> NDArray[np.bool_]:
    """Return which vertices of a mesh an armature moves, (V,), if there is one with a bone for an eye."""
    found = np.zeros(len(mesh_of(obj).vertices), dtype=bool)
    armature = obj.find_armature()
    for bone in () if armature is None else posed_bones(armature).keys():
        if "eye" in bone.lower():
            found |= group_weights(obj, bone) > 0.0
    return found


def _turn_with(
    head: bpy.types.Object,
    eyes: list[tuple[bpy.types.Object, NDArray[np.bool_]]],
    looks: list[tuple[str, int, int, float]],
) -> None:
    """Add keys, given by name, side, axis and angle, to the objects of an eye, all about the centre of the largest."""
    if not eyes:
        return
    places = {obj: places_in(head, obj)[own] for obj, own in eyes}
    largest = max(places, key=lambda obj: float(np.ptp(places[obj], axis=0).max()))
    centre = part_eyeball(places[largest])[0][:3]
    for obj, own in eyes:
        kinds = read_kinds(mesh_of(obj))
        kinds[own] = _EYES[looks[0][1]]
        write_kinds(mesh_of(obj), kinds)
        offsets = np.zeros((len(looks), len(own), 3), dtype=np.float32)
        for row, (_, _, axis, angle) in enumerate(looks):
            offsets[row, own] = (places[obj] - centre) @ (_looking(axis, angle).T - np.eye(3))
        head_to = Member(obj, slice(0, len(own)), _axes(head, obj))
        names = [name for name, *_ in looks]
        former = set(key_names(obj)) - set(str(mesh_of(obj).get(LOOKS_PROPERTY, "")).split("\n"))
        add_keys(obj, names, head_to.local_offsets(offsets), ())
        if added := [name for name in key_names(obj) if name not in former]:
            mesh_of(obj)[LOOKS_PROPERTY] = "\n".join(added)


def _axes(head: bpy.types.Object, obj: bpy.types.Object) -> FloatArray:
    """Return (3, 4) as in `Member` for an object of the face, which is one since its vertices are of an eye."""
    return next(member.to_mesh for member in members_of(head) if member.obj == obj)


def _looking(axis: int, angle: float) -> FloatArray:
    """Return the rotation (3, 3) of an eye that looks along an axis by an angle, in the head frame."""
    sine, cosine = np.sin(angle), np.cos(angle)
    if axis == 0:
        return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])

"""Landmarks of a bound mesh on the rims of its eyes, and on brows that are pieces of their own."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.face.landmarks import from_ibug
from ...core.heads.brows import place_on_brows
from ...core.heads.eyeballs import EYES
from ...core.heads.landmark_vertices import pulled_to_marks
from ...core.heads.portrait import lids_seen
from ...core.heads.rig import Part
from ...core.numeric.arrays import FloatArray, IntArray
from ..characters import part_mesh, read_kinds
from ..meshes import mesh_of, read_vertices
from .parts import brow_mesh, skin_of_object


def on_lids(
    head: bpy.types.Object, landmarks: IntArray, rotation: FloatArray, marks: dict[int, int]
) -> tuple[NDArray[np.intp], bool]:
    """Return the landmarks, with those of each eye moved to the rim of its lids and from there to the user's marks, and
    whether an eye is seen between its lids.
    """
    improved, seen = np.array(landmarks, dtype=np.intp), False
    eyes = [
        (part, lids, *part_mesh(head, part)) for part, lids in zip((Part.EYE_RIGHT, Part.EYE_LEFT), EYES, strict=True)
    ]
    if not any(len(faces) for *_, faces in eyes):
        return improved, seen
    skin = skin_of_object(head, read_kinds(mesh_of(head)) != Part.SKIN, landmarks)
    places = read_vertices(mesh_of(head))[skin.kept] @ rotation.T
    picked = dict(zip(from_ibug(list(marks)).tolist(), marks.values(), strict=True))
    for part, lids, eye, faces in eyes:
        if len(faces) == 0:
            continue
        found = lids_seen(places, skin.faces, eye @ rotation.T, faces, left=part == Part.EYE_LEFT)
        seen |= found is not None
        if found is not None and not np.isin(skin.kept[found], np.delete(improved, lids)).any():
            improved[lids] = skin.kept[found]
            own = {i: int(skin.number[picked[i]]) for i in lids.tolist() if i in picked}
            if own and (skin.number[improved] >= 0).all():
                pulled = pulled_to_marks(places, skin.faces, skin.number[improved], own, symmetric=False)
                improved = skin.kept[pulled]
    return improved, seen


def on_brows(head: bpy.types.Object, landmarks: IntArray, rotation: FloatArray) -> NDArray[np.intp]:
    """Return the landmarks, with those of each brow moved to it if it is a piece of its own and they lie beside it."""
    brows, faces = brow_mesh(head)
    if len(faces) == 0:
        return np.array(landmarks, dtype=np.intp)
    skin = skin_of_object(head, read_kinds(mesh_of(head)) != Part.SKIN, landmarks)
    if (skin.number[landmarks] < 0).any():
        return np.array(landmarks, dtype=np.intp)
    places = read_vertices(mesh_of(head))[skin.kept] @ rotation.T
    found = place_on_brows(places, skin.faces, skin.number[landmarks], brows @ rotation.T, faces)
    kept = found == skin.number[landmarks]
    return np.where(kept, landmarks, skin.kept[found])

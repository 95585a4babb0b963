"""The rig of a head, read from what is stored with its meshes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypedDict

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.face.landmarks import OUTER_EYE_CORNERS
from ..core.heads.eyeballs import LID_THICKNESS, fit_eyeball
from ..core.heads.regions import membership
from ..core.heads.rig import HeadRig, jaw_pivot_of, same_parts
from ..core.numeric.arrays import FloatArray
from .characters import part_eyeballs, read_parts
from .frames import from_blender
from .meshes import (
    driven_by_keys,
    eye_vertices,
    mesh_of,
    object_of,
    read_corners,
    read_faces,
    read_places,
    read_regions,
    read_selection,
    read_vertices,
    read_weights,
)
from .names import PART_PROPERTY
from .styles import read_style

_VERTICES_PER_CHECK = 2048


def read_rig(obj: bpy.types.Object | None) -> HeadRig:
    """Read the rig of `obj` from its meshes, their custom properties, attributes and vertex groups.

    Raises HeadError if it is not a mesh, or its landmarks or regions are missing or do not fit the mesh any more, and
    SourceError if an example by which it was taught is damaged.
    """
    obj = object_of(obj)
    faces = read_faces(mesh_of(obj))
    quick = _read_quick_parts(obj)
    weights = _least_regions(obj) if driven_by_keys(obj) else read_regions(obj)
    return HeadRig(**quick, region_weights=weights, faces=faces, parts=read_parts(obj), style=read_style(obj))


def _least_regions(obj: bpy.types.Object) -> NDArray[np.float32]:
    """Return regions, (3, V), of only the landmarks' vertices, for a head that only its keys drive."""
    own = membership()
    weights = np.zeros((len(own), len(mesh_of(obj).vertices)), dtype=np.float32)
    weights[:, read_places(obj)] = own / own.sum(axis=0)
    return weights


def rig_checks(obj: bpy.types.Object, rig: HeadRig) -> Iterator[bool]:
    """Compare an object with its rig in slices that run between two frames, and yield whether each is unchanged.

    Reading all weights of a dense mesh takes about 0.1 s, as Blender returns them one by one; a slice takes about 2 ms.
    Faces count as unchanged if their corners are. Raises HeadError as `read_rig` does.
    """
    mesh_of(obj)
    parts = read_parts(obj)
    yield same_parts(parts, rig.parts)
    # The size of eyes that have turned differs by rounding.
    quick: Mapping[str, Any] = {**_read_quick_parts(obj)}
    yield all(
        np.allclose(value, getattr(rig, name), rtol=1e-5, atol=1e-9)
        if name == "eyeballs" and len(value) == len(rig.eyeballs)
        else np.array_equal(value, getattr(rig, name))
        for name, value in quick.items()
    )
    if rig.faces is not None:
        faces = mesh_of(obj).polygons
        yield len(rig.faces) == len(faces) and np.array_equal(read_corners(mesh_of(obj)), rig.faces[rig.faces >= 0])
    if driven_by_keys(obj):
        return
    for first in range(0, len(rig.vertices), _VERTICES_PER_CHECK):
        mesh_of(obj)
        part = slice(first, first + _VERTICES_PER_CHECK)
        yield np.array_equal(read_weights(obj, part), rig.region_weights[:, part])


def _read_eyeballs(obj: bpy.types.Object, landmarks: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the centre and radius (E, 4) of a head's eyeballs, its children or parts of its mesh, in the head frame.

    The landmarks (66, 3) in the head frame distinguish the left eye of a mesh from the right one.
    """
    eyeballs = []
    for child in obj.children:
        if str(child.get(PART_PROPERTY, "")).startswith("eye") and isinstance(child.data, bpy.types.Mesh):
            within = child.matrix_parent_inverse @ child.matrix_basis
            radius = float(np.linalg.norm(read_vertices(child.data), axis=1).max(initial=0.0))
            eyeballs.append([*from_blender(np.array(within.translation)), radius * within.median_scale])
    points = read_vertices(mesh_of(obj))[eye_vertices(obj)].astype(np.float64)
    right, left = landmarks[OUTER_EYE_CORNERS].astype(np.float64)
    side = (points - (right + left) / 2.0) @ (left - right)
    for cut in (fit_eyeball(eye).tolist() for eye in (points[side < 0], points[side >= 0]) if len(eye) > 3):
        replaced = [ball for ball in eyeballs if np.linalg.norm(np.subtract(cut[:3], ball[:3])) < ball[3]]
        for ball in replaced:  # an eyeball in place of the surface, as far behind the lids
            ball[3] /= 1.0 - LID_THICKNESS
        if not replaced:
            eyeballs.append(cut)
    return np.array(eyeballs).reshape(-1, 4)


def _jaw_pivot(obj: bpy.types.Object, landmarks: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the pivot of the jaw, (3,): the origin of the lower teeth, or, without them, that of `jaw_pivot_of`."""
    for child in obj.children:
        if child.get(PART_PROPERTY) == "teeth_lower":
            return from_blender(np.array((child.matrix_parent_inverse @ child.matrix_basis).translation))
    return jaw_pivot_of(landmarks)


class _QuickParts(TypedDict):
    """Everything of a rig except regions, faces and other parts, which take long."""

    vertices: NDArray[np.float32]
    landmarks: NDArray[np.intp]
    jaw_pivot: NDArray[np.float64]
    eyeballs: NDArray[np.float64]
    control_points: NDArray[np.bool_] | None
    covariance: FloatArray | None


def _read_quick_parts(obj: bpy.types.Object) -> _QuickParts:
    landmarks = read_places(obj)
    selection = read_selection(mesh_of(obj))
    vertices = read_vertices(mesh_of(obj))
    return {
        "vertices": vertices,
        "landmarks": landmarks,
        "jaw_pivot": _jaw_pivot(obj, vertices[landmarks]),
        "eyeballs": np.concatenate([_read_eyeballs(obj, vertices[landmarks]), part_eyeballs(obj)]),
        "control_points": None if selection is None else selection.membership,
        "covariance": None if selection is None else selection.covariance,
    }

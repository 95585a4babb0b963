"""The place of a face on a mesh, from the motion of its shape keys alone (method.md, section 9.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.coefficient_names import FITTED
from ..face.landmarks import N_LANDMARKS
from ..face.rotation import fit_rotation
from ..heads.built_in import load_head
from ..mesh.nearest import NearestPoints
from ..numeric import linalg
from ..numeric.arrays import FloatArray

_MIN_KEYS = 3
"""Smallest number of keys that determine a place, a size and an attitude."""
_NEIGHBOURS = 32
"""Number of nearest vertices among which a free one is sought for a landmark."""


@dataclass(frozen=True)
class KeyedFace:
    """The place of a face on a mesh.

    Attributes
    ----------
    upright : (3, 3) float64
        Rotation by right angles from the axes of the mesh to those of the head frame.
    landmarks : (66,) intp
        Vertices near the landmarks, all different.
    """

    upright: FloatArray
    landmarks: NDArray[np.intp]


def face_from_keys(vertices: FloatArray, mixtures: FloatArray, offsets: Sequence[FloatArray]) -> KeyedFace:
    """Find the face of a mesh whose landmarks are unknown.

    Parameters
    ----------
    vertices : (V, 3) array
        Vertices in any unit; the axes may differ from those of the head frame by right angles.
    mixtures : (K, 52) array
        ARKit's units that each key resembles, as weights.
    offsets : sequence of (V, 3) array
        Displacements under each key at value 1.

    Returns
    -------
    KeyedFace
        The attitude of the face, and vertices at its landmarks.

    Raises
    ------
    HeadError
        If fewer than three keys move anything, or the mesh has too few vertices.

    Notes
    -----
    The mean place at which each key moves the mesh is compared with that of the same motion of the built-in head. The
    similarity that fits these places best carries the landmarks over.
    """
    head = load_head()
    units = head.units[FITTED].reshape(len(FITTED), -1)
    known, found = [], []
    for mixture, offset in zip(mixtures, offsets, strict=True):
        motion = (mixture[FITTED].astype(np.float32) @ units).reshape(-1, 3)
        if motion.any() and np.asarray(offset).any():
            known.append(_centre(head.vertices, motion))
            found.append(_centre(vertices, offset))
    if len(known) < _MIN_KEYS or len(vertices) < N_LANDMARKS:
        raise HeadError("Too few shape keys move the face to drive it by them. Use Find Face instead.")
    source, target = np.array(known), np.array(found)
    about, there = source.mean(axis=0), target.mean(axis=0)
    # Axes of files differ by right angles; the means of a few keys are too rough for more.
    turn = _by_right_angles(fit_rotation(source - about, target - there))
    turned = (source - about) @ turn.T
    # s = <R a, b> / |a|^2, as in `binding.align.similarity`.
    size = max(float((turned * (target - there)).sum() / np.square(turned).sum()), 1e-9)
    places = there + size * (head.vertices[head.landmarks] - about) @ turn.T
    return KeyedFace(turn.T, _different(vertices, places))


def _centre(vertices: FloatArray, motion: FloatArray) -> FloatArray:
    """Mean of the vertices (V, 3), weighted by how far each moves, (3,)."""
    weights = np.linalg.norm(np.asarray(motion, dtype=np.float64), axis=1)
    return np.asarray(weights @ np.asarray(vertices, dtype=np.float64) / weights.sum())


def _by_right_angles(rotation: FloatArray) -> FloatArray:
    """Return the nearest of the 24 rotations by right angles to a rotation (3, 3)."""
    signs = list(product((1.0, -1.0), repeat=3))
    turns = [np.diag(sign)[list(order)] for order in permutations(range(3)) for sign in signs]
    return np.asarray(max((t for t in turns if linalg.det(t) > 0), key=lambda t: float((t * rotation).sum())))


def _different(vertices: FloatArray, places: FloatArray) -> NDArray[np.intp]:
    """Choose a vertex near each place, (66,), none of them twice."""
    found, _ = NearestPoints(vertices).query(places, min(_NEIGHBOURS, len(vertices)))
    taken: dict[int, None] = {}
    for row in found.tolist():
        taken[next(vertex for vertex in (*row, *range(len(vertices))) if vertex not in taken)] = None
    return np.array(list(taken), dtype=np.intp)

"""Quality of shape keys that were made for a head, and the place of a face on a mesh, from the motion of its shape keys
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError, Message
from ..face.landmarks import EYE_LEFT, EYE_RIGHT, LIPS, N_LANDMARKS, lid_gaps, lip_gaps
from ..face.names import COEFFICIENT_INDEX, FITTED
from ..face.rotation import fit_rotation
from ..heads.built_in import load_head
from ..heads.rig import HeadRig
from ..mesh.surface import NearestPoints, triangulate
from ..mesh.triangles import crossing_pairs
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .key_sets import CLOSES, OPENS, RESTS, KeySet

_REACH = 0.2
"""Distance from the landmarks of lids and lips, in outer-eye distances, within which triangles are examined."""
_SHUT = 0.99
"""Weight of a blink above which a key counts as shutting the eye."""
_STILL = 1e-4
"""Motion in outer-eye distances below which a vertex counts as resting."""
_INSIDE = 0.02
"""Share of the radius by which a triangle has to be inside an eyeball, beyond its depth at rest, to be counted."""
_MIN_KEYS = 3
"""Smallest number of keys that determine a place, a size and an attitude."""
_NEIGHBOURS = 32
"""Number of nearest vertices among which a free one is sought for a landmark."""


_LIDS = {"eyeBlinkRight": slice(0, 2), "eyeBlinkLeft": slice(2, 4)}
"""Pairs of lid landmarks that each unit shuts."""


@dataclass(frozen=True)
class KeyQuality:
    """Figures of a key at value 1.

    Attributes
    ----------
    moved : float
        Largest displacement of a vertex, in outer-eye distances.
    eyes : float
        Remaining opening of the eyes that the key shuts, as a share of that at rest; NaN if it shuts none.
    lips : float
        Widest gap of the lips that the key seals, in outer-eye distances; NaN if it does not seal them. ARKit's
        mouthClose is measured together with jawOpen, for which it is made.
    crossing : int
        Number of triangles of lids and lips that pass through each other or an eyeball, but do not at rest.
    """

    name: str
    moved: float
    eyes: float
    lips: float
    crossing: int


def key_qualities(rig: HeadRig, keys: KeySet, motions: FloatArray) -> list[KeyQuality]:
    """Measure keys that were made by `expression_keys`, in the order of the set.

    The motions (K, A, 3) are displacements of all vertices at value 1, as in `HeadRig.all_vertices`.
    """
    alone, skin = rig.skin()
    measure, unit = _Measure(alone), rig.eye_distance
    qualities = []
    for name, mixture, motion in zip(keys.names, keys.mixtures, motions, strict=True):
        before = motions[keys.names.index(OPENS)] if name == CLOSES and OPENS in keys.names else np.zeros_like(motion)
        posed = before + motion
        own = posed if skin is None else posed[skin.kept]
        shut = [pairs for unit_name, pairs in _LIDS.items() if mixture[COEFFICIENT_INDEX[unit_name]] > _SHUT]
        moved = float(np.linalg.norm(motion, axis=1).max(initial=0.0)) / unit
        lips = measure.lips(own) if name == CLOSES or name in keys.sealed else np.nan
        qualities.append(KeyQuality(name, moved, measure.eyes(own, shut), lips, measure.crossing(own)))
    return qualities


def findings(qualities: Sequence[KeyQuality]) -> list[Message]:
    """Report how well keys shut eyes and lips, how much passes through, and which keys move nothing.

    Figures that no key has are left out, and so are keys of a face at rest.
    """
    found = []
    if eyes := [100 * q.eyes for q in qualities if not np.isnan(q.eyes)]:
        found.append(Message("Shut eyes stay open by {eyes:.1f} % at most", eyes=max(eyes)))
    if lips := [100 * q.lips for q in qualities if not np.isnan(q.lips)]:
        found.append(Message("Sealed lips stay apart by {lips:.1f} % of the eye distance at most", lips=max(lips)))
    worst = max(qualities, key=lambda quality: quality.crossing, default=None)
    if worst is not None and worst.crossing:
        found.append(
            Message(
                "{crossing} triangles at most pass through others, in {name}", crossing=worst.crossing, name=worst.name
            )
        )
    if still := [quality.name for quality in qualities if quality.moved == 0.0 and quality.name not in RESTS]:
        found.append(Message("Without motion: {names}", names=", ".join(still)))
    return found


class _Measure:
    """Measures the skin of a head under displacements (V, 3) of its vertices."""

    def __init__(self, skin: HeadRig) -> None:
        self._rest = np.asarray(skin.vertices, dtype=np.float64)
        self._landmarks, self._unit, self._eyeballs = skin.landmarks, skin.eye_distance, skin.eyeballs
        points = self._rest[skin.landmarks]
        faces = np.empty((0, 3), dtype=np.intp) if skin.faces is None else skin.faces
        _, squared = NearestPoints(points[np.concatenate([EYE_RIGHT, EYE_LEFT, LIPS])]).query(self._rest)
        near = squared[:, 0] < (_REACH * self._unit) ** 2
        triangles = triangulate(faces)
        self._triangles = triangles[near[triangles].any(axis=1)]
        moves = np.asarray(skin.region_weights).any(axis=0)
        self._resting = self._crossed(self._rest, moves[self._triangles].any(axis=1))

    def eyes(self, motion: FloatArray, shut: Sequence[slice]) -> float:
        """Remaining opening of the eyes with the given pairs of lids, as a share of that at rest; NaN for none."""
        if not shut:
            return float("nan")
        before, after = (lid_gaps((self._rest + moved)[self._landmarks]) for moved in (np.zeros_like(motion), motion))
        # An eye that is modelled shut has no opening, and counts as shut.
        shares = after / np.maximum(before, 1e-9 * self._unit)
        return float(max(np.maximum(shares[pairs], 0.0).max() for pairs in shut))

    def lips(self, motion: FloatArray) -> float:
        """Widest gap of the lips, in outer-eye distances."""
        return float(np.maximum(lip_gaps((self._rest + motion)[self._landmarks]), 0.0).max()) / self._unit

    def crossing(self, motion: FloatArray) -> int:
        """Number of triangles that pass through others or an eyeball, but do not at rest."""
        moves = (np.abs(motion) > _STILL * self._unit).any(axis=1)[self._triangles].any(axis=1)
        if not moves.any():
            return 0
        posed = self._rest + motion
        crossed = self._crossed(posed, moves) | self._inside(posed)
        return int((crossed & ~self._resting).sum())

    def _crossed(self, places: FloatArray, moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether each triangle passes through another, (T,)."""
        crossed = np.zeros(len(self._triangles), dtype=bool)
        crossed[crossing_pairs(places, self._triangles, moves)] = True
        return crossed

    def _inside(self, posed: FloatArray) -> NDArray[np.bool_]:
        """Whether the middle of each triangle lies inside an eyeball, and deeper than at rest, (T,)."""
        inside = np.zeros(len(self._triangles), dtype=bool)
        for x, y, z, radius in np.asarray(self._eyeballs, dtype=np.float64).reshape(-1, 4):
            before, after = (self._away(places, (x, y, z), self._triangles) for places in (self._rest, posed))
            inside |= (after < (1.0 - _INSIDE) * radius) & (after < before - _INSIDE * radius)
        return inside

    @staticmethod
    def _away(places: FloatArray, centre: tuple[float, float, float], triangles: IntArray) -> FloatArray:
        return np.asarray(np.linalg.norm(places[triangles].mean(axis=1) - centre, axis=1))


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
    """Find the face of a mesh whose landmarks are unknown from its keys' offsets (V, 3) at value 1.

    The mixtures (K, 52) are the weights of ARKit's units that each key resembles. The mean place at which each key
    moves the mesh is compared with that of the same motion of the built-in head. The similarity that fits these places
    best carries the landmarks over. The axes of the mesh may differ from those of the head frame by right angles.
    Raises HeadError if fewer than three keys move anything, or the mesh has too few vertices.
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

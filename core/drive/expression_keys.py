"""ARKit's face units on any head, from those of the built-in head (docs/method.md, section 9.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..deform.expressions import transferred
from ..deform.head_deformer import head_deformer
from ..deform.rbf import RBFDeformer
from ..heads.built_in import Head, load_head
from ..heads.eyeballs import EyeballContact
from ..heads.rig import HeadRig
from ..landmarks import CHIN, EYE_LEFT, EYE_RIGHT, LOWER_LIDS, UPPER_LIDS
from ..mesh.nearest import NearestPoints
from ..rotation import fit_rotation
from .parts import PartDriver

_STEPS = 2
"""Corrections of the landmarks, which the deformer meets only nearly."""
_REACH = 0.35
"""Outer-eye distances from the landmarks within which the carried motion counts."""
_OPEN = 1e-3
"""Opening of a lid, in outer-eye distances, below which it does not count as open at rest."""


def expression_keys(rig: HeadRig) -> tuple[tuple[str, ...], NDArray[np.float32]]:
    """Make the 52 face units for a head.

    Parameters
    ----------
    rig : HeadRig
        The head, with its eyes, teeth and other parts.

    Returns
    -------
    names : tuple of str
        ARKit's names, alphabetically.
    motions : (52, A, 3) float32
        Displacements of all vertices at value 1, as in `HeadRig.all_vertices`: head frame, unit of the mesh.

    Notes
    -----
    The motion of the built-in head is carried over by a warp of the landmarks. It is corrected by the deformer where
    landmarks have to meet: a lid closes by the same share of its opening as the built-in head's, and stays outside the
    eyeball. Lower teeth rotate with the chin about the hinge of the jaw, and eyes as the built-in head's do.
    """
    head, (alone, skin) = load_head(), rig.skin()
    deformer = head_deformer(alone)
    assert isinstance(deformer, RBFDeformer)
    motions = transferred(head.units, alone.vertices, alone.landmarks, alone.region_weights)
    contact = EyeballContact(alone.vertices, np.asarray(alone.region_weights).sum(axis=0), rig.eyeballs)
    points = np.asarray(alone.vertices, dtype=np.float64)[alone.landmarks]
    near = _near(np.asarray(deformer.rest), points, rig.eye_distance)
    for row, unit in enumerate(head.units):
        follows = deformer.deform(motions[row, alone.landmarks]) - deformer.rest
        motion = follows + near * (motions[row] - follows)
        for _ in range(_STEPS):
            missing = _lids(head, unit, points, motion[alone.landmarks])
            if not missing.any():
                break
            motion = motion + deformer.deform(missing) - deformer.rest
        posed = np.asarray(deformer.rest + motion, dtype=np.float32)
        contact.resolve(posed)
        motions[row] = posed - deformer.rest
    if skin is None:
        return head.unit_names, motions
    parts = PartDriver(rig, skin, alone)
    poses = [
        parts.pose(deformer.rest + motion, _jaw(rig, points, motion[alone.landmarks]), gaze) - parts.rest
        for motion, gaze in zip(motions, _gazes(head), strict=True)
    ]
    return head.unit_names, np.stack(poses)


def _near(vertices: FloatArray, points: FloatArray, unit: float) -> NDArray[np.float32]:
    """(V, 1) share of the carried motion: far from all landmarks, where the warp is a guess, the deformer leads."""
    _, squared = NearestPoints(points).query(vertices)
    return np.asarray(np.exp(-np.maximum(squared, 0.0) / (_REACH * unit) ** 2), dtype=np.float32)


def _lids(head: Head, unit: NDArray[np.float32], points: FloatArray, moved: FloatArray) -> FloatArray:
    """(66, 3) displacements that lids lack to open or close by the same share as those of the built-in head."""
    lacking = np.zeros_like(points)
    known = head.vertices[head.landmarks].astype(np.float64)
    after = known + unit[head.landmarks]
    for upper, lower in zip(UPPER_LIDS, LOWER_LIDS, strict=True):
        if not unit[head.landmarks[[upper, lower]]].any():
            continue
        rest = points[lower] - points[upper]
        gap = np.linalg.norm(rest)
        if gap < _OPEN * np.linalg.norm(points[EYE_LEFT].mean(axis=0) - points[EYE_RIGHT].mean(axis=0)):
            continue
        share = (after[lower] - after[upper]) @ (known[lower] - known[upper])
        share /= np.square(known[lower] - known[upper]).sum()
        along = rest / gap
        now = (points[lower] + moved[lower] - points[upper] - moved[upper]) @ along
        need = (share * gap - now) * along
        part = np.array([np.linalg.norm(unit[head.landmarks[i]]) for i in (upper, lower)])
        part /= part.sum()
        lacking[upper] -= part[0] * need
        lacking[lower] += part[1] * need
    return lacking


def _jaw(rig: HeadRig, points: FloatArray, moved: FloatArray) -> FloatArray:
    """(3, 3) rotation of the lower teeth about the hinge of the jaw."""
    chin = points[CHIN] - rig.jaw_pivot
    return fit_rotation(chin, chin + moved[CHIN])


def _gazes(head: Head) -> FloatArray:
    """(52, 2, 3, 3) rotations of the right and left eye under each unit of the built-in head."""
    turns = np.tile(np.eye(3), (len(head.unit_names), 2, 1, 1))
    for side, name in enumerate(("eye_right", "eye_left")):
        eye = next(part for part in head.parts if part.name == name)
        rest = (eye.vertices - eye.pivot).astype(np.float64)
        for row, unit in enumerate(eye.units):
            if unit.any():
                turns[row, side] = fit_rotation(rest, rest + unit)
    return turns

"""How far frames of a take are from rest, and what their faces are like at rest (method.md, section 4.1)."""

from __future__ import annotations

import numpy as np

from ..face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    LIPS,
    LOWER_LIPS,
    MOUTH_CORNERS,
    NOSE,
    UPPER_LIPS,
    eye_apertures,
    mouth_aperture,
)
from ..numeric.arrays import FloatArray, IntArray
from .face_space import load_face_space, without_similarity
from .take import Take

MAX_SHUT = 0.45
"""Largest opening of the eyes, relative to the neutral one, that can count as shut."""
_TURNED = 0.5
"""Angle in radians, of pitch and yaw together, at which the weight of a frame is 1/e."""
_MIN_TRUST = 1e-3
"""Smallest weight of a frame."""
_DOUBT = 0.2
"""Amount of expression, in eye distances, that a confidence of 0 counts as."""
_USUAL = 0.35
"""Largest share of a take in which brows are lower than at rest. From 0.3 to 0.35 the same moments are found."""
_LIDS = 0.5
"""Amount of expression, in eye distances, of lids that are open twice as far as usual. Lids move little, and yet
half-shut eyes are no neutral face."""
_LIDS_AT_REST = 0.1
"""Difference from the usual opening of the eyes, relative to it, that may be rest."""
_WEAK = 0.3
"""Activation up to which an expression may be the person's own face."""
_TOWARDS_MEAN = 0.5
"""Share of the way to the mean of people's faces, as far as expressions lead there, so that one that lasts does not
pass for rest. On the strangers' clips of `lab.bench.strangers`, the more the better the frames of different people
compare, on either half; beyond 0.5 the signs of the hand-labelled clips get worse, as a person's own brows pass for
expression."""
_FROWNS_FROM = 0.85
"""Activation of knitted brows, on both sides, from which they are more than the person's own face. Above it, MediaPipe
sees two to four times as much of a frown as below, on both halves of the strangers' clips; up to it, hardly any."""
_FROWNS_FULLY = 0.95
"""Activation from which the face certainly frowns."""
_LOW_COUNTS = 0.2
"""By how much smaller both may be if the brows are low and the lips do not smile. At rest, none of 108 people in studio
portraits has low brows and more than 0.6; those who smile in official ones have up to 0.87."""
_LOW = 0.015
"""Distance in eye distances below the mean face's from which brows are low. Of strangers whose activation is above 0.5,
those in whose eyes MediaPipe sees a frown are 0.014 to 0.021 below it, and the others 0.007 to 0.023 above."""
_FROWN_DOWN = 0.04
"""Distance in eye distances by which a certain frown lowers the brows at least: four fifths of *browDown*."""
_FROWN_IN = 0.02
"""Distance in eye distances by which it draws each of them in."""
_ALONG_EYE = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0 - 0.5
"""Places of an eye's landmarks between its corners, from the middle, in iBUG's order."""
_EYES_AND_BROWS = ((EYE_RIGHT, BROWS[:5]), (EYE_LEFT, BROWS[5:]))
"""The landmarks of each eye and of the brow above it."""
_SEALED = 0.1
"""Share of a take in which the lips are at most as far apart as at rest. Chosen on one half of the strangers' clips."""
_MAX_SEALED = 0.03
"""Largest gap, in eye distances, of lips that count as shut, which lips that are seen from below, bearded or blurred
have. Chosen likewise, together with what shuts lips that are hardly parted (`core.drive.retarget`)."""
_BROAD = 0.02
"""Distance in eye distances by which expressions broaden a mouth that may smile; in portraits it is 0.06 on average."""
_MISTAKEN = 0.03
"""Share of a take in which lips may seem shut that never are."""
_APART = 0.04
"""Gap, in eye distances, that they exceed in the rest of it."""


def trust(take: Take, frames: IntArray) -> FloatArray:
    """Compute the frames' weights for `FaceSpace.explain`: positive, and lower for turned and uncertain faces."""
    turned = np.square(take.pose[frames, 1:3] / _TURNED).sum(axis=1)
    return np.asarray(take.confidence[frames] * np.exp(-turned) + _MIN_TRUST)


def expressed(take: Take, frames: IntArray, activations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of frames from rest in eye distances, (N,), and the activations that are expression, (N, U)."""
    space = load_face_space()
    # The height of brows at rest differs more between people than the space covers, so it is taken from the take.
    usual = np.where(space.of_brows, np.quantile(activations, _USUAL, axis=0), 0.0)
    opening = eye_apertures(take.shape[frames].astype(np.float64)).mean(axis=1)
    amount = space.amount(activations - usual) + _DOUBT * (1.0 - take.confidence[frames])
    amount += _LIDS * np.maximum(np.abs(opening / np.median(opening) - 1.0) - _LIDS_AT_REST, 0.0)
    # Weak activations may be the person's own face; strong ones are expressions, which a face at rest would not show.
    return amount, np.maximum(activations - np.maximum(usual, _WEAK), 0.0)


def frowning(shape: FloatArray, activation: float) -> float:
    """How certain it is, 0 to 1, that a shape (66, 3) frowns, by how knitted and how low its brows are."""
    away = _away(shape)
    heights = [away[brow, 1].mean() - away[eye[[0, 3]], 1].mean() for eye, brow in _EYES_AND_BROWS]
    low = min(max(float(np.mean(heights)) / _LOW, 0.0), 1.0) * (1.0 - load_face_space().acting_probability(away))
    return min(max((activation + _LOW_COUNTS * low - _FROWNS_FROM) / (_FROWNS_FULLY - _FROWNS_FROM), 0.0), 1.0)


def resting_shape(shape: FloatArray, brows: float, openings: FloatArray, knitted: float = 0.0) -> FloatArray:
    """Move a shape (66, 3) towards the mean of people's faces, with lips as far apart as the take's shut ones.

    The mean keeps an expression that lasts from passing for rest. `brows` is the doubt, 0 to 1, whether these rest;
    `openings` (N,) are those of the mouth; `knitted`, 0 to 1, is how certain it is that the shape frowns. Pose and size
    of the face stay.
    """
    space, away = load_face_space(), _away(shape)
    acted = space.expressed(away)
    # Heights of brows and lids differ more between people than the space covers: all of it may be expression. The
    # sockets of the eyes and the bridge of the nose do not move, or lids would slide off the eyeballs, so lids are
    # measured from the line between the corners of their eye, and brows from its middle.
    acted[BROWS, 1] = brows * away[BROWS, 1]
    acted[NOSE[:4]] = 0.0
    for eye, brow in _EYES_AND_BROWS:
        first, last = away[eye[[0, 3]], 1]
        acted[eye] = 0.0
        acted[eye, 1] = away[eye, 1] - 0.5 * (first + last) - _ALONG_EYE * (last - first)
        acted[brow, 1] -= 0.5 * (first + last)
    # Broad mouths that act smile. Narrow ones were not tried: nobody puckers for a portrait.
    wider = acted[MOUTH_CORNERS[1], 0] - acted[MOUTH_CORNERS[0], 0]
    smiling = space.acting_probability(away) * min(max(float(wider) / _BROAD, 0.0), 1.0)
    share = np.full((len(shape), 1), _TOWARDS_MEAN)
    share[LIPS] += (1.0 - _TOWARDS_MEAN) * smiling
    rest = shape - share * acted
    # Landmarks hardly show how far the brows of somebody who always frowns are from their rest.
    for brow, inwards in ((BROWS[:5], 1.0), (BROWS[5:], -1.0)):
        together, lowered, _ = (shape[brow] - rest[brow]).mean(axis=0)
        rest[brow, 1] -= knitted * max(_FROWN_DOWN - lowered, 0.0)
        rest[brow, 0] -= knitted * inwards * max(_FROWN_IN - inwards * together, 0.0)
    # The tracker sees shut lips of one person closer together than those of another. Lips that never meet, as in a
    # radiant smile, do not show how far apart they are when shut, and are taken to meet.
    gap = min(max(float(np.quantile(openings, _SEALED)), float(mouth_aperture(shape))), _MAX_SEALED)
    gap *= 1.0 - min(max(float(np.quantile(openings, _MISTAKEN)) / _APART - 1.0, 0.0), 1.0)
    lacking = gap - float(mouth_aperture(rest))
    rest[UPPER_LIPS, 1] -= lacking / 2.0
    rest[LOWER_LIPS, 1] += lacking / 2.0
    return np.asarray(rest)


def _away(shape: FloatArray) -> FloatArray:
    """Displacement (66, 3) of a shape from the mean of people's faces, without that of the pose and size."""
    mean = load_face_space().mean
    return np.asarray(without_similarity((shape - mean)[None], mean)[0])


def shut_level(neutral: FloatArray, shapes: FloatArray) -> float:
    """Estimate `Neutral.shut`: how much of the opening remains when the eyes are most closed; 0 if they never shut.

    The third smallest opening of the shapes (N, 66, 3) is used, as a blink lasts several frames at any usual rate, a
    misplaced lid one or two.
    """
    opening = eye_apertures(shapes).mean(axis=1)
    at_rest = float(eye_apertures(neutral).mean())
    least = np.sort(opening)[min(2, len(opening) - 1)]
    left = float(np.clip(least / max(at_rest, 1e-9), 0.0, 1.0))
    return left if left < MAX_SHUT else 0.0


def median_of_known(values: FloatArray) -> FloatArray:
    """Median over frames (N, D), (D,); NaN if none is known."""
    known = values[np.isfinite(values).all(axis=1)].astype(np.float64)
    return np.median(known, axis=0) if len(known) else np.full(values.shape[1], np.nan)

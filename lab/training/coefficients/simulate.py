"""Observations without images: random expressions of many faces, as the shape model fits their noisy landmarks.

All rendered people have ICT-FaceKit's expressions. The built-in head's, which come from another source, are used too,
so that the model learns what an expression is rather than how one artist shaped it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from facemime.core.bake.arkit import Observer
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.face.landmarks import N_LANDMARKS, outer_eye_distance
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, N_ACTIONS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.takes.neutral import Neutral
from facemime.core.takes.rest import shut_level
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.result import TrackResult

from ..tracker.heads import IctHead
from ..tracker.reproject import shut_weights
from .script import ict_weights, random_moment

_SIZE, _NOISE, _FIT_NOISE, _ITERATIONS = 100.0, 0.012, 0.01, 8
"""Pixels between the eyes; noise of a landmark, and noise that the fit assumes, in eye distances; and steps of the
fit."""
_TURNS, _PERSPECTIVE = np.radians([4.0, 9.0, 3.0]), 0.06
_RESTING, _BLINKING = 8, 6
"""Number of frames from which a simulated neutral face and shut eyes are measured."""
_STATURE, _STRENGTH, _LIKENESS = 0.04, 0.15, 0.6
"""Deviations of the built-in head's extents and of its units' sizes, and of ICT-FaceKit's modes of identity."""

Face = Callable[[np.ndarray], np.ndarray]
"""From coefficients (52,) to landmarks (66, 3)."""


@dataclass(frozen=True)
class Observed:
    """Observations (N, 213) of coefficients (N, 52)."""

    values: np.ndarray
    keys: np.ndarray


def built_in_face(rng: np.random.Generator) -> Face:
    """A face like the built-in head's with other proportions, whose units are slightly stronger or weaker."""
    head = load_head()
    rest = head.vertices[head.landmarks].astype(np.float64)
    unit = outer_eye_distance(rest)
    units = (
        head.units[:, head.landmarks].astype(np.float64) / unit * rng.normal(1.0, _STRENGTH, (len(COEFFICIENTS), 1, 1))
    )
    rest = (rest - rest.mean(axis=0)) / unit * rng.normal(1.0, _STATURE, 3)
    return lambda keys: rest + np.tensordot(keys, units, 1)


def ict_face(head: IctHead, rng: np.random.Generator) -> Face:
    """A random face of ICT-FaceKit."""
    likeness = rng.normal(0.0, _LIKENESS, len(head.identity))
    rest = head.neutral[head.landmarks] + np.tensordot(likeness, head.identity[:, head.landmarks], 1)
    units = head.expression[:, head.landmarks]
    blink = shut_weights(head, rest, units)
    return lambda keys: rest + np.tensordot(ict_weights(head, keys, blink)[0], units, 1)


def simulate(faces: list[Face], model: PointDistributionModel, each: int, rng: np.random.Generator) -> Observed:
    """Observe `each` random expressions of faces, some of them weak, and some faces at rest."""
    values, keys = [], []
    for face in faces:
        observer = Observer(_neutral(face, model, rng), DriveSettings())
        for frame in range(each):
            shown = random_moment(rng) * rng.choice([0.5, 1.0, 1.0]) * (frame % _RESTING > 0)
            values.append(observer.face(_seen(face(shown), model, rng)))
            keys.append(shown)
    return Observed(np.array(values), np.array(keys))


def _neutral(face: Face, model: PointDistributionModel, rng: np.random.Generator) -> Neutral:
    rest, shut = np.zeros(len(COEFFICIENTS)), np.zeros(len(COEFFICIENTS))
    shut[[COEFFICIENT_INDEX["eyeBlinkLeft"], COEFFICIENT_INDEX["eyeBlinkRight"]]] = 1.0
    shape = np.mean([_seen(face(rest), model, rng).shape for _ in range(_RESTING)], axis=0)
    blinks = np.array([_seen(face(shut), model, rng).shape for _ in range(_BLINKING)])
    position = np.array([_SIZE, 0.0, 0.0])
    return Neutral(shape, np.eye(3), position, 0.0, 1.0, shut=shut_level(shape, blinks))


def _seen(points: np.ndarray, model: PointDistributionModel, rng: np.random.Generator) -> TrackResult:
    """Return what tracking finds for landmarks (66, 3), apart from actions and gaze."""
    turned = points @ euler_to_matrix(*rng.normal(0.0, _TURNS)).T
    image = _SIZE * turned[:, :2] / (1.0 + _PERSPECTIVE * turned[:, 2:])
    image += rng.normal(0.0, _NOISE * _SIZE, image.shape)
    fitted = model.fit(image, noise=_FIT_NOISE, iterations=_ITERATIONS)
    return TrackResult(
        found=True,
        landmarks=image,
        pose=fitted.pose,
        shape_params=fitted.shape_params,
        shape=model.shape(fitted.shape_params),
        confidence=1.0,
        landmark_confidence=np.ones(N_LANDMARKS),
        pupils=np.full((2, 2), np.nan),
        gaze=np.full(2, np.nan),
        vergence=np.nan,
        actions=np.full(N_ACTIONS, np.nan),
    )

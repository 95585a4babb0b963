"""Takes and results of faces that are measured rather than tracked: from vertices that move (method.md, section 8.5),
and from ARKit's coefficients.

In this way streams of phones and VTuber programs, and tables of coefficients, drive any head as a camera does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ..errors import HeadError
from ..face.landmarks import outer_eye_distance
from ..face.names import FITTED, N_COEFFICIENTS
from ..face.rotation import euler_to_matrix, fit_rotation, matrix_to_euler
from ..heads.built_in import LOOKS, gaze_of, gaze_of_eyes, load_head
from ..numeric.arrays import FloatArray
from ..tracking.result import CAMERA_DISTANCE, TrackResult
from .neutral import Neutral
from .rest import shut_level
from .take import Take, TakeRecorder, describe

IMAGE_SIZE = (1280, 720)
"""Width and height in pixels of the image in which landmarks are given, as if seen by a camera."""
_SCALE = 160.0
"""Size of the face in that image, in pixels per outer-eye distance."""


REST_POSITION: FloatArray = np.array([_SCALE, *np.array(IMAGE_SIZE) / 2.0])
"""`Neutral.position` of a measured face: scale, and the middle of that image."""
_ROUNDS = 12
"""Rounds of the robust fit."""
_MIN_SPREAD = 1e-4
"""Smallest spread of the robust fit, in outer-eye distances."""
_NEAREST = 0.2
"""Smallest distance to the camera, as a share of the one at rest."""


@dataclass(frozen=True)
class FacePoints:
    """Places on a face at one time, with the axes and unit of the head frame at rest.

    Attributes
    ----------
    landmarks : (66, 3) float64
        The landmarks.
    anchors : (M, 3) float64
        Vertices of the skin from which the pose of the head is found; most of them move only with the head.
    eyes : ((R, 3), (L, 3)) float64
        Vertices of the right and left eyeball; empty if unknown.
    """

    landmarks: FloatArray
    anchors: FloatArray
    eyes: tuple[FloatArray, FloatArray] = field(default_factory=lambda: (np.empty((0, 3)), np.empty((0, 3))))


class PointTracker:
    """Makes a take, frame by frame, from a face whose vertices are known.

    Parameters
    ----------
    rest : FacePoints
        The face at rest.
    pivot : (3,) float64
        Point about which the head turns. Its motion is that of the head.
    trust : (M,) float64
        Weights of the anchors: how certain it is that they move only with the head.

    Raises
    ------
    HeadError
        If the outer corners of the eyes coincide.
    """

    def __init__(self, rest: FacePoints, pivot: FloatArray, trust: FloatArray) -> None:
        self.rest, self.pivot, self.trust = rest, pivot, trust
        self.unit = outer_eye_distance(rest.landmarks)
        if not self.unit > 0.0:
            raise HeadError("The outer corners of the eyes coincide. Find the face again.")
        self._centre = rest.landmarks.mean(axis=0)

    def track(self, points: FacePoints) -> TrackResult:
        """Return the result of an ideal tracker; it has no face if a place is not a number."""
        if not np.isfinite(points.landmarks).all() or not np.isfinite(points.anchors).all():
            return TrackResult.nothing(0)
        rotation, moved = fit_rigid(self.rest.anchors, points.anchors, self.trust, _MIN_SPREAD * self.unit)
        return self.result(points, rotation, moved)

    def result(self, points: FacePoints, rotation: FloatArray, moved: FloatArray) -> TrackResult:
        """Return the result of an ideal tracker for a head whose motion is known.

        The head is at ``rotation @ rest + moved``, in the unit of the head frame; the anchors of the points are
        ignored.
        """
        pose = pose_of(rotation, (rotation @ self.pivot + moved - self.pivot) / self.unit)
        shape = ((points.landmarks - moved) @ rotation - self._centre) / self.unit
        right, left = (
            _direction(rotation.T @ _turned(rest, eye)) if len(rest) else np.full(2, np.nan)
            for rest, eye in zip(self.rest.eyes, points.eyes, strict=True)
        )
        gaze, vergence = (right + left) / 2.0, float(left[1] - right[1])
        return TrackResult.exact(shape, pose, gaze=gaze, vergence=vergence)

    def neutral(self, take: Take) -> Neutral:
        """Return the face at rest as the neutral face of `take`, which this object tracked."""
        rest, begin = self.at_rest(), float(take.times[0])
        shapes = take.shape[take.found].astype(np.float64)
        return replace(rest, start=begin, end=begin, shut=shut_level(rest.shape, shapes) if len(shapes) else 0.0)

    def at_rest(self) -> Neutral:
        """Return the face at rest as a neutral face, whose shut lids are assumed to touch."""
        known = all(map(len, self.rest.eyes))
        gaze, vergence = (np.zeros(2), 0.0) if known else (np.full(2, np.nan), np.nan)
        return replace(_at_rest((self.rest.landmarks - self._centre) / self.unit), gaze=gaze, vergence=vergence)

    def finish(self, recorder: TakeRecorder) -> Take:
        """Return the take of the recorded results, with the face at rest as its neutral face."""
        take = recorder.finish()
        if take.found.any():
            take.info["calibration"] = self.neutral(take).to_dict()
        return take


def pose_of(rotation: FloatArray, moved: FloatArray) -> FloatArray:
    """Find the pose (6,) of a head that was turned and moved from rest; the inverse of equation 4.4.

    The translation is in the head frame, in outer-eye distances.
    """
    across, down, away = moved
    scale = _SCALE / max(1.0 + away / CAMERA_DISTANCE, _NEAREST)
    sideways = np.array([across, down]) * np.sqrt(scale * _SCALE)
    return np.array([scale, *matrix_to_euler(rotation), *(REST_POSITION[1:] + sideways)])


def describe_animation(source: str, fps: float) -> dict[str, object]:
    """Create the initial `info` of a take from an animation in the named file or object."""
    return {**describe(source, fps, IMAGE_SIZE, "mesh"), "measured": True}


def fit_rigid(source: FloatArray, target: FloatArray, trust: FloatArray, least: float) -> tuple[FloatArray, FloatArray]:
    """Fit the rigid motion that most points follow, regardless of the others.

    ``rotation @ source + moved`` is near `target` for most of the points (N, 3), of weights (N,); differences below
    `least`, in their unit, count as noise. This is iteratively reweighted least squares with the weights of Geman and
    McClure (1987), whose spread decreases with the median of the distances.
    """
    weights = trust
    for _ in range(_ROUNDS):
        share = weights[:, None] / weights.sum()
        middle, other = (share * source).sum(axis=0), (share * target).sum(axis=0)
        rotation = fit_rotation(np.sqrt(share) * (source - middle), np.sqrt(share) * (target - other))
        moved = other - rotation @ middle
        off = np.linalg.norm(source @ rotation.T + moved - target, axis=1)
        spread = max(_weighted_median(off, trust), least)
        weights = trust / np.square(1.0 + np.square(off / spread))
    return rotation, moved


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2.0)]])


def _turned(rest: FloatArray, eye: FloatArray) -> FloatArray:
    return fit_rotation(rest - rest.mean(axis=0), eye - eye.mean(axis=0))


def _direction(rotation: FloatArray) -> FloatArray:
    """Pitch and yaw of an eye that looked straight ahead before it was turned."""
    x, y, z = rotation @ np.array([0.0, 0.0, -1.0])
    return np.array([np.arcsin(np.clip(y, -1.0, 1.0)), np.arctan2(-x, -z)])


class CoefficientFace:
    """Shows coefficients on the built-in head, whose neutral face, `neutral`, is that of all results."""

    def __init__(self) -> None:
        head = load_head()
        rest = head.vertices[head.landmarks].astype(np.float64)
        self.unit = outer_eye_distance(rest)
        self._rest = (rest - rest.mean(axis=0)) / self.unit
        self._units = head.units[FITTED][:, head.landmarks].astype(np.float64) / self.unit
        shut = np.zeros(N_COEFFICIENTS)
        self.neutral = replace(_at_rest(self._rest), gaze=gaze_of(shut[LOOKS])[0], vergence=0.0)

    def result(
        self,
        values: FloatArray,
        rotation: FloatArray,
        moved: FloatArray | None = None,
        eyes: FloatArray | None = None,
    ) -> TrackResult:
        """Return the result of an ideal tracker for coefficients (52,), clipped to 0 to 1.

        `rotation` (3,) is the pitch, yaw and roll of the head in radians, as in `TrackResult`; `moved` is the
        translation from rest in the head frame, in metres; `eyes` (2, 2) are the `(pitch, yaw)` of the right and the
        left eye in radians, as for the gaze in `TrackResult`, and follow from the coefficients by default.
        """
        pose = pose_of(euler_to_matrix(*rotation), np.zeros(3) if moved is None else np.asarray(moved) / self.unit)
        return self.posed(np.clip(values, 0.0, 1.0), pose, eyes)

    def posed(self, values: FloatArray, pose: FloatArray, eyes: FloatArray | None = None) -> TrackResult:
        """Do what `result` does for coefficients from 0 to 1 and a pose (6,), as in `TrackResult`."""
        shape = self._rest + np.tensordot(values[FITTED], self._units, 1)
        gaze, vergence = gaze_of(values[LOOKS]) if eyes is None else gaze_of_eyes(eyes)
        return TrackResult.exact(shape, pose, gaze=gaze, vergence=vergence, coefficients=values)


@lru_cache(maxsize=1)
def coefficient_face() -> CoefficientFace:
    """Return the face that all streams and tables share."""
    return CoefficientFace()


def _at_rest(shape: FloatArray) -> Neutral:
    return Neutral(
        shape=shape, rotation=np.eye(3), position=REST_POSITION.copy(), start=0.0, end=0.0, shut=0.0, measured=True
    )

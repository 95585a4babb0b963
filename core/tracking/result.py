"""The result of tracking one frame, which everything after the tracker reads; mirrored, or with hidden lips.

Performers who watch themselves expect a mirror: if they raise the brow on the left of the screen, the avatar's brow
on the left should rise. Mirroring results costs nothing, and the video stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import nan
from typing import Any

import numpy as np

from ..face.landmarks import LIPS, MIRROR, N_LANDMARKS, eye_apertures, mouth_aperture
from ..face.names import ACTION_MIRROR, COEFFICIENT_MIRROR, N_ACTIONS, N_COEFFICIENTS
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray

CAMERA_DISTANCE = 6.0
"""Assumed distance of the camera in eye distances (equation 4.4), about that of a webcam."""
_KNOWN = 0.6
"""Smallest mean certainty of the lips with which they are remembered."""
_SEEN = 0.5
"""Mean certainty of the lips below which they are partly held. In strangers' clips a mouth with the tongue out, a beard
or a scream has 0.53 or more, one behind a hand 0.2 to 0.5."""
_HIDDEN = 0.4
"""Mean certainty of the lips below which they are held completely."""


def _unknown(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


def project_shape(shape: FloatArray, pose: FloatArray) -> FloatArray:
    """Project a shape (66, 3), in the head frame and outer-eye distances, to pixels, (66, 2) (equation 3.1)."""
    return np.asarray(pose[0] * (shape @ euler_to_matrix(*pose[1:4]).T)[:, :2] + pose[4:])


@dataclass(frozen=True)
class TrackResult:
    """The face in one frame, or its absence.

    Attributes
    ----------
    found : bool
        Whether there is a face. If not, all arrays are NaN.
    landmarks : (66, 2) float64
        Positions in pixels.
    pose : (6,) float64
        `(s, pitch, yaw, roll, tx, ty)`: scale in pixels per outer-eye distance, radians, pixels. A point `m` of the
        head frame is seen at ``s R m + t``, first two rows, with ``R = Rz(roll) Ry(yaw) Rx(pitch)``.
        Positive pitch looks down, positive yaw turns the nose to the viewer's left, positive roll tilts the head
        clockwise as the viewer sees it.
    shape_params : (K,) float64
        Coefficients of the modes of the shape model.
    shape : (66, 3) float64
        Landmarks without the pose: head frame, in outer-eye distances.
    confidence : float
        Confidence that this is a face, 0 to 1.
    landmark_confidence : (66,) float64
        Certainty of each landmark, 0 to 1. It is low if the landmark is covered or turned away, so that its position is
        estimated by the shape model. NaN if unknown.
    pupils : (2, 2) float64
        Centres of the performer's right and left pupil in pixels; NaN for an eye that is shut or hidden by the nose.
    gaze : (2,) float64
        `(pitch, yaw)` in radians: direction of both eyes relative to the head, with the signs of the pose. They look
        along ``Ry(yaw) Rx(pitch) (0, 0, -1)`` in the head frame: (0, 0) is straight ahead, positive pitch down,
        positive yaw to the viewer's left. NaN if both eyes are shut.
    vergence : float
        Yaw of the left eye minus that of the right eye in radians; positive for crossed eyes. NaN unless both are open.
    actions : (15,) float64
        Activations of `actions.ACTIONS`, which no landmark shows. The performer's values at rest are not yet
        subtracted. NaN if unknown.
    teeth : float
        How surely teeth are seen to fill the opening between the lips, 0 to 1: the jaw is shut then, although the lips
        are not. 0 if the lips are shut, NaN if it is unknown, as in images without colours.
    coefficients : (52,) float64
        ARKit's coefficients, 0 to 1, in the order of `COEFFICIENTS`, if the source states them, as a phone does; NaN if
        they have to be found from the landmarks.

    Examples
    --------
    >>> from facemime import TrackResult, load_take
    >>> result: TrackResult = load_take("performance.facetake").result(0)
    >>> result.found, result.shape.shape
    (True, (66, 3))
    """

    found: bool
    landmarks: FloatArray
    pose: FloatArray
    shape_params: FloatArray
    shape: FloatArray
    confidence: float
    landmark_confidence: FloatArray = field(default_factory=lambda: _unknown(N_LANDMARKS))
    pupils: FloatArray = field(default_factory=lambda: _unknown(2, 2))
    gaze: FloatArray = field(default_factory=lambda: _unknown(2))
    vergence: float = nan
    actions: FloatArray = field(default_factory=lambda: _unknown(N_ACTIONS))
    teeth: float = nan
    coefficients: FloatArray = field(default_factory=lambda: _unknown(N_COEFFICIENTS))

    @classmethod
    def nothing(cls, n_modes: int) -> TrackResult:
        """Return the result without a face, for a shape model with `n_modes` modes."""
        return cls(
            found=False,
            landmarks=_unknown(N_LANDMARKS, 2),
            pose=_unknown(6),
            shape_params=_unknown(n_modes),
            shape=_unknown(N_LANDMARKS, 3),
            confidence=0.0,
        )

    @classmethod
    def exact(cls, shape: FloatArray, pose: FloatArray, **values: Any) -> TrackResult:
        """Return the result for a face that is known rather than tracked, with full confidence.

        Parameters
        ----------
        shape : (66, 3) array
            Landmarks without the pose: head frame, outer-eye distances.
        pose : (6,) array
            Pose, as in the attribute; it places the landmarks.
        """
        return cls(
            found=True,
            landmarks=project_shape(shape, pose),
            pose=pose,
            shape_params=np.empty(0),
            shape=shape,
            confidence=1.0,
            landmark_confidence=np.ones(N_LANDMARKS),
            **values,
        )

    @property
    def head_pose_degrees(self) -> FloatArray:
        """Pitch (down is positive), yaw (to the viewer's left) and roll (clockwise to the viewer) in degrees, (3,)."""
        return np.asarray(np.degrees(self.pose[1:4]))

    @property
    def eye_apertures(self) -> FloatArray:
        """Apertures (2,) of right and left eye, without the pose, in outer-eye distances (equation 3.7); 0 is shut."""
        return eye_apertures(self.shape)

    @property
    def mouth_aperture(self) -> float:
        """Aperture between the inner lips without the pose, in outer-eye distances; 0 is closed."""
        return float(mouth_aperture(self.shape))


_POSE = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
_GAZE = np.array([1.0, -1.0])
_SHAPE = np.array([-1.0, 1.0, 1.0])


def mirror_result(result: TrackResult, width: float, mode_signs: FloatArray | None = None) -> TrackResult:
    """Mirror a result left to right. Mirroring twice gives `result` again.

    Parameters
    ----------
    result : TrackResult
        The result to mirror.
    width : float
        Width of the image in pixels. Pixel centres have integer coordinates, so x becomes ``width - 1 - x``.
    mode_signs : (K,) float64, optional
        `PointDistributionModel.mirror_signs` of the model. Without them the shape parameters become NaN; everything
        else is exact in any case.

    Returns
    -------
    TrackResult
        What tracking would have found in the mirrored image.
    """
    signs = np.full(result.shape_params.shape, np.nan) if mode_signs is None else mode_signs
    landmarks, pupils = _flipped(result.landmarks, width)[MIRROR], _flipped(result.pupils, width)[::-1]
    pose = result.pose * _POSE
    pose[4] += width - 1.0
    return replace(
        result,
        landmarks=landmarks,
        pose=pose,
        shape_params=result.shape_params * signs,
        shape=(result.shape * _SHAPE)[MIRROR],
        landmark_confidence=result.landmark_confidence[MIRROR],
        pupils=pupils,
        gaze=result.gaze * _GAZE,
        actions=result.actions[ACTION_MIRROR],
        coefficients=result.coefficients[COEFFICIENT_MIRROR],
    )


def _flipped(points: FloatArray, width: float) -> FloatArray:
    """Mirror the x of image points (N, 2)."""
    return np.stack([width - 1.0 - points[:, 0], points[:, 1]], axis=1)


def seen_lips(certainty: FloatArray) -> float:
    """Return the mean certainty of the lips, 0 to 1, for `certainty` (66,) of each landmark."""
    return float(certainty[LIPS].mean())


def is_hidden(certainty: FloatArray) -> bool:
    """Return whether the lips are held, for `certainty` (66,) of each landmark; False if it is unknown."""
    return seen_lips(certainty) < _SEEN


class HiddenMouth:
    """Holds the lips while something covers them, which the experts would take for a gaping mouth."""

    def __init__(self) -> None:
        self._lips: FloatArray | None = None

    def reset(self) -> None:
        """Forget the lips, as another face follows."""
        self._lips = None

    def hold(self, shape: FloatArray, certainty: FloatArray) -> FloatArray:
        """Return `shape` with the last well-seen lips, by as much as they are hidden; `shape` itself if they are seen.

        It is (66, 3), in the head frame and outer-eye distances; `certainty` (66,) is that of each landmark, 0 to 1.
        """
        seen = seen_lips(certainty)
        if seen >= _KNOWN:
            self._lips = shape[LIPS]
        # From 0 where the lips are just seen to 1 where they are hidden, so that nothing jumps.
        share = min((_SEEN - seen) / (_SEEN - _HIDDEN), 1.0)
        if share <= 0.0 or self._lips is None:
            return shape
        held = shape.copy()
        held[LIPS] += share * (self._lips - shape[LIPS])
        return np.asarray(held)

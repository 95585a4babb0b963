"""What tracking one frame gives; the one type that everything behind the tracker reads."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..apertures import eye_apertures, mouth_aperture
from ..arrays import FloatArray
from ..landmarks import N_LANDMARKS


def _unknown(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class TrackResult:
    """The face in one frame, or its absence.

    Attributes
    ----------
    found : bool
        False: no face, and every array is NaN.
    landmarks : (66, 2) float64
        Image frame, pixels.
    pose : (6,) float64
        `(s, pitch, yaw, roll, tx, ty)`: scale in pixels per outer-eye distance, radians, pixels. A point m of the
        head frame falls on the image at `s R m + t`, first two rows, with `R = Rz(roll) Ry(yaw) Rx(pitch)`.
        Positive pitch looks down, positive yaw turns the nose to the viewer's left, positive roll tilts the head
        clockwise as the viewer sees it.
    shape_params : (K,) float64
        Coefficients of the shape model's modes.
    shape : (66, 3) float64
        The landmarks with the pose taken out: head frame, in outer-eye distances.
    confidence : float
        0 to 1: how far the fitted appearance looks like a face.
    landmark_confidence : (66,) float64
        0 to 1: how far the image speaks for each landmark's place. Low where something covers it or where it is turned
        away, and the shape model had to guess. NaN where not known.
    pupils : (2, 2) float64
        Image frame, pixels: centres of the performer's right and left pupil; NaN for an eye that is shut.
    gaze : (2,) float64
        `(pitch, yaw)`, radians: how both eyes are turned within the head, with the signs of the pose. They look along
        `Ry(yaw) Rx(pitch) (0, 0, -1)` of the head frame: (0, 0) straight out of the face, positive pitch down,
        positive yaw to the viewer's left. NaN where both eyes are shut.
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

    @classmethod
    def nothing(cls, n_modes: int) -> TrackResult:
        """The result where no face is found, of a shape model with `n_modes` modes."""
        return cls(
            found=False,
            landmarks=_unknown(N_LANDMARKS, 2),
            pose=_unknown(6),
            shape_params=_unknown(n_modes),
            shape=_unknown(N_LANDMARKS, 3),
            confidence=0.0,
        )

    @property
    def head_pose_degrees(self) -> FloatArray:
        """(3,) pitch (down is positive), yaw (to the viewer's left) and roll (clockwise to the viewer), degrees."""
        return np.asarray(np.degrees(self.pose[1:4]))

    @property
    def eye_apertures(self) -> FloatArray:
        """(2,) height of the right and the left eye's slit in outer-eye distances, the pose taken out; 0 is shut.

        `core.apertures` has the definition.
        """
        return eye_apertures(self.shape)

    @property
    def mouth_aperture(self) -> float:
        """Height of the slit between the inner lips in outer-eye distances, the pose taken out; 0 is closed."""
        return float(mouth_aperture(self.shape))

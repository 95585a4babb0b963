"""What tracking one frame gives; the one type that everything behind the tracker reads."""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import FloatArray


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
    """

    found: bool
    landmarks: FloatArray
    pose: FloatArray
    shape_params: FloatArray
    shape: FloatArray
    confidence: float

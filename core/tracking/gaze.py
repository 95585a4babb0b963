"""Gaze: pupils, which an expert places roughly and gradients exactly, and the direction of an eyeball (method.md,
section 3.8).

The expert, a small network, sees both eyes, and tells irises from lashes, shadows and reflections. Near the place that
it gives, the edge between a dark iris and the brighter white votes for the centre of its curvature (Timm & Barth 2011).
The paper squares the dot product of every gradient with every direction. Here the vote is the dot product itself,
summed over the ring where an iris of known size has its rim. This is a correlation with two fixed kernels, which is
cheap, and bright spots on dark ground get negative votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan2, dist, hypot, nan, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import EYE_LEFT, EYE_RIGHT, eye_apertures
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray
from .experts import FacePart
from .grey import Grey
from .reference import ReferenceFrame, warp_to_reference

EYES = np.concatenate([EYE_RIGHT, EYE_LEFT])
"""Landmarks at whose middle the experts of the pupils see both eyes."""
_CORNERS = np.array([EYE_RIGHT, EYE_LEFT])[:, [0, 3]]
_IRIS = 0.066
"""Radius of the iris: 5.9 mm at an outer-eye distance of 89 mm."""
_REACH = 0.035
"""Standard deviation, in outer-eye distances, of the weight of votes about the place that the expert gives. Chosen on
half A of the strangers' clips: with 0.045, more pupils are misplaced; with 0.03, crossed eyes look less crossed."""
_OPEN_ABOVE = 0.16
"""Aperture of an eye, as a share of its width, up to which it counts as shut."""
_CLEAR_ABOVE = 0.2
"""Aperture of an eye, as a share of its width, above which its pupil is seen well enough to detect crossed eyes."""
_TURNED_AWAY = 0.4
"""Ratio of the distance of an eye's corners in the image to their true one, below which the nose hides the eye. On half
A of the strangers' clips, the far eye and the near one look 83 degrees apart (median) where it is less, and 14 where it
is more."""
_FRONTAL_BELOW = 0.4
"""Yaw of the head and of the gaze, in radians, below which both pupils are seen well enough for that."""
_BALL = (0.0, -0.02, 0.075)
"""Centre of an eyeball relative to the middle between the corners of the eye: head frame, outer-eye distances."""
_BALL_RADIUS = 0.13
"""Distance from the centre of an eyeball to its pupil, in outer-eye distances."""


@dataclass(frozen=True)
class PupilExperts(FacePart):
    """Experts for the pupils: a network that sees a band with both eyes, whose landmarks are `EYES`.

    It tells the places of both pupils from the middle of the band, in its heights.
    """

    def band(self, grey: Grey, pose: FloatArray, landmarks: FloatArray) -> ReferenceFrame:
        """Crop the band with both eyes of a face with `landmarks` (66, 2) in pixels."""
        place = pose.copy()
        place[4:6] = self.centres(landmarks)[0]
        return warp_to_reference(grey, place, self.scale, self.size)

    def refine(self, band: ReferenceFrame, told: NDArray[np.float32]) -> FloatArray:
        """Refine by gradients what the network has `told` (1, 4) of a band: pupils (2, 2) in pixels of the image."""
        width, height = self.size
        roughly = (told.reshape(2, 2) * height + (0.5 * (width - 1), 0.5 * (height - 1))).tolist()
        votes = _votes(band.pixels, *self._kernels)
        return band.in_image(np.array([_peak(votes, x, y, self.scale) for x, y in roughly]))

    @cached_property
    def _kernels(self) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
        """The kernels of the votes for irises of this scale, and the side of the disc that is dark."""
        radius = _IRIS * self.scale
        return *_ring(radius), 2 * int(0.5 * radius) + 1


@dataclass(frozen=True)
class Gaze:
    """Gaze of a face, as in `TrackResult`.

    Attributes
    ----------
    pupils : (2, 2) float64
        Pupil centres in pixels.
    direction : (2,) float64
        Pitch and yaw in radians.
    vergence : float
        Radians.
    """

    pupils: FloatArray
    direction: FloatArray
    vergence: float


def find_gaze(found: FloatArray, pose: FloatArray, landmarks: FloatArray, shape: FloatArray) -> Gaze:
    """Find the gaze of a face whose pupils were `found` (2, 2); NaN, like these, for eyes that are shut or hidden.

    `pose` (6,) is as in `TrackResult`, pupils and `landmarks` (66, 2) are in pixels, and `shape` (66, 3) holds the
    landmarks without the pose: head frame, outer-eye distances. The direction is the mean over the open eyes, weighted
    by their visible areas.
    """
    scale, pitch, yaw, roll, *place = pose.tolist()
    rotation = euler_to_matrix(pitch, yaw, roll).tolist()
    pupils = np.full((2, 2), np.nan)
    sights: list[tuple[float, float, float]] = []
    sums, clear = [0.0, 0.0, 0.0], True
    # Python floats, as operations on numpy scalars and tiny arrays take ten times as long.
    apertures = eye_apertures(landmarks).tolist()
    for i, (aperture, pupil) in enumerate(zip(apertures, found.tolist(), strict=True)):
        first, last = landmarks[_CORNERS[i]].tolist()
        width = dist(first, last)
        first, last = shape[_CORNERS[i]].tolist()
        length = scale * dist(first, last)
        # An eye is weighted by its visible area, and not used while it is shut or hidden.
        clear = clear and aperture > _CLEAR_ABOVE * width
        if not (aperture > _OPEN_ABOVE * width and width > _TURNED_AWAY * length):
            continue
        pupils[i] = pupil
        # The eyeball lies at a fixed place behind the middle between the corners of the eye.
        ball = [0.5 * (a + b) + c for a, b, c in zip(first, last, _BALL, strict=True)]
        sight = _line_of_sight([(p - t) / scale for p, t in zip(pupil, place, strict=True)], ball, rotation)
        sights.append(sight)
        sums = [total + aperture * width * each for total, each in zip(sums, sight, strict=True)]
    if not sights:
        return Gaze(pupils, np.full(2, np.nan), nan)
    x, y, z = sums
    together = np.array([atan2(y, hypot(x, z)), atan2(-x, -z)])
    clear = clear and len(sights) == 2 and max(abs(yaw), abs(together[1])) < _FRONTAL_BELOW
    right, left = (atan2(-x, -z) for x, _, z in sights) if clear else (nan, nan)
    return Gaze(pupils, together, left - right)


def _line_of_sight(
    pupil: Sequence[float], ball: Sequence[float], rotation: Sequence[Sequence[float]]
) -> tuple[float, float, float]:
    """Unit vector, in the head frame, from the centre of an eyeball to its pupil (2,), which is seen in the image.

    `ball` (3,) is that centre in the head frame, `rotation` (3, 3) that of the head; lengths are outer-eye distances.
    Under weak perspective, the pupil is where the line of sight through its image meets the front of the eyeball. If
    the line misses the eyeball, the nearest point of its outline is used.
    """
    # On a unit ball: (x, y) in the image plane, and the rest of the unit vector towards the viewer, -z.
    x, y = (
        (seen - sum(r * b for r, b in zip(row, ball, strict=True))) / _BALL_RADIUS
        for seen, row in zip(pupil, rotation, strict=False)
    )
    off = max(hypot(x, y), 1.0)
    x, y = x / off, y / off
    z = -sqrt(max(1.0 - x * x - y * y, 0.0))
    # From the axes of the image back to the head frame.
    right, down, away = (x * a + y * b + z * c for a, b, c in zip(*rotation, strict=True))
    return right, down, away


def _votes(
    pixels: NDArray[np.uint8], ring_x: NDArray[np.float32], ring_y: NDArray[np.float32], disc: int
) -> NDArray[np.float32]:
    """Score each pixel as the centre of an iris, (h, w), by the votes of the gradients around it."""
    smooth = cv2.GaussianBlur(pixels.astype(np.float32), (5, 5), 0.9)
    right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = cv2.magnitude(right, down)
    # Directions count, not contrast: divide by the magnitude, plus its mean so that noise on flat skin stays small.
    strength = np.add(strength, np.float32(cv2.mean(strength)[0] + 1e-3))
    # Votes: sum over the ring of gradient times outward direction, as a correlation per component.
    across = cv2.filter2D(cv2.divide(right, strength), -1, ring_x, borderType=cv2.BORDER_CONSTANT)
    along = cv2.filter2D(cv2.divide(down, strength), -1, ring_y, borderType=cv2.BORDER_CONSTANT)
    # A pupil is also dark: weight by how much darker the disc around each pixel is than the brightest one.
    darkness = np.float32(cv2.minMaxLoc(smooth)[1] + 2.0) - cv2.blur(smooth, (disc, disc))
    return np.asarray(np.maximum(across + along, 0.0) * darkness, np.float32)


def _peak(votes: NDArray[np.float32], x: float, y: float, scale: float) -> tuple[float, float]:
    """Return the position of the largest vote near `(x, y)`, refined by a parabola along each axis.

    If there are no votes, it is `(x, y)` itself. `scale` is in pixels per outer-eye distance.
    """
    height, width = votes.shape
    sharp = np.float32(-0.5 / (_REACH * scale) ** 2)
    across = np.exp(np.square(np.arange(width, dtype=np.float32) - x) * sharp)
    down = np.exp(np.square(np.arange(height, dtype=np.float32) - y) * sharp)
    weighted = votes * across * down[:, None]
    _, most, _, (column, row) = cv2.minMaxLoc(weighted)
    if not (most > 0.0 and 0 < column < width - 1 and 0 < row < height - 1):
        return x, y
    (_, above, _), (left, best, right), (_, below, _) = weighted[row - 1 : row + 2, column - 1 : column + 2].tolist()
    return column + _vertex(left, best, right), row + _vertex(above, best, below)


def _vertex(before: float, best: float, after: float) -> float:
    """Vertex of the parabola through three values, from -0.5 to 0.5 relative to the middle one."""
    bend = before - 2.0 * best + after
    return min(max((before - after) / (2.0 * bend), -0.5), 0.5) if bend < 0.0 else 0.0


def _ring(radius: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Kernels that sum, around a pixel, how far gradients point away from it at about the `radius` of an iris.

    The sides of the rim are weighted more than its top and bottom, which lids cover.
    """
    reach = int(1.35 * radius)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    away = np.maximum(np.hypot(x, y), 1e-9)
    ring = np.exp(-0.5 * ((away - radius) / (0.16 * radius)) ** 2)
    ring *= 0.25 + 0.75 * (x / away) ** 2
    ring /= ring.sum()
    return (ring * x / away).astype(np.float32), (ring * y / away).astype(np.float32)

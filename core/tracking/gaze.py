"""Gaze: pupil centres from votes of image gradients, and the direction of an eyeball (method.md, section 3.8).

The edge between a dark iris and the brighter white votes for the centre of its curvature (Timm & Barth 2011). The paper
squares the dot product of every gradient with every direction. Here the vote is the dot product itself, summed over the
ring where an iris of known size has its rim. This is a correlation with two fixed kernels, which is cheap, and bright
spots on dark ground get negative votes.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, nan

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import EYE_LEFT, EYE_RIGHT, eye_apertures
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray
from .reference import warp_to_reference

_EYES = np.array([EYE_RIGHT, EYE_LEFT])
_SCALE = 60.0
"""Pixels per outer-eye distance of the crop with both eyes."""
_WIDTH = 72
"""Width of that crop in pixels."""
_HEIGHT = 24
"""Height of that crop in pixels: a band across the face."""
_IRIS = 0.066 * _SCALE
"""Radius of the iris in that crop: 5.9 mm at an outer-eye distance of 89 mm."""
_OPEN_ABOVE = 0.16
"""Aperture of an eye, as a share of its width, up to which it counts as shut."""
_CLEAR_ABOVE = 0.2
"""Aperture of an eye, as a share of its width, above which its pupil is seen well enough to detect crossed eyes."""
_FRONTAL_BELOW = 0.4
"""Yaw of the head and of the gaze, in radians, below which both pupils are seen well enough for that."""
_BALL = np.array([0.0, -0.02, 0.075])
"""Centre of an eyeball relative to the middle between the corners of the eye: head frame, outer-eye distances."""
_BALL_RADIUS = 0.13
"""Distance from the centre of an eyeball to its pupil, in outer-eye distances."""


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


def find_gaze(grey: NDArray[np.uint8], pose: FloatArray, landmarks: FloatArray, shape: FloatArray) -> Gaze:
    """Find the pupils and the gaze of a tracked face; both are NaN for shut eyes.

    `pose` (6,) is as in `TrackResult`, `landmarks` (66, 2) are in pixels, and `shape` (66, 3) holds them without the
    pose: head frame, outer-eye distances. The direction is the mean over the open eyes, weighted by their visible
    areas.
    """
    pupils = np.full((2, 2), np.nan)
    outlines = landmarks[_EYES]
    across = outlines[:, 3] - outlines[:, 0]
    width = np.hypot(across[:, 0], across[:, 1])
    aperture = eye_apertures(landmarks)
    # An eye is weighted by its visible area, and not used while it is shut.
    shares = np.where(aperture > _OPEN_ABOVE * width, aperture * width, 0.0)
    looking = np.flatnonzero(shares)
    if len(looking) == 0:
        return Gaze(pupils, np.full(2, np.nan), nan)
    # The eyeball lies at a fixed place behind the middle between the corners of the eye.
    pupils[looking] = _pupils(grey, pose, outlines[looking])
    middles = 0.5 * (shape[_EYES[looking, 0]] + shape[_EYES[looking, 3]])
    sights = _lines_of_sight(pupils[looking], pose, middles)
    x, y, z = (shares[looking] @ sights).tolist()
    together = np.array([atan2(y, hypot(x, z)), atan2(-x, -z)])
    clear = bool((aperture > _CLEAR_ABOVE * width).all()) and max(abs(pose[2]), abs(together[1])) < _FRONTAL_BELOW
    right, left = (atan2(-x, -z) for x, _, z in sights.tolist()) if clear else (nan, nan)
    return Gaze(pupils, together, left - right)


def _lines_of_sight(pupils: FloatArray, pose: FloatArray, middles: FloatArray) -> FloatArray:
    """Unit vectors, (E, 3), in the head frame, from the centres of the eyeballs to their pupils (E, 2) in the image.

    Under weak perspective, the pupil is where the line of sight through its image meets the front of the eyeball. If
    the line misses the eyeball, the nearest point of its outline is used.
    """
    rotation = euler_to_matrix(*pose[1:4].tolist())
    centres = (middles + _BALL) @ rotation[:2].T
    aside = ((pupils - pose[4:6]) / pose[0] - centres) / _BALL_RADIUS
    # On a unit ball: (x, y) in the image plane, and the rest of the unit vector towards the viewer, -z.
    off = np.hypot(aside[:, 0], aside[:, 1])
    inwards = aside / np.maximum(off, 1.0)[:, None]
    towards = np.sqrt(np.maximum(1.0 - off * off, 0.0))
    # From the axes of the image back to the head frame.
    return np.asarray(np.column_stack([inwards, -towards]) @ rotation)


def _pupils(grey: NDArray[np.uint8], pose: FloatArray, outlines: FloatArray) -> FloatArray:
    """Find the pupil centres (E, 2) in the image for eyes with the given outlines (E, 6, 2)."""
    # Both eyes in one upright crop around their common centre.
    place = pose.copy()
    place[4:6] = outlines.reshape(-1, 2).sum(axis=0) / (6 * len(outlines))
    frame = warp_to_reference(grey, place, _SCALE, (_WIDTH, _HEIGHT))
    corners = np.round((outlines @ frame.linear.T + frame.offset) * 16.0).astype(np.int32)
    # The pupil lies within the lids; the gradients that vote may lie a pixel outside.
    masks = np.zeros((len(outlines), _HEIGHT, _WIDTH), np.uint8)
    for mask, polygon in zip(masks, corners, strict=True):
        cv2.fillConvexPoly(mask, polygon, (1,), cv2.LINE_8, 4)
    votes = _votes(frame.pixels, np.asarray(cv2.dilate(cv2.bitwise_or(masks[0], masks[-1]), _NEAR), np.uint8))
    peaks = np.array([_peak(votes, mask) for mask in masks])
    return np.asarray((peaks - frame.offset) @ frame.linear * (pose[0] / _SCALE) ** 2)


def _votes(pixels: NDArray[np.uint8], near: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Score each pixel as the centre of an iris, (h, w), by the votes of the gradients where `near` is not 0."""
    smooth = cv2.GaussianBlur(pixels.astype(np.float32), (5, 5), 0.9)
    right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = cv2.magnitude(right, down)
    # Directions count, not contrast: divide by the magnitude, plus its mean so that noise on flat skin stays small.
    weight = near / (strength + np.float32(cv2.mean(strength, near)[0] + 1e-3))
    # Votes: sum over the ring of gradient times outward direction, as a correlation per component.
    across = cv2.filter2D(right * weight, -1, _RING_X, borderType=cv2.BORDER_CONSTANT)
    along = cv2.filter2D(down * weight, -1, _RING_Y, borderType=cv2.BORDER_CONSTANT)
    # A pupil is also dark: weight by how much darker the disc around each pixel is than the brightest one.
    brightest = cv2.minMaxLoc(smooth, near)[1]
    darkness = np.float32(brightest + 2.0) - cv2.blur(smooth, _DISC)
    return np.asarray(np.maximum(across + along, 0.0) * np.maximum(darkness, 0.0), np.float32)


def _peak(votes: NDArray[np.float32], mask: NDArray[np.uint8]) -> tuple[float, float]:
    """Position `(x, y)` of the largest vote within the mask, refined by a parabola along each axis."""
    x, y = cv2.minMaxLoc(votes, mask)[3]
    if not (0 < x < _WIDTH - 1 and 0 < y < _HEIGHT - 1):
        return float(x), float(y)
    (_, up, _), (left, best, right), (_, down, _) = votes[y - 1 : y + 2, x - 1 : x + 2].tolist()
    return x + _vertex(left, best, right), y + _vertex(up, best, down)


def _vertex(before: float, best: float, after: float) -> float:
    """Vertex of the parabola through three values, from -0.5 to 0.5 relative to the middle one."""
    bend = before - 2.0 * best + after
    return min(max((before - after) / (2.0 * bend), -0.5), 0.5) if bend < 0.0 else 0.0


def _ring() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Kernels that sum, around a pixel, how far gradients point away from it at about the radius of an iris.

    The sides of the rim are weighted more than its top and bottom, which lids cover.
    """
    reach = int(1.35 * _IRIS)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    radius = np.maximum(np.hypot(x, y), 1e-9)
    ring = np.exp(-0.5 * ((radius - _IRIS) / (0.16 * _IRIS)) ** 2)
    ring *= 0.25 + 0.75 * (x / radius) ** 2
    ring /= ring.sum()
    return (ring * x / radius).astype(np.float32), (ring * y / radius).astype(np.float32)


_RING_X, _RING_Y = _ring()
_NEAR = np.ones((3, 3), np.uint8)
_DISC = (2 * int(0.5 * _IRIS) + 1,) * 2

"""From a performer's pose-free landmarks to displacements of an avatar's landmarks (METHOD section 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..apertures import eye_apertures, lid_gaps
from ..arrays import FloatArray, IntArray, as_points
from ..errors import HeadError, SourceError
from ..heads.regions import LOWER, REGIONS, membership, spread
from ..landmarks import EYE_CORNERS, LOWER_LIDS, LOWER_LIPS, N_LANDMARKS, UPPER_LIDS, UPPER_LIPS
from ..takes.neutral import Neutral
from .settings import Mode

_MEETING_RIMS = ((UPPER_LIDS, LOWER_LIDS), (UPPER_LIPS, LOWER_LIPS))
_NARROWEST_EYE = 0.15


class Retargeter:
    """Turns pose-free shapes of one performer into displacements of one avatar's landmarks.

    Parameters
    ----------
    neutral : (66, 3) array_like
        The performer's neutral shape: head frame, outer-eye distances.
    head_landmarks : (66, 3) array_like
        The avatar's landmarks at rest: head frame, the avatar's own unit.
    mode : {"3d", "planar"}
        `planar` keeps every depth at its neutral value, as the paper does.
    strength : (3,) array_like
        Gain of the regions upper, middle and lower.
    shut : float
        As in `Neutral`: where the performer's lids stop, the avatar's meet.
    mouth_gain : float
        As in `Neutral`: what the lower region's motion down and up is multiplied by beside its strength.

    Raises
    ------
    SourceError, HeadError
        Where the neutral face, or the avatar's landmarks, of a region lie on one line.

    Notes
    -----
    Motion is scaled by the ratio of the avatar's extent to the performer's, across and down separately, region by
    region; landmarks of two regions take the mean. Lids are scaled down by the ratio of the eyes' openings instead,
    so that a performer's closed eye closes the avatar's, whatever the shape of the two.
    """

    def __init__(
        self,
        neutral: ArrayLike,
        head_landmarks: ArrayLike,
        *,
        mode: Mode = "3d",
        strength: ArrayLike = (1.0, 1.0, 1.0),
        shut: float = 0.0,
        mouth_gain: float = 1.0,
    ) -> None:
        if mode not in ("3d", "planar"):
            raise HeadError(f'mode must be "3d" or "planar"; got {mode!r}.')
        self.neutral = as_points(neutral, "neutral", count=N_LANDMARKS, error=HeadError)
        self.head_landmarks = as_points(head_landmarks, "head_landmarks", count=N_LANDMARKS, error=HeadError)
        self.scale = _scale(self.neutral, self.head_landmarks)
        gains = np.asarray(strength, dtype=np.float64)
        members = membership()
        self.scale *= ((members * gains[:, None]).sum(axis=0) / members.sum(axis=0))[:, None]
        self.scale[REGIONS[LOWER].landmarks, 1] *= mouth_gain
        self._rest_heights = self.head_landmarks[:, 1]
        self._open = lid_gaps(self.neutral)
        self._closing_gain = self.scale[UPPER_LIDS, 1] * shut / (1.0 - shut)
        if mode == "planar":
            self.scale[:, 2] = 0.0

    def displacements(self, shape: ArrayLike) -> FloatArray:
        """(66, 3) displacements of the avatar's landmarks, head frame and the avatar's unit.

        Parameters
        ----------
        shape : (66, 3) array_like
            The performer's pose-free shape.
        """
        current = as_points(shape, "shape", count=N_LANDMARKS)
        moved = np.asarray(self.scale * (current - self.neutral))
        moved[UPPER_LIDS, 1] += self._closing_gain * np.maximum(self._open - lid_gaps(current), 0.0)
        for upper, lower in _MEETING_RIMS:
            _keep_apart(moved, upper, lower, self._rest_heights)
        return moved


def retargeter_for(
    neutral: Neutral, head_landmarks: ArrayLike, *, mode: Mode = "3d", strength: ArrayLike = (1.0, 1.0, 1.0)
) -> Retargeter:
    """The retargeter that knows all that `neutral` tells; the rest as for `Retargeter`."""
    gain = neutral.mouth_gain
    return Retargeter(neutral.shape, head_landmarks, mode=mode, strength=strength, shut=neutral.shut, mouth_gain=gain)


def _keep_apart(moved: FloatArray, upper: IntArray, lower: IntArray, rest: FloatArray) -> None:
    """Let rims that meet stop at each other, half way between where they would have crossed; in place."""
    crossed = (rest[upper] + moved[upper, 1]) - (rest[lower] + moved[lower, 1])
    allowed = np.maximum(rest[upper] - rest[lower], 0.0)
    excess = np.maximum(crossed - allowed, 0.0) / 2.0
    moved[upper, 1] -= excess
    moved[lower, 1] += excess


def _scale(neutral: FloatArray, head: FloatArray) -> FloatArray:
    """(66, 3) factor from the performer's displacement of each landmark to the avatar's."""
    members = membership()
    ratios = np.empty((len(REGIONS), 3))
    for row, region in zip(ratios, REGIONS, strict=True):
        across = spread(neutral[region.landmarks])
        if not (across > 0).all():
            raise SourceError("The neutral face is no face: landmarks lie on one line. Choose another neutral or take.")
        row[:2] = spread(head[region.landmarks]) / across
        if not (row[:2] > 0).all():
            raise HeadError("All landmarks of a region lie on one line. Bind them to the vertices that they name.")
        row[2] = np.sqrt(row[0] * row[1])
    scale: FloatArray = np.asarray(members.T @ ratios / members.sum(axis=0)[:, None])
    opening = _opening(head) / _opening(neutral)
    for lids in (UPPER_LIDS, LOWER_LIDS):
        scale[lids, 1] = np.repeat(opening, 2)
    return scale


def _opening(points: FloatArray) -> FloatArray:
    """Mean height of the right and the left eye's opening, (2,); a squint counts as an eye that is open a little."""
    height = eye_apertures(points)
    width = np.linalg.norm(points[EYE_CORNERS[1::2]] - points[EYE_CORNERS[::2]], axis=1)
    return np.asarray(np.maximum(height, _NARROWEST_EYE * width))

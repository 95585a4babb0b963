"""From a performer's pose-free landmarks to displacements of an avatar's (method.md, sections 4.2 to 4.4), or to the
average face (section 8.4).
"""

from __future__ import annotations

from dataclasses import replace
from math import nan

import numpy as np
from numpy.typing import ArrayLike

from ..errors import HeadError, SourceError
from ..face.landmarks import (
    BROWS,
    CHIN,
    EYE_CORNERS,
    LIPS,
    LOWER_LIDS,
    LOWER_LIP,
    LOWER_LIPS,
    MOUTH_CORNERS,
    N_LANDMARKS,
    UPPER_LIDS,
    UPPER_LIP,
    UPPER_LIPS,
    eye_apertures,
    from_ibug,
    lid_gaps,
    lid_normals,
    mouth_aperture,
)
from ..heads.regions import LOWER, REGIONS, membership, rms_extent
from ..numeric.arrays import FloatArray, IntArray, as_points
from ..takes.correction import without_pins
from ..takes.neutral import Neutral, calibrate
from ..takes.take import Take
from ..takes.timing import mark_lost, project
from ..tracking.tracker import FaceTracker
from .drive_settings import Mode

_FACING_LIPS = ((UPPER_LIP, LOWER_LIP), (UPPER_LIPS, LOWER_LIPS))
"""Upper and lower landmarks of the outer and the inner lips."""
_LIP_GAIN = (1.4, 1.4)
"""Gains of the width of the mouth and of the motion of the lips down. The tracker underestimates these, as its experts
are uncertain about lips and its shape model draws them towards the mean. Chosen on one half of the strangers' clips
(`lab.bench.strangers`) for a median ratio to MediaPipe's landmarks of 0.9 to 1.1, if the signs of hand-labelled clips
do not suffer. Between the corners, lips move across as far as MediaPipe's, on both halves; mouths that move sideways
are tracked in full on rendered clips with exact landmarks, and were shown on the wrong side of hand labels."""
_LIPS_SHUT = 0.01
"""Distance in eye distances from rest up to which parted lips are shut. Shut lips are tracked as up to this far apart
in nine of ten frames. This and the next were chosen on one half of the strangers' clips (`lab.bench.strangers`)."""
_LIPS_PARTED = 0.035
"""Distance from which they are as far apart as they are seen."""
_LIPS_WIDE = 0.12
"""Distance in eye distances from rest beyond which the gain is less. Up to it, lips are shown as far apart as by
MediaPipe; without this and the next, 1.14 times as far where they are 0.27 apart, on both halves."""
_WIDE_SHARE = 0.72
"""Share of the opening beyond it that is shown."""
_CORNERS_FOLLOW = 0.4
"""How far the corners of a mouth follow its lower lip, as in `lab.bench.expressions`."""
_ROUNDER = np.zeros((N_LANDMARKS, 2))
"""How far landmarks of the lips move across and down per opening of the mouth, beyond what is tracked: wide mouths are
tracked as pointed. Shares of the mean differences from MediaPipe's landmarks at openings above 0.15 on half of the
strangers' clips, which the other half confirms: 0.6 of those across, as more lowers the correlation of the width, and
0.5 and 0.75 of those down, as its landmarks lie nearer to the middle."""
_ROUNDER[from_ibug((48, 54)), 0] = -0.04, 0.04
_ROUNDER[from_ibug((49, 53)), 0] = -0.03, 0.03
_ROUNDER[from_ibug((59, 55)), 0] = -0.06, 0.06
_ROUNDER[from_ibug((58, 56)), 1] = 0.06
_ROUNDER[from_ibug((67, 65)), 1] = 0.12
_BROW_GAIN = 1.1
"""Gain of the brows' motion up and down. On rendered clips of twelve people with exact landmarks, they are tracked as
moving 0.93 times as far, on both halves (`lab.bench.correct`)."""
_BROW_TILT = 0.15
"""By how much the outer end of a brow rises above the inner one when the brow rises by 1, to make up for what it is
tracked as tilting: 0.12 too much on one half of the strangers' clips, 0.18 on the other."""
_OVERLAP = 0.02
"""Share of the opening by which shut lids overlap at most. On a character of MakeHuman's 0.5 % of the eyes are visible
then, instead of 1.3 %."""
_MIN_EYE_OPENING = 0.15
"""Smallest opening of an eye that is used, as a share of its width: squinting in the neutral face would otherwise
amplify lids without bound."""

_TILT = np.array([[2.0, 1.0, 0.0, -1.0, -2.0], [-2.0, -1.0, 0.0, 1.0, 2.0]]) / 3.0
"""Heights of the landmarks of both brows from their middle, for a height of 1 between the means of their ends."""

_OPENING = np.zeros(N_LANDMARKS)
"""Weights of heights whose sum is how far the inner lips are apart."""
_OPENING[LOWER_LIPS] = 1.0 / len(LOWER_LIPS)
_OPENING[UPPER_LIPS] = -1.0 / len(UPPER_LIPS)
_WIDER = np.array([[1.0, -1.0], [-1.0, 1.0]])
"""From the places of the mouth's corners across to how far each is from the other."""
_UPPER, _LOWER = (np.concatenate(lips) for lips in zip(*_FACING_LIPS, strict=True))


class Retargeter:
    """Converts pose-free shapes of a performer to displacements of an avatar's landmarks.

    `neutral` (66, 3) is the performer's neutral shape in outer-eye distances, and `head_landmarks` (66, 3) are the
    avatar's at rest in its own unit, both in the head frame. Mode "planar" keeps all depths at their neutral values, as
    in the paper. `strength` (3,) holds factors of the regions upper, middle and lower; `mouth_gain`, from `Neutral`, is
    a further factor of the vertical motion of the lower region. `shut`, from `Neutral`, is the lid opening of the
    performer at which the avatar's lids meet. `compensate` is whether to compensate for the tracker's errors: it
    underestimates motion of lips and brows, sees shut lips as slightly parted, and is unsure at which end an eye closes
    first. If shape keys are to be `fitted` to the displacements, all of the lips has the gain of the mouth's width, and
    wide mouths are left as they are, as in those that the fit was learnt from.

    Displacements are scaled by the ratio of the avatar's extent to the performer's, per region, horizontally and
    vertically (equation 4.2); landmarks of two regions take the mean. Lower lids are scaled vertically by the ratio of
    the openings of the eyes instead, and each upper lid is placed above its lower lid so that the avatar's eye is open
    by the same share as the performer's (equation 4.3): a closed eye closes the avatar's along its whole width.

    Raises SourceError or HeadError if the landmarks of a region lie on one line, in the neutral face or in the avatar.
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
        compensate: bool = False,
        fitted: bool = False,
    ) -> None:
        if mode not in ("3d", "planar"):
            raise HeadError('mode must be "3d" or "planar"; got {mode!r}.', mode=mode)
        self.neutral = as_points(neutral, "neutral", count=N_LANDMARKS, error=HeadError)
        self.head_landmarks = as_points(head_landmarks, "head_landmarks", count=N_LANDMARKS, error=HeadError)
        self.scale = _scale(self.neutral, self.head_landmarks)
        # Equation 4.2, times the user's strength per region, averaged for landmarks of two regions.
        gains = np.asarray(strength, dtype=np.float64)
        members = membership()
        self.scale *= ((members * gains[:, None]).sum(axis=0) / members.sum(axis=0))[:, None]
        self.scale[REGIONS[LOWER].landmarks, 1] *= mouth_gain
        if compensate:
            across, down = _LIP_GAIN
            self.scale[LIPS, 1] *= down
            if fitted:
                self.scale[LIPS, 0] *= across
        self._seals, self._shapes = compensate, compensate and not fitted
        self._brows_more = (_BROW_GAIN - 1.0 + _BROW_TILT * _TILT) * compensate
        self._rest_heights, self._rest_gaps = self.head_landmarks[:, 1], lid_gaps(self.head_landmarks)
        self._least_gaps = np.minimum(self._rest_gaps, -_OVERLAP * np.abs(self._rest_gaps))
        self._lids = _Lids(self.neutral, self.head_landmarks, shut, compensate=compensate)
        self._lid_strength = (members * gains[:, None]).sum(axis=0)[UPPER_LIDS] / members.sum(axis=0)[UPPER_LIDS]
        if mode == "planar":
            self.scale[:, 2] = 0.0
        # Lips belong to two regions, whose factors differ. The lower lip moves relative to the upper one by its own
        # factor: a mouth that moves as a whole would otherwise open.
        heights = self.scale[:, 1]
        self._with_upper = [(upper, lower, heights[upper] - heights[lower]) for upper, lower in _FACING_LIPS]

    def displacements(self, shape: ArrayLike, teeth: ArrayLike = nan) -> FloatArray:
        """Return displacements (..., 66, 3) from rest, head frame and unit of the avatar, for a performer's shapes.

        How surely their `teeth` (...) are shut is as in `TrackResult`; where they are, the chin does not sink.
        """
        given = np.asarray(shape, dtype=np.float64)
        current = as_points(given.reshape(-1, 3), "shape", count=max(given.size // 3, N_LANDMARKS)).reshape(given.shape)
        away = current - self.neutral
        moved = np.asarray(self.scale * away)
        for upper, lower, more in self._with_upper:
            moved[..., lower, 1] += more * away[..., upper, 1]
        if self._seals:
            _seal(moved, away)
        if self._shapes:
            _shape_mouth(moved, away)
        # Section 4.3: a jaw whose teeth are shut is not open, although the tracked chin follows the lower lip.
        parted = 1.0 - np.nan_to_num(np.asarray(teeth, dtype=np.float64))[..., None]
        moved[..., CHIN, 1] = np.where(moved[..., CHIN, 1] > 0.0, parted, 1.0) * moved[..., CHIN, 1]
        # Each brow moves farther as a whole, and tilts less.
        brows = moved[..., BROWS, 1].reshape(*moved.shape[:-2], 2, -1).mean(axis=-1)
        moved[..., BROWS, 1] += (brows[..., None] * self._brows_more).reshape(*brows.shape[:-1], -1)
        # Equation 4.3: each upper lid moves with its lower one, and closes by its share of the opening, across the eye
        # as it is tilted now. Shut lids overlap a little, or the eye would show between their rims.
        posed = self.head_landmarks + moved
        wanted = np.maximum(self._rest_gaps - self._lid_strength * self._lids.closing(current), self._least_gaps)
        moved[..., UPPER_LIDS, :2] += (lid_gaps(posed) - wanted)[..., None] * lid_normals(posed)
        _keep_apart(moved, UPPER_LIPS, LOWER_LIPS, self._rest_heights)
        return moved


class _Lids:
    """By how much the pairs of an avatar's lids close (equation 4.3).

    `shut` is the share of the neutral opening at which the performer's lids are taken to meet.
    """

    def __init__(self, neutral: FloatArray, head: FloatArray, shut: float, *, compensate: bool) -> None:
        self._open, self._shut, self._compensate = lid_gaps(neutral), shut, compensate
        self._neutral_open, self._head_open = (np.maximum(lid_gaps(face), _least(face)) for face in (neutral, head))

    def closing(self, current: FloatArray) -> FloatArray:
        """Compute by how much each pair closes, (..., 4), in the unit of the avatar, for shapes (..., 66, 3)."""
        closed = (self._open - lid_gaps(current)) / self._neutral_open
        share = 1.0 - closed / np.where(closed > 0.0, 1.0 - self._shut, 1.0)
        if self._compensate:
            # The tracker is unsure at which end an eye closes first: the more it is shut, the less the pairs differ.
            eye = np.repeat(0.5 * (share[..., ::2] + share[..., 1::2]), 2, axis=-1)
            share = eye + (share - eye) * np.clip(eye, 0.0, 1.0)
        return np.asarray(self._head_open * (1.0 - share))


def _least(points: FloatArray) -> FloatArray:
    """Smallest gap between facing lids that is used, (4,)."""
    width = np.linalg.norm(points[EYE_CORNERS[1::2]] - points[EYE_CORNERS[::2]], axis=1)
    return np.asarray(np.repeat(_MIN_EYE_OPENING * width, 2))


def retargeter_for(
    neutral: Neutral,
    head_landmarks: ArrayLike,
    *,
    mode: Mode = "3d",
    strength: ArrayLike = (1.0, 1.0, 1.0),
    fitted: bool = False,
) -> Retargeter:
    """Create a `Retargeter` from all that a neutral face contains; the other arguments are as for the class."""
    gain = neutral.mouth_gain
    return Retargeter(
        neutral.shape,
        head_landmarks,
        mode=mode,
        strength=strength,
        shut=neutral.shut,
        mouth_gain=gain,
        compensate=not neutral.measured,
        fitted=fitted,
    )


def _seal(moved: FloatArray, away: FloatArray) -> None:
    """Shut lips that are hardly parted (equation 4.9), in displacements (..., 66, 3), in place.

    `away` (..., 66, 3) are the performer's.
    """
    parted = away[..., 1] @ _OPENING
    steepness = _LIPS_PARTED / (_LIPS_PARTED - _LIPS_SHUT)
    left = np.clip(steepness * (1.0 - _LIPS_SHUT / np.maximum(parted, _LIPS_SHUT)), 0.0, 1.0)
    opening = moved[..., LOWER_LIPS, 1] - moved[..., UPPER_LIPS, 1]
    less = np.maximum(opening, 0.0) * (1.0 - left)[..., None] / 2.0
    moved[..., UPPER_LIPS, 1] += less
    moved[..., LOWER_LIPS, 1] -= less


def _shape_mouth(moved: FloatArray, away: FloatArray) -> None:
    """Change the width of a mouth by its gain, and open wide mouths less far (equation 4.10) and rounder.

    This changes displacements (..., 66, 3) in place; `away` (..., 66, 3) are the performer's.
    """
    moved[..., MOUTH_CORNERS, 0] += 0.5 * (_LIP_GAIN[0] - 1.0) * (moved[..., MOUTH_CORNERS, 0] @ _WIDER)
    beyond = np.maximum(away[..., 1] @ _OPENING - _LIPS_WIDE, 0.0)
    less = (1.0 - _WIDE_SHARE) * beyond / (beyond + _LIPS_WIDE)
    opened = np.maximum(moved[..., 1] @ _OPENING, 0.0)
    opening = moved[..., _LOWER, 1] - moved[..., _UPPER, 1]
    moved[..., _LOWER, 1] -= less[..., None] * np.maximum(opening, 0.0)
    moved[..., MOUTH_CORNERS, 1] -= _CORNERS_FOLLOW * (less * opened)[..., None]
    moved[..., :2] += ((1.0 - less) * opened)[..., None, None] * _ROUNDER


def _keep_apart(moved: FloatArray, upper: IntArray, lower: IntArray, rest: FloatArray) -> None:
    """Move rims that would cross apart, each by half the overlap, in displacements (..., 66, 3), in place."""
    crossed = (rest[upper] + moved[..., upper, 1]) - (rest[lower] + moved[..., lower, 1])
    allowed = np.maximum(rest[upper] - rest[lower], 0.0)
    excess = np.maximum(crossed - allowed, 0.0) / 2.0
    moved[..., upper, 1] -= excess
    moved[..., lower, 1] += excess


def _scale(neutral: FloatArray, head: FloatArray) -> FloatArray:
    """Factors (66, 3) from the performer's displacements to the avatar's (equation 4.2)."""
    members = membership()
    ratios = np.empty((len(REGIONS), 3))
    for row, region in zip(ratios, REGIONS, strict=True):
        across = rms_extent(neutral[region.landmarks])
        if not (across > 0).all():
            raise SourceError("The landmarks of the neutral face lie on one line. Choose another neutral face or take.")
        row[:2] = rms_extent(head[region.landmarks]) / across
        if not (row[:2] > 0).all():
            raise HeadError("All landmarks of a region lie on one line. Bind them again.")
        row[2] = np.sqrt(row[0] * row[1])
    scale: FloatArray = np.asarray(members.T @ ratios / members.sum(axis=0)[:, None])
    # Lower lids use the ratio of the openings, which replaces the vertical factor; upper lids follow from equation 4.3.
    scale[LOWER_LIDS, 1] = np.repeat(_opening(head) / _opening(neutral), 2)
    return scale


def _opening(points: FloatArray) -> FloatArray:
    """Opening of the right and left eye, (2,); at least a small share of the eye's width."""
    return np.asarray(np.maximum(eye_apertures(points), _least(points)[::2]))


_KEPT_INFO = (
    *("fps", "image_size", "model", "clock", "measured"),
    *("mirrored", "smoothed", "bridged", "punched_in", "interrupted"),
)
"""Technical entries of `Take.info` that an anonymous take keeps."""


def anonymise(take: Take) -> Take:
    """Remove the performer's name and face from a take; an average face then moves as the performer's did.

    The shape of each frame becomes the mean face of the model, displaced by `Retargeter`, and landmarks follow from it.
    Shape parameters, pupils and landmark confidences, which depend on the performer's face, are removed, as are names
    and dates in `info`. The take drives a head as before, up to rounding. The motion remains, and somebody who knows
    the performer may recognise them by it.
    """
    take = without_pins(take)
    info = {key: take.info[key] for key in _KEPT_INFO if key in take.info}
    result = replace(mark_lost(take, np.ones(len(take), bool)), found=take.found.copy(), info=info)
    result.confidence[:] = take.confidence
    for name in ("pose", "gaze", "vergence", "actions", "teeth", "coefficients"):
        getattr(result, name)[:] = getattr(take, name)
    if not take.found.any():
        return result
    neutral, mean = calibrate(take), FaceTracker.load().pdm.mean_shape
    retargeter = Retargeter(neutral.shape, mean)
    for frame in np.flatnonzero(take.found).tolist():
        result.shape[frame] = mean + retargeter.displacements(take.shape[frame])
    seen = result.found
    result.landmarks[seen] = project(result.shape[seen].astype(np.float64), result.pose[seen])
    opened = neutral.open_mouth - float(mouth_aperture(neutral.shape))
    average = replace(neutral, shape=mean, open_mouth=float(mouth_aperture(mean)) + opened)
    return replace(result, info={**info, "calibration": average.to_dict()})

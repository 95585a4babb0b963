"""Mending a take: frames that jump out of line, gaps, the wrong side of the mirror, another neutral; and privacy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import SourceError
from ..rotation import euler_to_matrix
from ..tracking.mirror import mirror_result
from ..tracking.tracker import FaceTracker
from .neutral import Neutral, calibrate
from .smooth import smooth_take, smooth_zero_phase
from .take import Take, TakeRecorder
from .timing import mark_lost, mix

Gaps = Literal["leave", "bridge", "hold"]
Smoothing = Literal["none", "one-euro", "zero-phase"]


@dataclass(frozen=True)
class Mending:
    """What is done to a take, in this order.

    Attributes
    ----------
    outliers : bool
        Drop frames that jump out of line.
    gaps : {"leave", "bridge", "hold"}
        What is done where no face was found, as for `bridge_gaps`.
    longest : float
        Seconds of the longest gap that is filled.
    smoothing : {"none", "one-euro", "zero-phase"}
        As it is done live, or without delay.
    cutoffs : mapping of str to float
        For "zero-phase": Hz by part, where they are not as by default.
    mirror : bool
        Swap left and right.
    neutral : float, optional
        Seconds at which the face is the neutral one.
    """

    outliers: bool = False
    gaps: Gaps = "leave"
    longest: float = 1.0
    smoothing: Smoothing = "none"
    cutoffs: Mapping[str, float] = field(default_factory=dict)
    mirror: bool = False
    neutral: float | None = None


def mend(take: Take, mending: Mending) -> Take:
    """`take` with everything done to it that `mending` names.

    Raises
    ------
    SourceError
        Where a number makes no sense, or no face was found where the neutral one is to be.
    """
    if mending.outliers:
        take = remove_outliers(take)
    if mending.gaps != "leave":
        take = bridge_gaps(take, mending.gaps, mending.longest)
    if mending.smoothing == "one-euro":
        take = smooth_take(take)
    elif mending.smoothing == "zero-phase":
        take = smooth_zero_phase(take, mending.cutoffs)
    if mending.mirror:
        take = mirror_tracked(take)
    return take if mending.neutral is None else renew_neutral(take, mending.neutral)


_LEAST = (0.05, 0.12, 0.2)
"""What is never an outlier: landmarks' distance in eye distances, turn in radians, move in eye distances."""
_TIMES_NOISE = 8.0
_NEIGHBOURS = 2
_NEUTRAL_SPAN = 0.2


def bridge_gaps(take: Take, how: Literal["bridge", "hold"] = "bridge", longest: float = 1.0) -> Take:
    """Fill the gaps in which no face was found, between two frames in which one was.

    A filled frame counts as found, so that everything behind drives it as any other, but its confidence is 0, as
    nothing was seen; `info["bridged"]` lists the spans. What is before the first face or behind the last stays lost.

    Parameters
    ----------
    how : {"bridge", "hold"}
        Move evenly from the last face to the next, or stay as the last was.
    longest : float
        Seconds from face to face; longer gaps stay.

    Raises
    ------
    SourceError
        Where `longest` is below 0.
    """
    if not longest >= 0.0:
        raise SourceError(f"No gap is at most {longest} s long. Give 0 or more.")
    seen = np.flatnonzero(take.found)
    if not len(seen):
        return take
    lost = np.flatnonzero(~take.found)
    place = np.searchsorted(seen, lost)
    inside = (place > 0) & (place < len(seen))
    lost, place = lost[inside], place[inside]
    before, after = seen[place - 1], seen[place]
    span = take.times[after] - take.times[before]
    short = span <= longest
    lost, before, after, span = lost[short], before[short], after[short], span[short]
    share = (take.times[lost] - take.times[before]) / span if how == "bridge" else np.zeros(len(lost))
    filling = mix(take.part(before), take.part(after), share)
    result = mark_lost(take, np.zeros(len(take), bool))
    for name in ("landmarks", "pose", "shape_params", "shape", "pupils", "gaze", "found"):
        getattr(result, name)[lost] = getattr(filling, name)
    result.landmark_confidence[lost], result.confidence[lost] = 0.0, 0.0
    spans = np.unique(np.stack([take.times[before], take.times[after]], axis=1), axis=0).tolist()
    return replace(result, info={**take.info, "bridged": [*take.info.get("bridged", []), *spans]})


def find_outliers(take: Take) -> NDArray[np.bool_]:
    """(N,) whether a frame jumps out of line and the next ones are back: a fit gone wrong, not a movement.

    A frame is held against the median of itself and its two neighbours on either side: the root mean square distance of
    all 66 landmarks of the shape, the turn of the head, its place and size. An outlier is further than a face moves
    from one frame to the next, and than eight times what this take's frames usually differ. A blink moves few landmarks
    and passes.
    """
    outliers = np.zeros(len(take), dtype=np.bool_)
    seen = np.flatnonzero(take.found)
    if len(seen) < 2 * _NEIGHBOURS + 1:
        return outliers
    turns = np.array([euler_to_matrix(*angles).ravel() for angles in take.pose[seen, 1:4]])
    unit = np.median(take.pose[seen, 0])
    place = np.column_stack([np.log(take.pose[seen, 0]), take.pose[seen, 4:6] / unit])
    shape = take.shape[seen].reshape(len(seen), -1).astype(np.float64)
    scales = (np.sqrt(1.0 / take.shape.shape[1]), np.sqrt(0.5), 1.0)  # of a turn's matrix: its norm is sqrt(2) angle
    for values, scale, least in zip((shape, turns, place), scales, _LEAST, strict=True):
        away = scale * np.linalg.norm(values - _running_median(values), axis=1)
        outliers[seen] |= away > max(least, _TIMES_NOISE * float(np.median(away)))
    return outliers


def _running_median(values: FloatArray) -> FloatArray:
    """(N, D) median over each row and its neighbours; at the ends over those that there are, mirrored."""
    padded = np.pad(values, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect")
    shifted = [padded[i : i + len(values)] for i in range(2 * _NEIGHBOURS + 1)]
    return np.asarray(np.median(shifted, axis=0))


def remove_outliers(take: Take) -> Take:
    """The take with no face in the frames that `find_outliers` tells; `bridge_gaps` closes them."""
    return mark_lost(take, find_outliers(take))


def mirror_take(take: Take, mode_signs: FloatArray | None = None) -> Take:
    """The performance as seen in a mirror; twice is the take again. `mode_signs` as for `mirror_result`."""
    width = float(take.info.get("image_size", (640, 480))[0])
    info: dict[str, Any] = {**take.info, "mirrored": not take.info.get("mirrored", False)}
    if "calibration" in info:
        neutral = Neutral.from_dict(info["calibration"]).mirrored()
        info["calibration"] = replace(neutral, position=neutral.position + (0.0, width - 1.0, 0.0)).to_dict()
    recorder = TakeRecorder(info)
    for frame, time in enumerate(take.times.tolist()):
        recorder.append(time, mirror_result(take.result(frame), width, mode_signs))
    return recorder.finish()


def mirror_tracked(take: Take) -> Take:
    """`mirror_take`, with the coefficients' signs where the take is of the tracker's present model."""
    tracker = FaceTracker.load()
    return mirror_take(take, tracker.pdm.mirror_signs if tracker.model_id == take.info.get("model") else None)


def renew_neutral(take: Take, frame_time: float) -> Take:
    """The take with the face about `frame_time`, seconds, as its neutral: `calibrate` gives that one from then on.

    Raises
    ------
    SourceError
        Where no face was found there.
    """
    neutral = calibrate(take, frame_time - _NEUTRAL_SPAN / 2.0, _NEUTRAL_SPAN)
    return replace(take, info={**take.info, "calibration": neutral.to_dict()})

"""Mending of takes: outliers, gaps, smoothing, mirroring, another neutral face (method.md, section 8.2), and a figure
of its effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import SourceError
from ..face.rotation import euler_to_matrices
from ..files.setting import Choice, setting
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..tracking.result import mirror_result
from ..tracking.tracker import FaceTracker
from .correction import solve_pins
from .neutral import Neutral, calibrate
from .pins import mirrored, pins_of, with_pins
from .smooth import CUTOFFS, before_after, smooth_take, smooth_zero_phase
from .take import FIELDS, Take, TakeRecorder
from .timing import mark_lost, mix

_WIDTH = 1200
"""Width of the figure in pixels."""
_HEIGHT = 110
"""Height of the strip of one part in pixels."""
_LEFT = 130
"""Width in pixels of the space for the name of the part, left of the curves."""
_EDGE = 12
"""Margin of a strip in pixels."""
_BEFORE = (170, 170, 170)
"""Colour of the curve before mending, BGR."""
_AFTER = (80, 130, 30)
"""Colour of the curve after mending, BGR."""
_INK = (60, 60, 60)
"""Colour of the names, BGR."""

Gaps = Literal["leave", "bridge", "hold"]
Smoothing = Literal["none", "one-euro", "zero-phase"]


@dataclass(frozen=True)
class Mending:
    """Steps of mending, applied in the order of the fields.

    Attributes
    ----------
    gaps : {"leave", "bridge", "hold"}
        What to do with gaps without a face, as for `bridge_gaps`.
    longest : float
        Longest gap to fill in seconds.
    smoothing : {"none", "one-euro", "zero-phase"}
        No smoothing, smoothing as live, or smoothing without delay.
    cutoffs : mapping of str to float
        Cutoffs in Hz by part for "zero-phase", overriding `smooth.CUTOFFS`.
    mirror : bool
        Whether to swap left and right.
    neutral : float, optional
        Time of the new neutral face in seconds.
    """

    outliers: bool = setting(False, "Remove Outliers", "Remove frames that differ abruptly from their neighbours")
    gaps: Gaps = setting(
        "leave",
        "Gaps",
        "What to do with gaps without a face",
        choices=(
            Choice("leave", "Leave", "Leave gaps as they are"),
            Choice("bridge", "Interpolate", "Interpolate between the frames on both sides"),
            Choice("hold", "Hold", "Repeat the last frame with a face"),
        ),
    )
    longest: float = setting(
        1.0, "Longest Gap", "Longest gap to fill", low=0.0, high=3600.0, soft_high=10.0, unit="seconds"
    )
    smoothing: Smoothing = setting(
        "none",
        "Smooth",
        "How the motion is smoothed",
        choices=(
            Choice("none", "None", "Leave the motion as it is"),
            Choice("one-euro", "As Live", "Smooth as a live puppet does, with some lag"),
            Choice("zero-phase", "Without Delay", "Smooth forwards and backwards, without lag"),
        ),
    )
    cutoffs: Mapping[str, float] = field(default_factory=dict)
    mirror: bool = setting(False, "Mirror", "Swap left and right")
    neutral: float | None = None


REPAIR = Mending(outliers=True, gaps="bridge", smoothing="zero-phase")
"""What most takes need, offered by the panel."""


def mend(take: Take, mending: Mending) -> Take:
    """Mend a take step by step.

    Raises SourceError if a number is out of range, or there is no face at the time of the neutral face.
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


_MIN_DEVIATIONS = (0.05, 0.12, 0.2)
"""Deviations below which a frame is never an outlier: landmarks in eye distances, rotation in radians, and position in
eye distances together with the logarithm of the scale."""
_TIMES_MEDIAN = 8.0
"""Multiple of the median deviation above which a frame is an outlier."""
_NEIGHBOURS = 2
"""Number of frames on either side with which a frame is compared."""
_NEUTRAL_SPAN = 0.2
"""Seconds that are averaged for a neutral face that the user chose."""


def bridge_gaps(take: Take, how: Literal["bridge", "hold"] = "bridge", longest: float = 1.0) -> Take:
    """Fill gaps between two frames with a face, up to `longest` seconds, by interpolation or by holding the last face.

    Filled frames count as found, so that they drive a head as any other, with confidence 0, as nothing was seen.
    ``info["bridged"]`` lists their spans. Frames before the first and after the last face stay lost. Raises SourceError
    if `longest` is negative.
    """
    if not longest >= 0.0:
        raise SourceError("The longest gap cannot be {longest} s. Use 0 or more.", longest=longest)
    seen = np.flatnonzero(take.found)
    if not len(seen):
        return take
    lost = np.flatnonzero(~take.found)
    # Lost frames between two with a face, and the neighbours of each gap.
    place = np.searchsorted(seen, lost)
    inside = (place > 0) & (place < len(seen))
    lost, place = lost[inside], place[inside]
    before, after = seen[place - 1], seen[place]
    span = take.times[after] - take.times[before]
    short = span <= longest
    lost, before, after, span = lost[short], before[short], after[short], span[short]
    share = (take.times[lost] - take.times[before]) / span if how == "bridge" else np.zeros(len(lost))
    # Interpolate, or hold the frame before; confidence is 0, as nothing was seen.
    filling = mix(take.part(before), take.part(after), share)
    result = mark_lost(take, np.zeros(len(take), bool))
    for name in set(FIELDS) - {"times", "landmark_confidence", "confidence"}:
        getattr(result, name)[lost] = getattr(filling, name)
    result.landmark_confidence[lost], result.confidence[lost] = 0.0, 0.0
    spans = np.unique(np.stack([take.times[before], take.times[after]], axis=1), axis=0).tolist()
    return replace(result, info={**take.info, "bridged": [*take.info.get("bridged", []), *spans]})


def find_outliers(take: Take) -> NDArray[np.bool_]:
    """Find outliers, (N,): failed fits rather than motion, as the next frames are back in line.

    A frame is compared with the median of five frames around it: the landmarks of the shape (root mean square), the
    rotation, and the position and size. An outlier deviates by more than a face moves between frames, and by more than
    eight times the median deviation of the take. A blink moves few landmarks and passes.
    """
    outliers = np.zeros(len(take), dtype=np.bool_)
    seen = np.flatnonzero(take.found)
    if len(seen) < 2 * _NEIGHBOURS + 1:
        return outliers
    turns = euler_to_matrices(take.pose[seen, 1:4]).reshape(-1, 9)
    unit = np.median(take.pose[seen, 0])
    place = np.column_stack([np.log(take.pose[seen, 0]), take.pose[seen, 4:6] / unit])
    shape = take.shape[seen].reshape(len(seen), -1).astype(np.float64)
    # A difference of rotation matrices has the norm sqrt(2) angle.
    scales = np.sqrt(1.0 / take.shape.shape[1]), np.sqrt(0.5), 1.0
    for values, scale, least in zip((shape, turns, place), scales, _MIN_DEVIATIONS, strict=True):
        usual = linalg.part("ndimage").median_filter(values, (2 * _NEIGHBOURS + 1, 1), mode="mirror")
        away = scale * np.linalg.norm(values - usual, axis=1)
        outliers[seen] |= away > max(least, _TIMES_MEDIAN * float(np.median(away)))
    return outliers


def remove_outliers(take: Take) -> Take:
    """Mark the frames of `find_outliers` as lost; `bridge_gaps` can fill them."""
    return mark_lost(take, find_outliers(take))


def mirror_take(take: Take, mode_signs: FloatArray | None = None) -> Take:
    """Mirror a take left to right, with `mode_signs` as for `mirror_result`. Mirroring twice gives the take again."""
    width = float(take.info.get("image_size", (640, 480))[0])
    info: dict[str, Any] = {**take.info, "mirrored": not take.info.get("mirrored", False)}
    if "calibration" in info:
        neutral = Neutral.from_dict(info["calibration"]).mirrored()
        info["calibration"] = replace(neutral, position=neutral.position + (0.0, width - 1.0, 0.0)).to_dict()
    recorder = TakeRecorder(info)
    for frame, time in enumerate(take.times.tolist()):
        recorder.append(time, mirror_result(take.result(frame), width, mode_signs))
    return with_pins(recorder.finish(), mirrored(pins_of(take), width))


def mirror_tracked(take: Take) -> Take:
    """Mirror a take, including its shape parameters if they belong to the current model of the tracker."""
    tracker = FaceTracker.load()
    return mirror_take(take, tracker.pdm.mirror_signs if tracker.model_id == take.info.get("model") else None)


def renew_neutral(take: Take, frame_time: float) -> Take:
    """Make `calibrate` return the face at a time in seconds; raises SourceError if there is no face then."""
    neutral = calibrate(solve_pins(take), frame_time - _NEUTRAL_SPAN / 2.0, _NEUTRAL_SPAN)
    return replace(take, info={**take.info, "calibration": neutral.to_dict()})


def draw_before_after(take: Take, mended: Take) -> NDArray[np.uint8]:
    """Draw the curves of `before_after` for every part, over the time of both takes: a figure (H, W, 3), BGR."""
    times = np.concatenate([take.times, mended.times])
    start, length = float(times.min()), max(float(np.ptp(times)), 1e-9)
    strips = []
    for part in CUTOFFS:
        strip = np.full((_HEIGHT, _WIDTH, 3), 255, np.uint8)
        curves = before_after(take, mended, part)
        known = np.concatenate([curves.before, curves.after])
        known = known[np.isfinite(known)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        for at, values, colour in ((curves.times, curves.before, _BEFORE), (curves.mended_times, curves.after, _AFTER)):
            x = _LEFT + (at - start) / length * (_WIDTH - _LEFT - _EDGE)
            y = _EDGE + (high - values) / max(high - low, 1e-9) * (_HEIGHT - 2 * _EDGE)
            _draw(strip, x, y, colour)
        cv2.putText(strip, part, (_EDGE, _HEIGHT // 2), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)
        cv2.line(strip, (0, _HEIGHT - 1), (_WIDTH, _HEIGHT - 1), (230, 230, 230), 1)
        strips.append(strip)
    return np.vstack(strips)


def _draw(strip: NDArray[np.uint8], x: FloatArray, y: FloatArray, colour: tuple[int, int, int]) -> None:
    """Draw a line through known points, interrupted at unknown ones."""
    known = np.flatnonzero(np.isfinite(y))
    for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        points = (np.column_stack([x[run], y[run]]) * 16.0).round().astype(np.int32)
        cv2.polylines(strip, [points], False, colour, 1, cv2.LINE_AA, shift=4)

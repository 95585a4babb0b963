"""Takes at other times: interpolated, resampled, shifted, trimmed, or punched in (method.md, section 8.3); results
between and beyond others.

Rotations are interpolated on the sphere, scale geometrically and everything else linearly; landmarks follow from
shape and pose. Nothing is interpolated across lost or missing frames.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SourceError
from ..face.names import N_COEFFICIENTS
from ..face.rotation import euler_to_matrices, euler_to_matrix, matrix_to_euler, mix_rotations
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .neutral import Neutral
from .pins import pins_of, shifted, with_pins
from .take import FIELDS, Take, join

_MAX_STEP = 2.5
"""Time between two frames, in typical steps, above which frames are missing between them."""
_MAX_FRAMES = 1_000_000
"""Largest number of frames of a resampled take: nine hours at 30 frames per second, and the limit of Blender's
timeline."""
BLEND = 0.2
"""Seconds over which one take blends into another."""


def mix(first: Take, second: Take, share: FloatArray) -> Take:
    """Interpolate between two takes of N frames by a share (N,) for each; times and info are those of `first`.

    A share of 0 gives a frame of `first` and 1 one of `second`, unchanged; in between, a frame is lost if either is.
    """
    share = np.asarray(share, dtype=np.float64)
    both = first.found & second.found
    arrays: dict[str, Any] = {name: _between(getattr(first, name), getattr(second, name), share) for name in FIELDS[1:]}
    pose = arrays["pose"]
    a, b = first.pose[both], second.pose[both]
    # A scale is a factor: its geometric mean lies halfway, and it stays positive.
    pose[both, 0] = a[:, 0] ** (1.0 - share[both]) * b[:, 0] ** share[both]
    pose[both, 1:4] = mix_rotations(a[:, 1:4], b[:, 1:4], share[both])
    arrays["landmarks"][both] = project(arrays["shape"][both], pose[both])
    for name in FIELDS[1:]:
        kept, other = getattr(first, name), getattr(second, name)
        arrays[name][share == 0.0], arrays[name][share == 1.0] = kept[share == 0.0], other[share == 1.0]
        arrays[name] = arrays[name].astype(kept.dtype)
    return replace(first, **arrays)


def _between(first: NDArray[Any], second: NDArray[Any], share: FloatArray) -> FloatArray:
    if first.dtype == np.bool_:
        return np.asarray(first & second, dtype=np.float64)
    share = share.reshape(-1, *[1] * (first.ndim - 1))
    return np.asarray((1.0 - share) * first + share * second)


def project(shape: FloatArray, pose: FloatArray) -> FloatArray:
    """Project shapes (N, 66, 3) without the pose, in outer-eye distances, by poses (N, 6) to pixels (N, 66, 2)."""
    if not len(pose):
        return np.empty((0, shape.shape[1], 2))
    turns = euler_to_matrices(pose[:, 1:4])[:, :2]
    return np.asarray(pose[:, :1, None] * (shape @ turns.transpose(0, 2, 1)) + pose[:, None, 4:6])


def sample(take: Take, times: FloatArray) -> Take:
    """Sample a take at other times, in seconds and increasing.

    Between two frames with a face, values are interpolated. Next to a lost frame, before the first and after the last
    frame, the nearest frame is used if it is within half a typical step; otherwise the result is lost.
    """
    times = np.asarray(times, dtype=np.float64)
    # Neighbouring frames, and the share of the way between them.
    typical = _typical_step(take)
    after = np.searchsorted(take.times, times, side="left").clip(0, len(take) - 1)
    before = np.where(take.times[after] > times, np.maximum(after - 1, 0), after)
    step = take.times[after] - take.times[before]
    share = np.divide(times - take.times[before], step, out=np.zeros(len(times)), where=step > 0.0).clip(0.0, 1.0)
    broken = ~(take.found[before] & take.found[after]) | (step > _MAX_STEP * typical)
    # Across lost or missing frames, use the nearest one, unless it is too far away.
    share = np.where(broken, np.round(share), share)
    between = mix(take.part(before), take.part(after), share)
    nearest = np.where(share < 0.5, before, after)
    far = broken | (times < take.times[0]) | (times > take.times[-1])
    far &= np.abs(take.times[nearest] - times) > 0.5 * typical + 1e-9
    return mark_lost(replace(between, times=times), far)


def _typical_step(take: Take) -> float:
    fps = float(take.info.get("fps") or 25.0)
    return float(np.median(np.diff(take.times))) if len(take) > 1 else 1.0 / fps


def mark_lost(take: Take, lost: NDArray[np.bool_]) -> Take:
    """Return a copy of a take without a face in the frames that `lost` (N,) marks."""
    arrays = {name: getattr(take, name).copy() for name in FIELDS[1:]}
    for name, array in arrays.items():
        array[lost] = 0 if name in ("found", "confidence") else np.nan
    return replace(take, **arrays)


def resample(take: Take, fps: float, start: float | None = None) -> Take:
    """Resample a take at an even rate, from `start` in seconds or its first frame.

    The timing is kept, whatever the rates. Raises SourceError if the rate or the number of frames is out of range, or
    the take ends before `start`.
    """
    if not 0.1 <= fps <= 10_000.0:
        raise SourceError("The rate cannot be {fps} frames per second. Use one between 0.1 and 10000.", fps=fps)
    start = float(take.times[0]) if start is None else start
    count = int(np.floor((take.times[-1] - start) * fps + 1e-6)) + 1
    if count < 1:
        raise SourceError(
            "The take ends at {last:.2f} s, before {start:.2f} s. Choose an earlier start.",
            last=take.times[-1],
            start=start,
        )
    if count > _MAX_FRAMES:
        raise SourceError(
            "There are {count:,} frames from {start:.2f} s to {last:.2f} s, more than {max_frames:,}. "
            "Use a lower rate, or check that the times of the take are in seconds.",
            count=count,
            start=start,
            last=take.times[-1],
            max_frames=_MAX_FRAMES,
        )
    even = sample(take, start + np.arange(count) / fps)
    return replace(even, info={**take.info, "fps": float(fps)})


def shift_time(take: Take, seconds: float) -> Take:
    """Add seconds to all times; raises SourceError if they could not be distinguished after the shift."""
    if not (np.isfinite(seconds) and (np.diff(take.times + seconds) > 0.0).all()):
        raise SourceError("The take cannot be shifted by {seconds} s. Use fewer seconds.", seconds=seconds)
    return with_pins(replace(take, times=take.times + seconds), shifted(pins_of(take), seconds))


def restart(take: Take) -> Take:
    """Shift a take so that its first frame is at 0 s; ``info["offset"]`` states the time of 0 s in the source."""
    first = float(take.times[0])
    offset = float(take.info.get("offset", 0.0)) + first
    return replace(shift_time(take, -first), info={**take.info, "offset": offset})


def trim(take: Take, start: float = -np.inf, end: float = np.inf) -> Take:
    """Keep the frames from `start` to `end` seconds, both included; raises SourceError if there are none."""
    inside = (take.times >= start - 1e-9) & (take.times <= end + 1e-9)
    if not inside.any():
        raise SourceError(
            "There is no frame between {start:g} s and {end:g} s. Use times from {first:.2f} s to {last:.2f} s.",
            start=start,
            end=end,
            first=take.times[0],
            last=take.times[-1],
        )
    return take.part(inside)


def punch_in(take: Take, insert: Take, start: float, end: float, blend: float = BLEND) -> Take:
    """Replace a span of a take, in seconds, by another take on the same clock (see `shift_time`).

    `blend` is the time within the span, at both of its ends, over which one take blends into the other. Raises
    SourceError if `insert` has no frame in the span, or `blend` is negative.
    """
    if not blend >= 0.0:
        raise SourceError("The blend cannot last {blend} s. Use 0 or more.", blend=blend)
    inserted = trim(insert, start, end)
    if (
        take.info.get("model") != insert.info.get("model")
        or take.shape_params.shape[1:] != inserted.shape_params.shape[1:]
    ):
        unknown = np.full((len(inserted), take.shape_params.shape[1]), np.nan, np.float32)
        inserted = replace(inserted, shape_params=unknown)
    # Blend towards both ends, but only where both takes have a face.
    edge = np.minimum(inserted.times - start, end - inserted.times)
    share = np.clip(edge / blend, 0.0, 1.0) if blend > 0.0 else np.ones(len(edge))
    under = sample(take, inserted.times)
    share[~under.found] = 1.0
    share[~inserted.found & under.found] = 0.0
    parts = [take.part(take.times < inserted.times[0]), mix(under, inserted, share), take.part(take.times > end)]
    spans = [*take.info.get("punched_in", []), [float(start), float(end)]]
    kept = [pin for pin in pins_of(take) if not start <= pin.time <= end]
    added = [pin for pin in pins_of(insert) if start <= pin.time <= end]
    return with_pins(replace(join(parts), info={**take.info, "punched_in": spans}), [*kept, *added])


def between(first: TrackResult, second: TrackResult, share: float) -> TrackResult:
    """Interpolate between two results of the same source with a face, or extrapolate with a share above 1.

    A share of 0 gives `first` and 1 `second`. The result has confidence 0, as it was not tracked; what is unknown in
    either is unknown in it.
    """

    def mixed(name: str) -> FloatArray:
        a, b = getattr(first, name), getattr(second, name)
        return np.asarray(a + share * (b - a))

    pose, shape = mixed("pose"), mixed("shape")
    # The scale changes by a constant factor, so that extrapolation cannot make it negative.
    pose[0] = first.pose[0] * (second.pose[0] / first.pose[0]) ** share
    turns = second.pose[1:4] - first.pose[1:4]
    pose[1:4] = first.pose[1:4] + share * (np.mod(turns + np.pi, 2.0 * np.pi) - np.pi)
    return replace(
        second,
        pose=pose,
        shape=shape,
        landmarks=pose[0] * (shape @ euler_to_matrix(*pose[1:4]).T)[:, :2] + pose[4:],
        confidence=0.0,
        pupils=mixed("pupils"),
        gaze=mixed("gaze"),
        vergence=float(mixed("vergence")),
        actions=mixed("actions"),
        coefficients=np.clip(mixed("coefficients"), 0.0, 1.0),
    )


def at_rest(neutral: Neutral, like: TrackResult) -> TrackResult:
    """Return a neutral face looking straight ahead, at the performer's usual position, from the same source as `like`.

    If `like`, which has a face, has coefficients, those of the result are 0.
    """
    stated = np.isfinite(like.coefficients).all()
    scale, x, y = neutral.position
    return replace(
        like,
        pose=np.array([scale, *matrix_to_euler(neutral.rotation), x, y]),
        shape=neutral.shape,
        gaze=neutral.gaze,
        vergence=neutral.vergence,
        actions=neutral.actions,
        coefficients=np.zeros(N_COEFFICIENTS) if stated else like.coefficients,
    )

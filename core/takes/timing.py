"""A take at other times: in between its frames, at another rate, shifted, trimmed, or with a part of another put in.

Frames in between are interpolated by the media's own time: the rotation by the short way, the size in proportion,
everything else linearly, and the landmarks follow from the shape at its pose. Nothing is invented: where a face was
lost, or frames are missing for longer than a few, the take stays without one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import SourceError
from ..rotation import euler_to_matrix, mix_rotations
from .take import FIELDS, Take, join

_LONGEST_STEP = 2.5
"""Typical steps between two frames, above which frames are missing between them."""
_MOST_FRAMES = 1_000_000
"""Of a take at an even rate: nine hours at 30 frames a second, and what Blender's timeline holds."""


def mix(first: Take, second: Take, share: FloatArray) -> Take:
    """Frame by frame, what lies between two takes of equally many frames; times and info are the first one's.

    Parameters
    ----------
    share : (N,)
        0 gives the first one's frame and 1 the second's, unchanged; between them a frame is lost where either is.
    """
    share = np.asarray(share, dtype=np.float64)
    both = first.found & second.found
    arrays: dict[str, Any] = {name: _between(getattr(first, name), getattr(second, name), share) for name in FIELDS[1:]}
    pose = arrays["pose"]
    a, b = first.pose[both], second.pose[both]
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
    """(N, 66, 2) landmarks of shapes (N, 66, 3) at poses (N, 6), pixels."""
    if not len(pose):
        return np.empty((0, shape.shape[1], 2))
    turns = np.array([euler_to_matrix(*angles)[:2] for angles in pose[:, 1:4]])
    return np.asarray(pose[:, :1, None] * (shape @ turns.transpose(0, 2, 1)) + pose[:, None, 4:6])


def sample(take: Take, times: FloatArray) -> Take:
    """The take as of `times` (M,), increasing seconds.

    Between two frames with a face it is interpolated; beside a lost one, before the first frame and behind the last,
    the nearest frame counts while it is not further than half a typical step, and else no face was found.
    """
    times = np.asarray(times, dtype=np.float64)
    typical = _typical_step(take)
    after = np.searchsorted(take.times, times, side="left").clip(0, len(take) - 1)
    before = np.where(take.times[after] > times, np.maximum(after - 1, 0), after)
    step = take.times[after] - take.times[before]
    share = np.divide(times - take.times[before], step, out=np.zeros(len(times)), where=step > 0.0).clip(0.0, 1.0)
    broken = ~(take.found[before] & take.found[after]) | (step > _LONGEST_STEP * typical)
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
    """The take with no face in the frames `lost` (N,) bool."""
    arrays = {name: getattr(take, name).copy() for name in FIELDS[1:]}
    for name, array in arrays.items():
        array[lost] = 0 if name in ("found", "confidence") else np.nan
    return replace(take, **arrays)


def resample(take: Take, fps: float, start: float | None = None) -> Take:
    """The take at an even rate, by media time: its last frame is where it was, whatever the two rates are.

    Parameters
    ----------
    fps : float
        Frames a second.
    start : float, optional
        Seconds, of the first frame; by default the take's own first.

    Raises
    ------
    SourceError
        Where the rate, or how many frames that would be, is out of range, or the take ends before `start`.
    """
    if not 0.1 <= fps <= 10_000.0:
        raise SourceError(f"A rate of {fps} frames a second cannot be. Give one between 0.1 and 10000.")
    start = float(take.times[0]) if start is None else start
    count = int(np.floor((take.times[-1] - start) * fps + 1e-6)) + 1
    if count < 1:
        raise SourceError(f"The take ends at {take.times[-1]:.2f} s, before {start:.2f} s. Choose an earlier start.")
    if count > _MOST_FRAMES:
        raise SourceError(
            f"From {start:.2f} s to {take.times[-1]:.2f} s these are {count:,} frames, above {_MOST_FRAMES:,}. "
            "Give a lower rate, or check that the take's times are seconds."
        )
    even = sample(take, start + np.arange(count) / fps)
    return replace(even, info={**take.info, "fps": float(fps)})


def shift_time(take: Take, seconds: float) -> Take:
    """The take so many seconds later, earlier with a negative number.

    Raises
    ------
    SourceError
        Where the times cannot be told apart afterwards.
    """
    if not (np.isfinite(seconds) and (np.diff(take.times + seconds) > 0.0).all()):
        raise SourceError(f"A take cannot be {seconds} s later. Give fewer seconds.")
    return replace(take, times=take.times + seconds)


def restart(take: Take) -> Take:
    """The take with its first frame at 0 s; `offset` tells, as before, when 0 s is in its source."""
    first = float(take.times[0])
    offset = float(take.info.get("offset", 0.0)) + first
    return replace(shift_time(take, -first), info={**take.info, "offset": offset})


def trim(take: Take, start: float = -np.inf, end: float = np.inf) -> Take:
    """The frames from `start` to `end`, seconds, at their own times; SourceError where there are none."""
    inside = (take.times >= start - 1e-9) & (take.times <= end + 1e-9)
    if not inside.any():
        raise SourceError(
            f"No frame is left between {start:g} s and {end:g} s. The take reaches from {take.times[0]:.2f} s "
            f"to {take.times[-1]:.2f} s."
        )
    return take.part(inside)


def punch_in(take: Take, insert: Take, start: float, end: float, blend: float = 0.2) -> Take:
    """The take with what `insert` has between `start` and `end`, seconds, both on the same clock (see `shift_time`).

    Over `blend` seconds at either side, within the two, one passes into the other.

    Raises
    ------
    SourceError
        Where `insert` has nothing there, or `blend` is below 0.
    """
    if not blend >= 0.0:
        raise SourceError(f"One take cannot pass into another over {blend} s. Give 0 or more.")
    put_in = trim(insert, start, end)
    if (
        take.info.get("model") != insert.info.get("model")
        or take.shape_params.shape[1:] != put_in.shape_params.shape[1:]
    ):
        unknown = np.full((len(put_in), take.shape_params.shape[1]), np.nan, np.float32)
        put_in = replace(put_in, shape_params=unknown)
    edge = np.minimum(put_in.times - start, end - put_in.times)
    share = np.clip(edge / max(blend, 1e-9), 0.0, 1.0)
    under = sample(take, put_in.times)
    share[~under.found] = 1.0
    share[~put_in.found & under.found] = 0.0
    parts = [take.part(take.times < put_in.times[0]), mix(under, put_in, share), take.part(take.times > end)]
    spans = [*take.info.get("punched_in", []), [float(start), float(end)]]
    return replace(join(parts), info={**take.info, "punched_in": spans})

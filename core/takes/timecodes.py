"""Times of rows as timecodes, whose rate a table does not state (docs/takes.md)."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..reading import shown

_PARTS = re.compile(r"[:;]")
"""Separators; a semicolon marks drop-frame timecodes, which skip numbers rather than frames."""
_RATES = (12.0, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 96.0, 100.0, 120.0, 144.0, 200.0)
_APP_RATE = 60.0
"""Rate of Live Link Face, assumed if no second of a table is complete."""
_NEAR = 0.06
"""Relative difference from a usual rate within which a measured one is that rate: dropped frames change it."""
_DAY = 86_400.0


def seconds_of_timecodes(texts: Sequence[str]) -> FloatArray:
    """Convert timecodes to seconds, also past midnight.

    Parameters
    ----------
    texts : sequence of str
        Hours, minutes, seconds and frames, the latter with decimals, as in 10:20:30:12.500; or hours, minutes and
        seconds with decimals.

    Returns
    -------
    (N,) float64
        Times in seconds.

    Raises
    ------
    ValueError
        If a text is not a timecode.

    Notes
    -----
    The frame numbers show the rate where they begin again: the last one before, the usual step and the first one after
    add up to it. Without such a place the rate is that of the app, or the lowest usual one above all frame numbers.
    """
    try:
        parts = np.array([[float(part) for part in _PARTS.split(text)] for text in texts], dtype=np.float64)
    except ValueError:
        parts = np.empty(0)
    if parts.ndim != 2 or parts.shape[1] not in (3, 4) or not ((parts >= 0.0) & (parts < 1000.0)).all():
        raise ValueError(f"{shown(texts[0])} is not a timecode such as 10:20:30:12.500")
    times = parts[:, :3] @ np.array([3600.0, 60.0, 1.0])
    if parts.shape[1] == 4:
        times += parts[:, 3] / _rate(times, parts[:, 3])
    days = np.cumsum(np.diff(times, prepend=times[0]) < -_DAY / 2.0)
    return np.asarray(times + _DAY * days)


def _rate(seconds: FloatArray, frames: FloatArray) -> float:
    """Return the frames per second of timecodes, given their whole seconds and frames, both (N,)."""
    highest = float(frames.max())
    above = [rate for rate in _RATES if rate > highest]
    same = np.diff(seconds) == 0.0
    steps = np.diff(frames)
    forward = steps[same & (steps > 0.0)]
    step = float(np.median(forward)) if len(forward) else 1.0
    found = _turnovers(seconds, steps, step)
    if not len(found):
        return max(above[0] if above else np.floor(highest) + 1.0, _APP_RATE)
    measured = float(np.median(found))
    near = min(_RATES, key=lambda rate: abs(rate - measured))
    if abs(near - measured) <= _NEAR * near and near > highest:
        return near
    return max(float(round(measured)), float(np.floor(highest)) + 1.0)


def _turnovers(seconds: FloatArray, steps: FloatArray, step: float) -> NDArray[np.float64]:
    """Return the rate at each place where the next second begins, (K,)."""
    turned = (np.diff(seconds) % _DAY == 1.0) & (steps < 0.0)
    return np.asarray(step - steps[turned])

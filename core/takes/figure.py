"""A figure of the effect of mending: one strip per part of the face, before in grey and after in green."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .smooth import CUTOFFS, before_after
from .take import Take

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


def draw_before_after(take: Take, mended: Take) -> NDArray[np.uint8]:
    """Draw the curves of `before_after` for every part, over the time of both takes.

    Parameters
    ----------
    take, mended : Take
        The take before and after mending.

    Returns
    -------
    (H, W, 3) uint8
        The figure, BGR.
    """
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

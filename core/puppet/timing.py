"""Delays of the stages of a live frame, and the slowest of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from ..numeric.arrays import FloatArray

STAGES = ("wait", "track", "drive", "hand over", "write")
"""Stages of a frame: the wait for the worker, tracking, computing the vertices, the wait for Blender's main thread,
and writing to the mesh."""
REDRAW = "redraw"
"""Redrawing of Blender's viewports, which follows writing to the mesh and is not part of the delay."""
_KEPT = 300
"""Number of frames over which delays are measured."""
_REDRAWS = 20
"""Number of redraws that are measured. Few, as another view or shading changes their duration, which is reported at
once."""
_RECENT = 2.0
"""Seconds over which the rate is measured."""
_SHORTEST = 0.2
"""Shortest time in seconds over which the rate is measured."""
_READABLE = 0.5
"""Seconds for which a text stays as it is."""
_NOTABLE = 0.004
"""Seconds above which a stage is worth naming."""


@dataclass(frozen=True)
class Delays:
    """Seconds spent in each of `STAGES` of a frame, from the camera to the mesh."""

    stages: tuple[float, ...]

    @property
    def total(self) -> float:
        """Seconds from the camera to the mesh."""
        return sum(self.stages)


class Stopwatch:
    """Measures the delays of the last frames; written by one thread, read by any."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, ...]] = deque(maxlen=_KEPT)
        self._when: deque[float] = deque(maxlen=_KEPT)
        self._redraws: deque[float] = deque(maxlen=_REDRAWS)
        self._text = "", 0.0

    def add(self, delays: Delays) -> None:
        """Add a frame."""
        self._delays.append(delays.stages)
        self._when.append(perf_counter())

    def add_redraw(self, seconds: float) -> None:
        """Add the time that Blender took to redraw after a frame."""
        self._redraws.append(seconds)

    def __len__(self) -> int:
        return len(self._delays)

    @property
    def latency(self) -> float:
        """Median time from the camera to the mesh in seconds; NaN before the first frame."""
        return float(np.median(self._table().sum(axis=1))) if self._delays else float("nan")

    @property
    def rate(self) -> float:
        """Number of recent frames per second that reached the mesh."""
        now, when = perf_counter(), tuple(self._when)
        span = min(_RECENT, now - when[0]) if when else 0.0
        return sum(now - moment <= span for moment in when) / max(span, _SHORTEST)

    @property
    def text(self) -> str:
        """Delay and rate as a text, the same wherever it is shown for a while; "" before the first frame."""
        now = perf_counter()
        if self._delays and now - self._text[1] > _READABLE:
            self._text = f"{1000 * self.latency:.0f} ms   {self.rate:.0f} fps", now
        return self._text[0]

    def medians(self) -> Mapping[str, float]:
        """Return the median seconds of each stage; empty before the first frame."""
        return dict(zip(STAGES, np.median(self._table(), axis=0).tolist(), strict=True)) if self._delays else {}

    def percentiles(self, *wanted: float) -> Mapping[str, tuple[float, ...]]:
        """Return the seconds of each stage, and of "total", at the `wanted` percentiles."""
        table = self._table()
        rows = np.percentile(np.column_stack([table, table.sum(axis=1)]), wanted, axis=0).T
        return {name: tuple(row) for name, row in zip((*STAGES, "total"), rows.tolist(), strict=True)}

    @property
    def redraw(self) -> float:
        """Median seconds until Blender has redrawn; 0 if unknown."""
        return float(np.median(self._redraws)) if self._redraws else 0.0

    def slowest(self) -> str:
        """Return the slowest stage, or `REDRAW`, or "" if all are fast.

        While Blender redraws, the worker continues with newer frames, so a slow redraw shows in no stage.
        """
        spans = {**self.medians(), REDRAW: self.redraw}
        name = max(spans, key=lambda stage: spans[stage])
        return name if spans[name] > _NOTABLE else ""

    def _table(self) -> FloatArray:
        return np.array(tuple(self._delays), dtype=np.float64).reshape(-1, len(STAGES))

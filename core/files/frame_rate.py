"""The rate of a video: the stated one, or the usual one at which most of its frames come."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

FASTEST = 120.0
"""Largest nominal rate that is believed without a look at the times. Recorders in browsers state 1000."""
_USUAL_RATES = np.array([24000 / 1001, 24.0, 25.0, 30000 / 1001, 30.0, 50.0, 60000 / 1001, 60.0, 90.0, 120.0, 240.0])
"""Frames per second at which is recorded."""
_EXACT = 1e-4
"""Largest difference, as a share of it, between a stated rate and a usual one: files round to thousandths."""
_NEAR = 0.003
"""The same for the rate of the times where a possible one is stated, which is the mean of phones that skip frames.
The closest rates that differ in kind, 24 and 25, are 0.04 apart, and phones' clocks are right within 0.001."""
_INEXACT = 0.05
"""The same where none or an impossible one is stated: the steps of browsers vary by several milliseconds."""
_REGULAR = 0.25
"""Largest difference, as a share of it, between the median step and those that are as long."""
_MOST = 0.7
"""Share of the steps that have to be as long as the median for it to be a rate. Phones that skip one frame in ten have
0.89, and films of 24 frames on 30 images, with every fourth step twice as long, 0.75."""


def nominal_rate(stated: float, first_times: Callable[[], Sequence[float]]) -> float:
    """Return the rate in frames per second of a video that states one, by the times in seconds of its first frames.

    They are asked for only if needed; 25 if there is no rate at all.
    """
    believed = 1.0 <= stated <= FASTEST
    if believed and _off(stated, _usual(stated)) < _EXACT:
        return stated
    steps = np.diff(first_times())
    steps = steps[steps > 0.0]
    if not len(steps):
        return stated if believed else 25.0
    median = float(np.median(steps))
    if not believed:
        usual = _usual(1.0 / median)
        return usual if _off(1.0 / median, usual) < _INEXACT else min(max(1.0 / median, 1.0), 1000.0)
    regular = steps[np.abs(steps - median) < _REGULAR * median]
    # Files may round times to milliseconds, which the mean evens out.
    rate = 1.0 / float(regular.mean())
    return _usual(rate) if len(regular) >= _MOST * len(steps) and _off(rate, _usual(rate)) < _NEAR else stated


def _usual(rate: float) -> float:
    return float(_USUAL_RATES[np.abs(np.log(_USUAL_RATES / rate)).argmin()])


def _off(rate: float, usual: float) -> float:
    return abs(rate / usual - 1.0)

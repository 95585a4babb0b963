"""Simulation of a network that delays, loses, duplicates and reorders packets; seeded, in simulated time."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from random import Random
from typing import Any


@dataclass(frozen=True)
class Link:
    """Effects of a network on packets.

    Attributes
    ----------
    delay, jitter : float
        Mean delay, and its largest deviation, in seconds.
    loss, double : float
        Shares of packets that are lost, and that come twice.
    cut : (float, float)
        Start and end in seconds of an interruption.
    """

    delay: float = 0.02
    jitter: float = 0.01
    loss: float = 0.0
    double: float = 0.0
    cut: tuple[float, float] = (0.0, 0.0)

    def deliver(self, packets: list[tuple[float, Any]], seed: int = 0) -> list[tuple[float, Any]]:
        """Return the arrival times of packets sent at these times, in order of arrival."""
        rng, arrivals = Random(seed), []
        for number, (sent, packet) in enumerate(packets):
            for _ in range(1 + (rng.random() < self.double)):
                late = self.delay + rng.uniform(-self.jitter, self.jitter)
                if rng.random() >= self.loss and not self.cut[0] <= sent < self.cut[1]:
                    heapq.heappush(arrivals, (sent + late, number, packet))
        return [(arrival, packet) for arrival, _, packet in (heapq.heappop(arrivals) for _ in range(len(arrivals)))]

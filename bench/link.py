"""A network as a seeded simulation: packets are delayed, lost, doubled and reordered, in a time of its own."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from random import Random
from typing import Any


@dataclass(frozen=True)
class Link:
    """What a network does to packets.

    Attributes
    ----------
    delay, jitter : float
        Seconds: the mean delay, and by how much it differs at most.
    loss, double : float
        Shares of the packets that are lost, or come twice.
    cut : (float, float)
        Seconds between which nothing comes.
    """

    delay: float = 0.02
    jitter: float = 0.01
    loss: float = 0.0
    double: float = 0.0
    cut: tuple[float, float] = (0.0, 0.0)

    def deliver(self, packets: list[tuple[float, Any]], seed: int = 0) -> list[tuple[float, Any]]:
        """Return when each of the packets, sent at these times, comes, in the order in which they come."""
        rng, arrivals = Random(seed), []
        for number, (sent, packet) in enumerate(packets):
            for _ in range(1 + (rng.random() < self.double)):
                late = self.delay + rng.uniform(-self.jitter, self.jitter)
                if rng.random() >= self.loss and not self.cut[0] <= sent < self.cut[1]:
                    heapq.heappush(arrivals, (sent + late, number, packet))
        return [(arrival, packet) for arrival, _, packet in (heapq.heappop(arrivals) for _ in range(len(arrivals)))]

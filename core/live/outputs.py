"""Interfaces of what takes a live performance besides the heads: recordings, and streams to others."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..takes.neutral import Neutral
from ..tracking.result import TrackResult


class Recorder(Protocol):
    """Interface of a recording."""

    def append(self, time: float, result: TrackResult, image: NDArray[np.uint8] | None) -> None:
        """Record a frame.

        Parameters
        ----------
        time : float
            Seconds.
        result : TrackResult
            Of that frame.
        image : (H, W, 3) uint8 or None
            BGR, if there is one.
        """

    def flush(self) -> None:
        """Write pending frames to the disk."""

    def close(self) -> None:
        """End the recording."""


class Output(Protocol):
    """Interface of what passes the performance on, such as a stream; it must neither wait nor raise."""

    def send(self, time: float, result: TrackResult, neutral: Neutral | None) -> None:
        """Pass a frame on.

        Parameters
        ----------
        time : float
            Seconds in the source.
        result : TrackResult
            Smoothed according to the options.
        neutral : Neutral or None
            The performer's neutral face, if it is known.
        """

    def close(self) -> None:
        """End the output."""

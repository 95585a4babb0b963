"""Interfaces of what takes a live performance besides the heads: recordings, and streams to others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from ..drive.driver import HeadDriver, HeadFrame
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from .sources import LiveFrame

if TYPE_CHECKING:
    from .key_driver import KeyDriver


class Recorder(Protocol):
    """Interface of a recording."""

    def append(self, frame: LiveFrame, result: TrackResult) -> None:
        """Record a frame.

        Parameters
        ----------
        frame : LiveFrame
        result : TrackResult
            What was tracked in it.
        """

    def flush(self) -> None:
        """Write pending frames to the disk."""

    def close(self) -> None:
        """End the recording."""


class Output(Protocol):
    """Interface of what passes the performance on, such as a stream; it must neither wait nor raise.

    Attributes
    ----------
    sent : int
        Frames that were passed on.
    message : str
        Why none are; otherwise "".
    """

    sent: int

    @property
    def message(self) -> str:
        """Why nothing is passed on; otherwise ""."""

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


class Display(Protocol):
    """Interface of what shows the driven heads elsewhere, such as a viewer; it must neither wait nor raise."""

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Show a frame.

        Parameters
        ----------
        taken : float
            `time.perf_counter()` of its arrival.
        drivers : sequence of HeadDriver or KeyDriver
            Of the heads.
        frames : sequence of HeadFrame
            One for each; empty if there is no face.
        """

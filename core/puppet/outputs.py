"""Interfaces of the recipients of a live performance other than heads: recordings, streams and displays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ..drive.drive_settings import DriveSettings
from ..drive.driver import HeadDriver, HeadFrame
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from .sources import LiveFrame

if TYPE_CHECKING:
    from .head_drivers import KeyDriver


class Recorder(Protocol):
    """Interface of a recording."""

    def append(self, frame: LiveFrame, result: TrackResult) -> None:
        """Record a frame.

        Parameters
        ----------
        result : TrackResult
            Its result, as tracked.
        """

    def flush(self) -> None:
        """Write pending frames to the disk."""

    def close(self) -> None:
        """End the recording."""


class Output(Protocol):
    """Interface of an output that passes the performance on, such as a stream. It must neither wait nor raise.

    Attributes
    ----------
    sent : int
        Number of frames that were passed on.
    message : str
        Reason why none are; otherwise "".
    """

    sent: int

    @property
    def message(self) -> str:
        """Reason why nothing is passed on; otherwise ""."""

    def send(
        self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int] | None = None
    ) -> None:
        """Pass on a frame.

        Parameters
        ----------
        time : float
            Time in the source in seconds.
        result : TrackResult
            Result of the performer, smoothed according to the options.
        neutral : Neutral or None
            The performer's neutral face; None if it is not known.
        size : (int, int), optional
            Width and height of the image in pixels.
        """

    def close(self) -> None:
        """End the output."""


@runtime_checkable
class DrivenOutput(Output, Protocol):
    """Interface of an output whose content depends on how a frame moves a head.

    Attributes
    ----------
    options : DriveSettings
        The current options; may be assigned at any time.
    """

    options: DriveSettings


class Display(Protocol):
    """Interface of a display of the driven heads elsewhere, such as a viewer. It must neither wait nor raise."""

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Show a frame.

        Parameters
        ----------
        taken : float
            `time.perf_counter()` when the frame arrived.
        drivers : sequence of HeadDriver or KeyDriver
            Drivers of the heads.
        frames : sequence of HeadFrame
            Frame of each head; empty if there is no face.
        """

"""What the commands `send` and `serve` share: the performance that they track without Blender."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from time import monotonic

from ..core.errors import FacemimeError
from ..core.live.camera import Camera, CameraSettings, list_cameras, parse_device
from ..core.live.sources import LiveSource, TakePlayer, VideoPlayer
from ..core.live.worker import LiveOptions, LiveWorker
from ..core.takes.file import SUFFIX
from ..core.takes.neutral import Neutral
from ..core.tracking.settings import TrackingSettings
from .terminal.console import Progress, tell
from .terminal.options import add_face_option, add_settings, face_of, number, tracking_of
from .terminal.stopping import STOPPING
from .terminal.takes import load_with_warnings

LOOK = 0.1
"""Seconds between two looks at what a source or a worker does."""


def add_source(parser: argparse.ArgumentParser) -> None:
    """Add the options of a performance that is tracked live."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--camera", metavar="N|NAME", help="a camera, by number or name")
    source.add_argument("--video", type=Path, metavar="VIDEO|TAKE", help="a video or a take, played in real time")
    parser.add_argument("--loop", action="store_true", help="start the video again at its end")
    parser.add_argument(
        "--smoothing", type=number, default=1.0, metavar="AMOUNT", help="jitter smoothing; 0 for none (1)"
    )
    parser.add_argument("--seconds", type=number, metavar="S", help="stop after this time (Ctrl-C, or the video's end)")
    add_face_option(parser)
    add_settings(parser, TrackingSettings)


def live_options(arguments: argparse.Namespace) -> LiveOptions:
    """Return the options of the worker; FacemimeError if one is impossible."""
    if arguments.smoothing < 0.0:
        raise FacemimeError(f"--smoothing cannot be {arguments.smoothing:g}. Use 0 or more.")
    return LiveOptions(smoothing=arguments.smoothing, face=face_of(arguments.face), tracking=tracking_of(arguments))


def open_source(arguments: argparse.Namespace) -> tuple[LiveSource, Neutral | None]:
    """Open the source, and return it with the neutral face that a take has.

    Raises
    ------
    SourceError
        If it cannot be opened.
    """
    if arguments.camera is not None:
        return Camera(CameraSettings(parse_device(arguments.camera, list_cameras()))), None
    if arguments.video.suffix.lower() == SUFFIX:
        take = load_with_warnings(arguments.video)
        stored = take.info.get("calibration")
        neutral = None if stored is None else Neutral.from_dict(stored)
        return TakePlayer(take, arguments.video.name, loop=arguments.loop), neutral
    return VideoPlayer(arguments.video, loop=arguments.loop), None


def watch(worker: LiveWorker, state: Callable[[], tuple[int, str]], progress: Progress, seconds: float | None) -> None:
    """Show progress until the worker ends, a signal comes, or the time is over.

    Parameters
    ----------
    worker : LiveWorker
    state : callable
        Returns how many frames went out, and why none do; "" if they do.
    progress : Progress
    seconds : float or None
    """
    end, told = monotonic() + (seconds if seconds is not None else float("inf")), ""
    while worker.running and not STOPPING.heard and monotonic() < end:
        time.sleep(LOOK)
        done, trouble = state()
        progress.update(done)
        if (message := worker.message or trouble) != told:
            told = message
            if message:
                tell(f"facemime: {message}")
    progress.update(state()[0])

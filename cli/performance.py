"""What the commands `send` and `serve` share: a performance that is tracked live, and the head that it moves."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

from ..core.heads.appearance import Appearance, built_in_appearance
from ..core.heads.key_presets import ESSENTIAL
from ..core.heads.rig import built_in_head
from ..core.puppet.camera import Camera, CameraSettings
from ..core.puppet.job import HeadFile
from ..core.puppet.outputs import LiveHead
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.puppet.sources import LiveSource, TakePlayer, VideoPlayer
from ..core.puppet.worker import LiveOptions, LiveWorker
from ..core.takes.file import SUFFIX
from ..core.takes.neutral import Neutral
from ..core.tracking.tracker import TrackingSettings
from .console import Progress, for_terminal, tell
from .job_files import importing_blender, load_with_warnings
from .options import add_face_option, add_settings, head_file, number
from .stopping import STOPPING

LOOK = 0.1
"""Seconds between two looks at what a source or a worker does."""


def add_source(parser: argparse.ArgumentParser, *, takes_as_recorded: bool = False) -> None:
    """Add the options of a performance that is tracked live; takes may be left unsmoothed unless an option smooths."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--camera", metavar="N|NAME", help="a camera, by number or name; on Windows, dshow0 is the first of DirectShow"
    )
    source.add_argument("--video", type=Path, metavar="VIDEO|TAKE", help="a video or a take, played in real time")
    parser.add_argument("--loop", action="store_true", help="start the video again at its end")
    usual = f"{PuppetSettings.smoothing:g}"
    smoothing = f"{usual}; 0 for a take, as it was recorded" if takes_as_recorded else usual
    add_settings(parser, PuppetSettings, ("rotation", "translation"), {"smoothing": smoothing})
    parser.set_defaults(takes_as_recorded=takes_as_recorded)
    parser.add_argument("--seconds", type=number, metavar="S", help="stop after this time (Ctrl-C, or the video's end)")
    add_face_option(parser)
    add_settings(parser, TrackingSettings)


@dataclass(frozen=True)
class LivePerformance:
    """A performance that is tracked live, from the options of `add_source`.

    Attributes
    ----------
    camera : str or None
        Number or name of a camera; None for `video`.
    video : Path or None
        A video or a take.
    loop : bool
        Whether the video starts again at its end.
    smoothing : float or None
        As in `PuppetSettings`; None for the default.
    takes_as_recorded : bool
        Whether the default for a take is not to smooth it.
    seconds : float or None
        Time after which to stop; None for the end of the video, or a signal.
    face : (float, float) or None
        As for `FaceTracker.choose`.
    """

    camera: str | None
    video: Path | None
    loop: bool
    smoothing: float | None
    takes_as_recorded: bool
    seconds: float | None
    face: tuple[float, float] | None
    tracking: TrackingSettings = field(default_factory=TrackingSettings)

    @property
    def options(self) -> LiveOptions:
        """Options of the worker."""
        smoothing = self.smoothing
        if smoothing is None:
            smoothing = 0.0 if self._is_take and self.takes_as_recorded else PuppetSettings.smoothing
        return LiveOptions(smoothing=smoothing, face=self.face, tracking=self.tracking)

    @property
    def _is_take(self) -> bool:
        return self.video is not None and self.video.suffix.lower() == SUFFIX

    def open(self) -> tuple[LiveSource, Neutral | None]:
        """Open the source, and return it with the neutral face that a take has; SourceError if it cannot be opened."""
        if self.video is None:
            return Camera(CameraSettings(str(self.camera))), None
        if self._is_take:
            take = load_with_warnings(self.video)
            stored = take.info.get("calibration")
            neutral = None if stored is None else Neutral.from_dict(stored)
            return TakePlayer(take, self.video.name, loop=self.loop), neutral
        return VideoPlayer(self.video, loop=self.loop), None


def add_head_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the head that is shown."""
    parser.add_argument(
        "--head",
        type=head_file,
        metavar="FILE[:OBJECT]",
        help="your own head, as for bind; needs Blender (the built-in head)",
    )


def head_to_show(head: HeadFile | None) -> tuple[LiveHead, Appearance]:
    """Return a head, by default the built-in one, and its appearance for viewers; one in a file is bound if necessary.

    Raises FacemimeError if Blender is missing, or the file has no head and no face.
    """
    if head is None:
        return LiveHead(built_in_head(lashes=True)), built_in_appearance()
    with importing_blender("--head"):
        from ..blender.animation.appearance import read_appearance
        from ..blender.animation.live_keys import AUTOMATIC, live_keys
        from ..blender.rigs import read_rig
        from .character_files import open_head
    obj = open_head(head, by_keys=ESSENTIAL)
    return LiveHead(read_rig(obj), keys=live_keys(obj, AUTOMATIC)), read_appearance(obj)


def watch(worker: LiveWorker, state: Callable[[], tuple[int, str]], progress: Progress, seconds: float | None) -> None:
    """Run a worker and show progress until it ends, a signal comes, or the time is over; raises its error.

    `state` returns how many frames went out, and why none do; "" if they do.
    """
    worker.start()
    try:
        end, told = monotonic() + (seconds if seconds is not None else float("inf")), ""
        while worker.running and not STOPPING.heard and monotonic() < end:
            time.sleep(LOOK)
            done, trouble = state()
            progress.update(done)
            if (message := worker.message or trouble) != told:
                told = message
                if message:
                    tell(f"facemime: {for_terminal(message)}")
        progress.update(state()[0])
    finally:
        worker.close()
    if worker.error is not None:
        raise worker.error

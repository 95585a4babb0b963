"""Live sessions: a worker thread captures and tracks, and the main thread copies the results to the heads; browsers and
other programs may show them, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any

import bpy

from ..blender.animation.appearance import read_appearance
from ..blender.animation.live import LiveHeadObject, require_one_left
from ..blender.animation.live_mesh import clear_all_live
from ..blender.contexts import push_undo
from ..blender.messages import show_error
from ..core.drive.driver import HeadFrame
from ..core.errors import FacemimeError, Message, OutputError
from ..core.heads.appearance import Appearance
from ..core.puppet.outputs import LiveHead, Output
from ..core.puppet.sources import LiveSource
from ..core.puppet.timing import Delays, Stopwatch
from ..core.puppet.worker import LiveOptions, LiveResult, LiveWorker
from ..core.streams.transport.addresses import LOOPBACK
from ..core.streams.vertices import VertexSender
from ..core.takes.neutral import Neutral
from ..core.viewer.viewer_settings import new_token
from ..settings.properties import FacemimeOutput, FacemimeSettings
from ..settings.values import sends_vertices, viewer_settings
from .calibrating import Calibrating
from .recorder import Recorder
from .session import Session

if TYPE_CHECKING:
    from ..core.viewer.server import ViewerServer


@lru_cache(maxsize=1)
def token() -> str:
    """Return the secret in the address, which stays the same until Blender quits, so that open pages reconnect."""
    return new_token()


def open_viewer(settings: FacemimeSettings, objects: Sequence[bpy.types.Object | None]) -> ViewerServer | None:
    """Start the server if it is enabled, with the heads in the order of the session; None for one that was deleted.

    Raises FacemimeError if it cannot be started, or other computers may connect and Blender's online access is turned
    off.
    """
    wanted = viewer_settings(settings.viewer, token())
    if wanted is None:
        return None
    from ..core.viewer.server import ViewerServer  # only now, as its libraries take a tenth of a second

    looks = [Appearance("", ()) if obj is None else read_appearance(obj) for obj in objects]
    server = ViewerServer(wanted, looks)
    server.follow = (settings.rotation, settings.translation)
    return server


def open_vertices(output: FacemimeOutput, objects: Sequence[bpy.types.Object]) -> VertexSender | None:
    """Start sending the moved vertices if this is enabled, with the heads in the order of the session.

    Raises FacemimeError if the receiver is not known, or is another computer and Blender's online access is turned off.
    """
    if not sends_vertices(output):
        return None
    return VertexSender(output.host.strip() or LOOPBACK, output.port, [read_appearance(obj) for obj in objects])


class Displays:
    """The browsers and programs that show the heads of a session, besides its viewports.

    `viewer` is the server that shows the heads in browsers, replaced by `view`, and `vertices` the sender of the moved
    vertices, replaced by `send_vertices`; each is None unless it is enabled.
    """

    def __init__(self, worker: LiveWorker) -> None:
        self._worker = worker
        self.viewer: ViewerServer | None = None
        self.vertices: VertexSender | None = None

    def view(self, viewer: ViewerServer | None) -> None:
        """Replace the viewer, and end the previous one."""
        before, self.viewer = self.viewer, viewer
        self._replace(before)

    def send_vertices(self, sender: VertexSender | None) -> None:
        """Replace the sender of the moved vertices, and end the previous one."""
        before, self.vertices = self.vertices, sender
        self._replace(before)

    def close(self) -> None:
        """End the viewer and the sender."""
        self.view(None)
        self.send_vertices(None)

    def _replace(self, before: ViewerServer | VertexSender | None) -> None:
        self._worker.displays = tuple(one for one in (self.viewer, self.vertices) if one is not None)
        if before is not None:
            before.close()


def follow_viewer(session: LiveSession, settings: FacemimeSettings) -> None:
    """Start or stop the server of a running session if the settings ask for it.

    An error is shown, and switches the viewer off rather than ending the puppet.
    """
    server = session.displays.viewer
    if server is not None and server.follow != (follow := (settings.rotation, settings.translation)):
        server.follow = follow
    try:
        wanted = viewer_settings(settings.viewer, token())
        if wanted == (None if server is None else server.settings):
            return
        session.displays.view(None)
        session.displays.view(open_viewer(settings, [None if shown.gone else shown.obj for shown in session.heads]))
    except FacemimeError as error:
        settings.viewer.enabled = False
        show_error(str(error))


TICK = 1.0 / 120.0
"""Seconds between two calls of `LiveSession.step`."""
_DEFAULTS = LiveOptions()


class LiveSession(Session):
    """Moves heads by a live source until `close`.

    Only `step` runs in Blender's main thread: it writes the worker's newest result to the heads.

    Parameters
    ----------
    source : LiveSource
    heads : sequence of (LiveHeadObject, LiveHead)
        Each head in the scene, and its rig for the worker.
    neutral : Neutral, optional
        The performer's calibration; by default the first second with a face is used.
    options : LiveOptions, optional
    on_calibrated, on_learnt : callable, optional
        As for `Calibrating`.
    output : Output, optional
        Receives every frame; closed with the session.

    Attributes
    ----------
    stopwatch : Stopwatch
    keep : bool
        Whether the heads keep their pose at the end.
    drive_by : str
        The setting by which the heads are driven now.
    styles, controls : tuple
        State of the styles of the heads, and of the controls of their rigs, that are in use.
    shown : LiveResult or None
        The result on display; the worker may have a newer one.
    operator : bpy.types.Operator or None
        The modal operator that calls `step`, which Blender itself keeps only if there is a window. Its `release` is
        called when the session is closed.
    calibrating : Calibrating
    recorder : Recorder
    displays : Displays
        Where else the heads are shown.
    """

    def __init__(
        self,
        source: LiveSource,
        heads: Sequence[tuple[LiveHeadObject, LiveHead]],
        *,
        neutral: Neutral | None = None,
        options: LiveOptions = _DEFAULTS,
        on_calibrated: Callable[[Neutral], object] = lambda neutral: None,
        on_learnt: Callable[[Neutral], object] | None = None,
        output: Output | None = None,
    ) -> None:
        super().__init__()
        self.stopwatch, self.keep = Stopwatch(), False
        self.drive_by = ""
        self.styles: tuple[object, ...] = ()
        self.controls: tuple[object, ...] = ()
        self.shown: LiveResult | None = None
        self.operator: Any = None
        self.heads = [shown for shown, _ in heads]
        self._displayed_at: float | None = None
        self._number = 0
        self._written: tuple[HeadFrame, ...] = ()
        driven = tuple(head for _, head in heads)
        self.worker = LiveWorker(source, neutral=neutral, heads=driven, options=options, output=output)
        self.calibrating = Calibrating(self.worker, on_calibrated, on_learnt)
        self.recorder = Recorder(self, self.worker)
        self.displays = Displays(self.worker)
        try:
            for shown in self.heads:
                shown.attach()
        except Exception:
            self.close()
            raise
        push_undo("Start Puppet")
        self.worker.start()

    def step(self) -> bool:
        """Display the newest result and return whether there was a new one.

        If the worker failed, raises its exception; raises HeadError if a head was changed, or all were deleted.
        """
        self._measure_redraw()
        self.rest_copies()
        self.calibrating.step()
        self.recorder.step()
        latest = self.worker.latest
        if latest is None or latest.number == self._number:
            if self.worker.error is not None:
                raise self.worker.error
            return False
        fetched = perf_counter()
        self._number, self.shown = latest.number, latest
        require_one_left(self.heads)
        self.warn_of_applied()
        before = self._written + (None,) * len(self.heads)
        for shown, frame, flat, written in zip(self.heads, latest.heads, latest.prepared, before, strict=False):
            if frame is not written and not shown.gone:
                shown.write(frame, flat)
        self._written = latest.heads
        self._measure(latest, fetched)
        self._displayed_at = perf_counter()
        return True

    @property
    def ended(self) -> bool:
        """Whether the source has ended and its last frame is displayed."""
        return not self.worker.running and self.worker.error is None

    def update(self, heads: Sequence[LiveHead]) -> None:
        """Replace the rigs and options of the same heads."""
        self.worker.heads = tuple(heads)

    @property
    def countdown(self) -> float | None:
        """Seconds until the calibration or the recording starts; 0 during a calibration, otherwise None."""
        return None if (awaited := self.calibrating.current or self.recorder.delayed) is None else awaited.left

    @property
    def task(self) -> str:
        """What the performer has to do in a calibration, or before a recording; otherwise ""."""
        return "" if (awaited := self.calibrating.current or self.recorder.delayed) is None else awaited.task

    @property
    def pending(self) -> bool:
        """Whether there is a recording that is not in the list yet, or a range to be re-recorded."""
        return super().pending or self.recorder.pending

    @property
    def has_events(self) -> bool:
        """Whether the operator handles the session."""
        return self.operator is not None

    def attend(self) -> None:
        """Continue with the range that is being re-recorded, and add a recording that has ended to the list."""
        self.recorder.attend()
        super().attend()

    def before_undo(self) -> None:
        """Also note which recordings are in the list."""
        self.recorder.note_listed()
        super().before_undo()

    def survives_undo(self) -> bool:
        """Also list the recordings again that the undo has dropped: what was performed is not a step to undo."""
        survives = super().survives_undo()
        self.recorder.list_again()
        return survives

    def resume(self) -> None:
        """Display the heads again after `suspend`."""
        for shown in self.heads:
            shown.attach()
        self._number, self._written = 0, ()

    def _stop(self) -> None:
        self.displays.close()
        try:
            self.worker.close()
        except OutputError as error:
            self.worker.recording_error = error
            self.warning = str(error)
        if self.worker.running:
            self.warning = Message(
                "{name} does not respond and was abandoned. If it stays blocked, unplug it or restart Blender.",
                name=self.worker.source.name,
            )

    def _restore(self, *, blocks: bool) -> None:
        """Restore the heads, unless `keep` is set, and release the operator."""
        operator, self.operator = self.operator, None
        if operator is not None:
            operator.release()
        removed = [shown.detach(keep=self.keep, blocks=blocks) for shown in self.heads]
        removed.append(clear_all_live(blocks=blocks, but=self.blocks))
        if any(removed):
            push_undo("Stop Puppet")
        elif self.keep and blocks:
            push_undo("Puppet")

    def _measure_redraw(self) -> None:
        """Measure how long Blender took until it asked for the next frame, beyond the interval of its timer."""
        if self._displayed_at is not None:
            self.stopwatch.add_redraw(max(0.0, perf_counter() - self._displayed_at - TICK))
            self._displayed_at = None

    def _measure(self, latest: LiveResult, fetched: float) -> None:
        marks = (latest.taken, latest.began, latest.tracked, latest.driven, fetched, perf_counter())
        self.stopwatch.add(Delays(tuple(after - before for before, after in pairwise(marks))))

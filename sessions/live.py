"""Live sessions: a worker thread captures and tracks, and the main thread copies the results to the heads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import bpy

from ..blender.animation.live import LiveHeadObject, require_one_left
from ..blender.animation.live_mesh import clear_all_live
from ..blender.media.sounds import beep
from ..blender.messages import show_error
from ..blender.undo import push_undo
from ..core.drive.driver import HeadFrame
from ..core.errors import FacemimeError, HeadError, OutputError
from ..core.live.head_drivers import LiveHead
from ..core.live.outputs import Output
from ..core.live.sources import LiveSource
from ..core.live.timing import Delays, Stopwatch
from ..core.live.worker import LiveOptions, LiveResult, LiveWorker
from ..core.streams.vertices import VertexSender
from ..core.takes.neutral import Neutral
from ..settings.preferences import preferences
from ..settings.takes_store import add, is_listed
from .countdown import COUNTDOWN, Calibration, DelayedRecording
from .punch_in import PunchIn
from .recording import Recording
from .session import Session

if TYPE_CHECKING:
    from ..core.viewer.server import ViewerServer

TICK = 1.0 / 120.0
"""Seconds between two calls of `LiveSession.step`."""
_DEFAULTS = LiveOptions()
_KEEPING = 5.0
"""Seconds after which the learnt calibration is stored again."""


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
    on_calibrated : callable, optional
        Called with the `Neutral` of each calibration that was requested.
    on_learnt : callable, optional
        Called from time to time with the `Neutral` learnt so far.
    output : Output, optional
        Receives every frame; closed with the session.

    Attributes
    ----------
    stopwatch : Stopwatch
    keep : bool
        Whether the heads keep their pose at the end.
    drive_by : str
        The setting by which the heads are driven now.
    shown : LiveResult or None
        The result on display; the worker may have a newer one.
    operator : bpy.types.Operator or None
        The modal operator that calls `step`, which Blender itself keeps only if there is a window. Its `release` is
        called when the session is closed.
    recording : Recording or None
        The running recording, or one that has ended and is not in the list yet.
    punch_in : PunchIn or None
        The range that is being re-recorded.
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
        self.shown: LiveResult | None = None
        self.operator: Any = None
        self.recording: Recording | None = None
        self.punch_in: PunchIn | None = None
        self.heads = [shown for shown, _ in heads]
        self._on_calibrated, self._on_learnt = on_calibrated, on_learnt
        self._learnt: Neutral | None = None
        self._kept_at = perf_counter()
        self._calibration: Calibration | None = None
        self._delayed: DelayedRecording | None = None
        self._displayed_at: float | None = None
        self._number = 0
        self._recorded: list[tuple[str, Path]] = []
        self._listed: list[tuple[str, Path]] = []
        self._written: tuple[HeadFrame, ...] = ()
        self._viewer: ViewerServer | None = None
        self._vertices: VertexSender | None = None
        driven = tuple(head for _, head in heads)
        self.worker = LiveWorker(source, neutral=neutral, heads=driven, options=options, output=output)
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

        Raises
        ------
        Exception
            If the worker failed, its exception; HeadError if a head was changed, or all were deleted.
        """
        self._measure_redraw()
        self.rest_copies()
        self._continue_calibration()
        self._keep_learnt()
        self._start_delayed()
        latest = self.worker.latest
        if latest is None or latest.number == self._number:
            if self.worker.error is not None:
                raise self.worker.error
            return False
        fetched = perf_counter()
        self._number, self.shown = latest.number, latest
        require_one_left(self.heads)
        before = self._written + (None,) * len(self.heads)
        for shown, frame, flat, written in zip(self.heads, latest.heads, latest.prepared, before, strict=False):
            if frame is not written and not shown.gone:
                shown.write(frame, flat)
        self._written = latest.heads
        self._measure(latest, fetched)
        self._displayed_at = perf_counter()
        return True

    @property
    def viewer(self) -> ViewerServer | None:
        """The server that shows the heads in browsers, if enabled."""
        return self._viewer

    def view(self, viewer: ViewerServer | None) -> None:
        """Replace the viewer, and end the previous one."""
        before, self._viewer = self._viewer, viewer
        self._show_elsewhere(before)

    @property
    def vertices(self) -> VertexSender | None:
        """The sender of the moved vertices, if enabled."""
        return self._vertices

    def send_vertices(self, sender: VertexSender | None) -> None:
        """Replace the sender of the moved vertices, and end the previous one."""
        before, self._vertices = self._vertices, sender
        self._show_elsewhere(before)

    @property
    def ended(self) -> bool:
        """Whether the source has ended and its last frame is displayed."""
        return not self.worker.running and self.worker.error is None

    def update(self, heads: Sequence[LiveHead]) -> None:
        """Replace the rigs and options of the same heads."""
        self.worker.heads = tuple(heads)

    def calibrate(self, *, range_of: bool = False, countdown: float = COUNTDOWN) -> None:
        """Calibrate after a countdown.

        Parameters
        ----------
        range_of : bool
            Calibrate the range of eyes and mouth rather than the neutral face.
        countdown : float
            Seconds.

        Raises
        ------
        HeadError
            If the range is requested before there is a neutral face.
        """
        if range_of and self.worker.neutral is None:
            raise HeadError("There is no neutral face yet. Calibrate it first.")
        self._calibration = Calibration(self.worker, range_of=range_of, countdown=countdown)

    @property
    def calibration(self) -> Calibration | None:
        """The calibration that has been requested, or is running."""
        return self._calibration

    @property
    def recording_countdown(self) -> float | None:
        """Seconds until the recording starts; None if none was requested."""
        return None if self._delayed is None else self._delayed.left

    @property
    def countdown(self) -> float | None:
        """Seconds until the calibration or the recording starts; 0 during a calibration, otherwise None."""
        return None if (awaited := self._calibration or self._delayed) is None else awaited.left

    @property
    def task(self) -> str:
        """What the performer has to do in a calibration, or before a recording; otherwise ""."""
        return "" if (awaited := self._calibration or self._delayed) is None else awaited.task

    def start_recording_after(self, countdown: float, scene: bpy.types.Scene, name: str) -> None:
        """Start recording after a countdown; the parameters are those of `start_recording`, and seconds.

        Parameters
        ----------
        countdown : float
            Seconds to wait.
        scene : bpy.types.Scene
            Scene whose list gets the take.
        name : str
            Name of the take.

        Raises
        ------
        FacemimeError
            If there is a recording already, or the file cannot be created.
        """
        self._require_no_recording()
        if countdown > 0.0:
            self._delayed = DelayedRecording(perf_counter() + countdown, scene.name, name)
        else:
            self.start_recording(scene, name)

    def cancel_countdown(self) -> bool:
        """Cancel the countdown of a recording, and return whether there was one."""
        counting, self._delayed = self._delayed is not None, None
        return counting

    def start_recording(self, scene: bpy.types.Scene, name: str) -> Recording:
        """Record everything that is tracked from now on.

        Parameters
        ----------
        scene : bpy.types.Scene
            The take is added to its list.
        name : str
            Base of the file name.

        Raises
        ------
        FacemimeError
            If there is a recording already, or the file cannot be created.
        """
        self._require_no_recording()
        names = ["" if shown.gone else shown.obj.name for shown in self.heads]
        self.recording = Recording(self.worker, scene, name, names)
        self.attend_later()
        return self.recording

    def stop_recording(self) -> None:
        """Stop the recording, and add the take to the list.

        Raises
        ------
        FacemimeError
            If the end of the file cannot be written, or the file cannot be read.
        """
        recording = self.recording
        assert recording is not None
        try:
            recording.stop()
        finally:
            self._add_to_list()

    def rerecord(
        self, scene: bpy.types.Scene, take: str, start: float, end: float, *, lead: float, blend: float
    ) -> None:
        """Re-record a range of a take; the parameters are those of `PunchIn`.

        Parameters
        ----------
        scene : bpy.types.Scene
            Scene whose list has the take.
        take : str
            File of the take.
        start : float
            Start of the range in seconds.
        end : float
            End of the range in seconds.
        lead : float
            Seconds that are played before the range.
        blend : float
            Seconds over which the takes blend at both ends.

        Raises
        ------
        FacemimeError
            If there is a recording already, or the range is empty.
        """
        self._require_no_recording()
        self.punch_in = PunchIn(scene, take, start, end, lead=lead, blend=blend)
        self.attend_later()

    @property
    def pending(self) -> bool:
        """Whether there is a recording that is not in the list yet, or a range to be re-recorded."""
        return super().pending or self.recording is not None or self.punch_in is not None

    @property
    def has_events(self) -> bool:
        """Whether the operator handles the session."""
        return self.operator is not None

    def attend(self) -> None:
        """Continue with the range that is being re-recorded, and add a recording that has ended to the list."""
        for step in (self._continue_punch_in, self._add_to_list):
            try:
                step()
            except FacemimeError as error:
                show_error(str(error))
        super().attend()

    def before_undo(self) -> None:
        """Also note which recordings are in the list."""
        self._listed = [(name, path) for name, path in self._recorded if _lists(name, path)]
        super().before_undo()

    def survives_undo(self) -> bool:
        """Also list the recordings again that the undo has dropped: what was performed is not a step to undo."""
        survives = super().survives_undo()
        for name, path in self._listed:
            if not _lists(name, path) and (scene := bpy.data.scenes.get(name)) is not None:
                add(scene, path)
        return survives

    def suspend(self) -> None:
        """Restore the heads while the file is saved."""
        for shown in self.heads:
            shown.detach(keep=False, blocks=False)

    def resume(self) -> None:
        """Display the heads again after `suspend`."""
        for shown in self.heads:
            shown.attach()
        self._number, self._written = 0, ()

    def _stop(self) -> None:
        self.view(None)
        self.send_vertices(None)
        try:
            self.worker.close()
        except OutputError as error:
            self.worker.recording_error = error
            self.warning = str(error)
        if self.worker.running:
            self.warning = (
                f"{self.worker.source.name} does not respond and was abandoned. If it stays blocked, unplug it or "
                "restart Blender."
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

    def _show_elsewhere(self, before: ViewerServer | VertexSender | None) -> None:
        """Start the viewer or sender that the settings ask for, and end the one that it replaces."""
        self.worker.displays = tuple(one for one in (self._viewer, self._vertices) if one is not None)
        if before is not None:
            before.close()

    def _require_no_recording(self) -> None:
        if self.recording is not None:
            raise FacemimeError("A take is already being recorded. Stop it first.")

    def _add_to_list(self) -> None:
        """Add the recording to the list if it has ended."""
        recording = self.recording
        if recording is None or recording.running:
            return
        self.recording = None
        if listed := recording.add_to_list():
            self._recorded += listed
            bpy.context.window_manager.facemime.recorded = listed[-1][1].stem
            push_undo("Record Take")

    def _continue_punch_in(self) -> None:
        punch_in, self.punch_in = self.punch_in, None
        if punch_in is None:
            return
        if punch_in.step(self):
            self.punch_in = punch_in
        else:
            push_undo("Re-Record Range")

    def _continue_calibration(self) -> None:
        if self._calibration is None or not self._calibration.step():
            return
        self._calibration = None
        if self.worker.neutral is not None and self.worker.quality is not None:
            self._on_calibrated(self.worker.neutral)
        _signal()

    def _keep_learnt(self) -> None:
        """Store what was learnt about the performer from time to time, so that the next session starts from it."""
        if self._on_learnt is None or perf_counter() < self._kept_at + _KEEPING:
            return
        self._kept_at = perf_counter()
        if (learnt := self.worker.learnt) is not None and learnt is not self._learnt:
            self._learnt = learnt
            self._on_learnt(learnt)

    def _start_delayed(self) -> None:
        if self._delayed is None or not self._delayed.due:
            return
        delayed, self._delayed = self._delayed, None
        if delayed.scene in bpy.data.scenes and self.recording is None:
            self.start_recording(bpy.data.scenes[delayed.scene], delayed.name)
            _signal()

    def _measure_redraw(self) -> None:
        """Measure how long Blender took until it asked for the next frame, beyond the interval of its timer."""
        if self._displayed_at is not None:
            self.stopwatch.add_redraw(max(0.0, perf_counter() - self._displayed_at - TICK))
            self._displayed_at = None

    def _measure(self, latest: LiveResult, fetched: float) -> None:
        marks = (latest.taken, latest.began, latest.tracked, latest.driven, fetched, perf_counter())
        self.stopwatch.add(Delays(tuple(after - before for before, after in pairwise(marks))))


def _signal() -> None:
    """Signal to the performer that something has started or ended, unless the user has turned sounds off."""
    if preferences().sounds:
        beep()


def _lists(name: str, path: Path) -> bool:
    """Return whether the scene of that name has the take of a file in its list."""
    scene = bpy.data.scenes.get(name)
    return scene is not None and is_listed(scene, path)

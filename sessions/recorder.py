"""The recordings of a live session: at once, after a countdown, or over a range of a take with pre-roll."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Protocol

import bpy
import numpy as np

from ..blender.contexts import find_scene, in_a_window, push_undo
from ..blender.messages import show_error
from ..blender.timeline import frames_of
from ..core.errors import FacemimeError
from ..core.puppet.worker import LiveWorker
from ..core.takes.file import load_take
from ..core.takes.timing import punch_in, shift_time
from ..settings import takes_store
from ..settings.takes_store import add, is_listed
from ..settings.values import take_start
from .calibrating import DelayedRecording, signal
from .recording import Recording
from .session import Session


class Recordable(Protocol):
    """What records a live session."""

    recording: Recording | None

    @property
    def closed(self) -> bool:
        """Whether the session has ended."""

    def start(self, scene: bpy.types.Scene, name: str) -> Recording:
        """Start a recording for the list of `scene`; `name` is the base of the file name."""


class PunchIn:
    """Plays the scene, records a range after the pre-roll, and inserts it into a take.

    If it is interrupted, the part that was recorded is left to the session, which adds it to the list as a separate
    take. `take` is the path of the take, as in the list; `start` and `end` are the range in its own time, `lead` is the
    pre-roll and `blend` the duration of the transition at each end, all in seconds.
    """

    def __init__(
        self, scene: bpy.types.Scene, take: str, start: float, end: float, *, lead: float, blend: float
    ) -> None:
        if not end > start:
            raise FacemimeError(
                "The range from {start:.2f} s to {end:.2f} s is empty. Choose a later end.", start=start, end=end
            )
        self._scene, self._take = scene.session_uid, take
        self._start, self._end, self._blend = start, end, blend
        self._recording: Recording | None = None
        self._sync_mode = scene.sync_mode
        self._begin = perf_counter() + lead
        scene.sync_mode = "AUDIO_SYNC"
        scene.frame_set(round(float(frames_of(scene, np.array(start - lead), take_start(scene)))))
        screen = bpy.context.screen
        if screen is not None and not screen.is_animation_playing:
            bpy.ops.screen.animation_play()

    @property
    def time_left(self) -> float:
        """Seconds until the recording starts; 0 while it is running."""
        return max(0.0, self._begin - perf_counter())

    def step(self, recorder: Recordable) -> bool:
        """Continue, and return whether there is more to do; otherwise, and after an error, the playback is stopped.

        Raises FacemimeError if the range cannot be recorded or inserted.
        """
        more = False
        try:
            more = self._step(recorder)
        finally:
            if not more:
                self._stop_playback()
        return more

    def _step(self, recorder: Recordable) -> bool:
        if recorder.closed or (self._recording is not None and not self._recording.running):
            raise FacemimeError(
                "The puppet was stopped before the end of the range. The part that was recorded is in the list."
            )
        scene = find_scene(self._scene)
        if scene is None:
            raise FacemimeError("The scene of the take was deleted. Record the range in another scene.")
        if self._recording is None:
            if self.time_left == 0.0:
                self._recording = recorder.start(scene, "Insert")
            return True
        if self._recording.seconds < self._end - self._start:
            return True
        self._recording.stop()
        self._insert(scene, self._recording)
        recorder.recording = None
        return False

    def _insert(self, scene: bpy.types.Scene, recording: Recording) -> None:
        line = next((line for line in scene.facemime_takes.items if line.path == self._take), None)
        if line is None:
            raise FacemimeError("The take is no longer in the list. The recording was added as a separate take.")
        insert = shift_time(load_take(recording.path), self._start)
        takes_store.change(
            line, punch_in(takes_store.read(line, solved=False), insert, self._start, self._end, self._blend)
        )

    def _stop_playback(self) -> None:
        if (scene := find_scene(self._scene)) is not None:
            scene.sync_mode = self._sync_mode
        for window in bpy.context.window_manager.windows:
            if window.screen.is_animation_playing:
                with in_a_window(window):
                    bpy.ops.screen.animation_cancel(restore_frame=False)


class Recorder:
    """Records a session, one take or range at a time, and adds what was recorded to the list of its scene.

    Attributes
    ----------
    recording : Recording or None
        The running recording, or one that has ended and is not in the list yet.
    delayed : DelayedRecording or None
        The recording that starts after a countdown.
    punch_in : PunchIn or None
        The range that is being re-recorded.
    """

    def __init__(self, session: Session, worker: LiveWorker) -> None:
        self.recording: Recording | None = None
        self.delayed: DelayedRecording | None = None
        self.punch_in: PunchIn | None = None
        self._session, self._worker = session, worker
        self._recorded: list[tuple[int, Path]] = []
        self._listed: list[tuple[int, Path]] = []

    @property
    def closed(self) -> bool:
        """Whether the session has ended."""
        return self._session.closed

    @property
    def pending(self) -> bool:
        """Whether there is a recording that is not in the list yet, or a range to be re-recorded."""
        return self.recording is not None or self.punch_in is not None

    def start(self, scene: bpy.types.Scene, name: str) -> Recording:
        """Record everything that is tracked from now on, for the list of a scene; `name` is the base of the file name.

        Raises FacemimeError if there is a recording already, or the file cannot be created.
        """
        self._require_none()
        heads = ["" if shown.gone else shown.obj.name for shown in self._session.heads]
        self.recording = Recording(self._worker, scene, name, heads)
        self._session.attend_later()
        return self.recording

    def start_after(self, countdown: float, scene: bpy.types.Scene, name: str) -> None:
        """Start recording after a countdown in seconds, otherwise as `start`."""
        self._require_none()
        if countdown > 0.0:
            self.delayed = DelayedRecording(perf_counter() + countdown, scene.session_uid, name)
        else:
            self.start(scene, name)

    def cancel_countdown(self) -> bool:
        """Cancel the countdown of a recording, and return whether there was one."""
        counting, self.delayed = self.delayed is not None, None
        return counting

    def stop(self) -> None:
        """Stop the recording, and add the take to the list.

        Raises FacemimeError if the end of the file cannot be written, or the file cannot be read.
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

        Raises FacemimeError if there is a recording already, or the range is empty.
        """
        self._require_none()
        self.punch_in = PunchIn(scene, take, start, end, lead=lead, blend=blend)
        self._session.attend_later()

    def step(self) -> None:
        """Start the recording whose countdown has ended."""
        if self.delayed is None or not self.delayed.due:
            return
        delayed, self.delayed = self.delayed, None
        if (scene := find_scene(delayed.scene)) is not None and self.recording is None:
            self.start(scene, delayed.name)
            signal()

    def attend(self) -> None:
        """Continue with the range that is being re-recorded, and add a recording that has ended to the list."""
        for step in (self._continue_punch_in, self._add_to_list):
            try:
                step()
            except FacemimeError as error:
                show_error(str(error))

    def note_listed(self) -> None:
        """Note which recordings are in the list, before an undo."""
        self._listed = [(uid, path) for uid, path in self._recorded if _lists(find_scene(uid), path)]

    def list_again(self) -> None:
        """List the recordings again that an undo has dropped: what was performed is not a step to undo."""
        for uid, path in self._listed:
            if (scene := find_scene(uid)) is not None and not _lists(scene, path):
                add(scene, path)

    def _require_none(self) -> None:
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


def _lists(scene: bpy.types.Scene | None, path: Path) -> bool:
    """Return whether a scene has the take of a file in its list; False for None."""
    return scene is not None and is_listed(scene, path)

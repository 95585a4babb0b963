"""Re-recording of a range of a take with pre-roll, blended at both ends."""

from __future__ import annotations

from time import perf_counter
from typing import Protocol

import bpy
import numpy as np

from ..blender.contexts import in_a_window
from ..blender.timeline import frames_of
from ..core.errors import FacemimeError
from ..core.takes.file import load_take
from ..core.takes.timing import punch_in, shift_time
from ..settings import takes_store
from ..settings.values import take_start
from .recording import Recording


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
    take.

    Parameters
    ----------
    take : str
        Path of the take, as in the list.
    start, end : float
        Range in the take's own time, seconds.
    lead : float
        Pre-roll, seconds.
    blend : float
        Duration of the transition at each end, seconds.
    """

    def __init__(
        self, scene: bpy.types.Scene, take: str, start: float, end: float, *, lead: float, blend: float
    ) -> None:
        if not end > start:
            raise FacemimeError(
                "The range from {start:.2f} s to {end:.2f} s is empty. Choose a later end.", start=start, end=end
            )
        self._scene, self._take = scene.name, take
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

        Raises
        ------
        FacemimeError
            If the range cannot be recorded or inserted.
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
        scene = bpy.data.scenes.get(self._scene)
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
        takes_store.change(line, punch_in(takes_store.read(line), insert, self._start, self._end, self._blend))

    def _stop_playback(self) -> None:
        if (scene := bpy.data.scenes.get(self._scene)) is not None:
            scene.sync_mode = self._sync_mode
        for window in bpy.context.window_manager.windows:
            if window.screen.is_animation_playing:
                with in_a_window(window):
                    bpy.ops.screen.animation_cancel(restore_frame=False)

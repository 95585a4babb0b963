"""Re-recording of a range of a take with pre-roll, blended at both ends."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import bpy
from bpy.app.handlers import persistent

from ..core.errors import FacemimeError, HeadError
from ..core.takes.file import load_take
from ..core.takes.timing import punch_in, shift_time
from ..settings import takes_store
from .live import LiveSession
from .recording import Recording, settle, start_recording, stop_recording
from .session import Session


class PunchIn:
    """Records a range after the pre-roll and inserts it into a take.

    If it is interrupted, the part that was recorded is added to the list as a separate take.

    Parameters
    ----------
    session : LiveSession
        Session to record.
    scene : bpy.types.Scene
    take : str
        Path of the take, as in the list.
    start, end : float
        Range in the take's own time, seconds.
    lead : float
        Pre-roll, seconds.
    blend : float
        Duration of the transition at each end, seconds.
    clock : callable
        Returns the time in seconds.
    """

    current = None
    """The running instance."""

    def __init__(
        self,
        session: LiveSession | None,
        scene: bpy.types.Scene,
        take: str,
        start: float,
        end: float,
        *,
        lead: float = 2.0,
        blend: float = 0.2,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        if session is None:
            raise HeadError("No puppet is running. Start it before recording.")
        if not end > start:
            raise FacemimeError(f"The range from {start:.2f} s to {end:.2f} s is empty. Choose a later end.")
        if Recording.current is not None:
            raise FacemimeError("A take is already being recorded. Stop it first.")
        self._session, self._scene, self._take = session, scene.name, take
        self._start, self._end, self._blend = start, end, blend
        self._clock, self._begin = clock, clock() + lead
        self._recording: Recording | None = None
        PunchIn.current = self

    @property
    def time_left(self) -> float:
        """Seconds until the recording starts; 0 while it is running."""
        return max(0.0, self._begin - self._clock())

    def step(self) -> bool:
        """Continue, and return whether there is more to do.

        Raises
        ------
        FacemimeError
            If the range cannot be recorded or inserted.
        """
        try:
            more = self._step()
        except Exception:
            PunchIn.current = None
            raise
        if not more:
            PunchIn.current = None
        return more

    def _step(self) -> bool:
        if Session.current is not self._session or (self._recording is not None and not self._recording.running):
            settle()
            raise FacemimeError(
                "The puppet was stopped before the end of the range. The part that was recorded is in the list."
            )
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            raise FacemimeError("The scene of the take was deleted. Record the range in another scene.")
        if self._recording is None:
            if self.time_left == 0.0:
                self._recording = start_recording(self._session, scene, "Punch In")
            return True
        if self._recording.length < self._end - self._start:
            return True
        stop_recording()
        Recording.current = None
        self._insert(scene, self._recording)
        return False

    def _insert(self, scene: bpy.types.Scene, recording: Recording) -> None:
        line = next((line for line in scene.facemime_takes.items if line.path == self._take), None)
        if line is None:
            takes_store.add(scene, recording.path)
            raise FacemimeError("The take is no longer in the list. The recording was added as a separate take.")
        insert = shift_time(load_take(recording.path), self._start)
        takes_store.change(line, punch_in(takes_store.read(line), insert, self._start, self._end, self._blend))


@persistent
def _forget(*_: object) -> None:
    """Drop the recordings of a file that is closed; they are in its folder, where Find Takes finds them."""
    PunchIn.current = Recording.current = None


HANDLERS = {"load_pre": _forget}

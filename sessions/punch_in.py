"""A part of a take, recorded anew between two moments while what comes before it is played, and blended in."""

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
    """Records after a lead, for as long as the part lasts, and puts what came into the take.

    Where it is broken off, what was recorded so far is listed as a take of its own.

    Parameters
    ----------
    session : LiveSession
        What is recorded.
    scene : bpy.types.Scene
    take : str
        Its file, as the list has it.
    start, end : float
        Of the part, seconds of the take's own clock.
    lead : float
        Seconds before it begins.
    blend : float
        Seconds, at either side, in which one passes into the other.
    clock : callable
        Gives seconds.
    """

    current = None
    """The one that runs."""

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
            raise HeadError("Nothing is running that could be recorded. Start the puppet first.")
        if not end > start:
            raise FacemimeError(f"The part from {start:.2f} s to {end:.2f} s has no length. Choose a later end.")
        if Recording.current is not None:
            raise FacemimeError("A take is being recorded. Stop that first.")
        self._session, self._scene, self._take = session, scene.name, take
        self._start, self._end, self._blend = start, end, blend
        self._clock, self._begin = clock, clock() + lead
        self._recording: Recording | None = None
        PunchIn.current = self

    @property
    def ahead(self) -> float:
        """Seconds until the recording begins; 0 while it runs."""
        return max(0.0, self._begin - self._clock())

    def step(self) -> bool:
        """Do what is due; whether there is more to come.

        Raises
        ------
        FacemimeError
            Where the part cannot be recorded or put in.
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
            raise FacemimeError("The puppet stopped before the part was recorded whole. What there is, is in the list.")
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            raise FacemimeError("The scene of the take is gone.")
        if self._recording is None:
            if self.ahead == 0.0:
                self._recording = start_recording(self._session, scene, "Punch In")
            return True
        if self._recording.length < self._end - self._start:
            return True
        stop_recording()
        Recording.current = None
        self._put_in(scene, self._recording)
        return False

    def _put_in(self, scene: bpy.types.Scene, recording: Recording) -> None:
        line = next((line for line in scene.facemime_takes.items if line.path == self._take), None)
        if line is None:
            takes_store.add(scene, recording.path)
            raise FacemimeError("The take is no longer in the list. What was recorded is in it instead.")
        insert = shift_time(load_take(recording.path), self._start)
        takes_store.change(line, punch_in(takes_store.read(line), insert, self._start, self._end, self._blend))


@persistent
def _forget(*_: object) -> None:
    """What was recorded for a file belongs to no other; it lies in that one's folder, where Find Takes sees it."""
    PunchIn.current = Recording.current = None


HANDLERS = {"load_pre": _forget}

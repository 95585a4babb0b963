"""The worker of a live session: takes the newest frame, tracks it, drives the heads, and publishes the result.

It runs in a thread of its own, without Blender. Settings reach it as frozen values that are replaced as a whole, and
results leave it in the same way, so that neither side waits for the other.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..drive.driver import HeadFrame
from ..errors import FacemimeError, OutputError
from ..takes.neutral import Neutral
from ..takes.take import Take, TakeRecorder
from ..tracking.overlay import draw_preview
from ..tracking.people import PeopleRoles, PeopleTracker
from ..tracking.result import TrackResult
from ..tracking.tracker import DEFAULTS, FaceTracker, TrackingSettings
from .outputs import Display, FrameRecorder, HeadDrivers, LiveHead, Output
from .performer import Performer
from .puppet_settings import PuppetSettings
from .sources import LiveFrame, LiveSource

_PATIENCE = 0.1
"""Seconds to wait for a frame before pending frames are written."""
_ENDING = 5.0
"""Seconds that `close` waits for the thread, which may be tracking, or stuck in a driver or on a disk."""


@dataclass(frozen=True)
class LiveOptions:
    """Options that may change during a session.

    Attributes
    ----------
    smoothing : float
        Amount for `ResultSmoother`; 0 disables smoothing.
    preview : int
        Width of the preview in pixels; 0 for none.
    face : (float, float) or None
        Position of the face to track, as for `FaceTracker.choose`; None for the largest.
    learn : bool
        Whether to learn the performer meanwhile: the neutral face, unless it was calibrated, and where eyes are shut.
    people : tuple of int or None
        For each head, the number of the person who drives it, from 1 in order of appearance, or 0 for whoever has no
        head yet; None to track one face, which drives all heads.
    """

    smoothing: float = PuppetSettings.smoothing
    preview: int = 0
    face: tuple[float, float] | None = None
    tracking: TrackingSettings = DEFAULTS
    learn: bool = True
    people: tuple[int, ...] | None = None


@dataclass(frozen=True)
class LiveResult:
    """The result of a frame.

    Attributes
    ----------
    number : int
        Number of the frame, increasing by 1.
    time : float
        Time in the source in seconds.
    result : TrackResult
        Result of the performer of the first head, smoothed according to the options.
    heads : tuple of HeadFrame
        Frame of each head, by its performer; empty if there is no face.
    prepared : tuple
        Result of `LiveHead.prepare` for each head.
    taken, began, tracked, driven : float
        `time.perf_counter()` when the frame arrived, and when the worker had the frame, the landmarks, and the heads.
    preview : (H, W, 4) float32 or None
        As from `draw_preview`; None without a preview.
    people : mapping of int to tuple of int
        If everybody is tracked, the numbers of the people in view, from 0, and of the heads that each drives.
    """

    number: int
    time: float
    result: TrackResult
    heads: tuple[HeadFrame, ...]
    prepared: tuple[Any, ...]
    taken: float
    began: float
    tracked: float
    driven: float
    preview: NDArray[np.float32] | None = None
    people: Mapping[int, tuple[int, ...]] = field(default_factory=dict)


@dataclass
class Counts:
    """Numbers of frames: `tracked`, of which `lost` have no face, and `dropped` ones that were not tracked."""

    tracked: int = 0
    lost: int = 0
    dropped: int = 0


class LiveWorker:
    """Tracks a source in a thread until `close`, the end of the source, or an error before the first frame.

    Parameters
    ----------
    source : LiveSource
        The source; closed with the worker.
    neutral : Neutral, optional
        The performer's neutral face; by default the first second with a face is used.
    heads : tuple of LiveHead
        The heads to drive.
    options : LiveOptions
        Initial options.
    load_tracker : callable, optional
        Returns the tracker; called in the thread, as it takes a moment. By default one with a gradual search, as a long
        search would stall the puppet when somebody returns to the camera.
    output : Output, optional
        Receives every frame; closed with the worker.

    Attributes
    ----------
    options : LiveOptions
        The current options; may be assigned at any time, as may `heads` and `displays`.
    displays : tuple of Display
        Receive every frame of the heads; they are not closed with the worker.
    first : Performer
        The performer of the first head.
    latest : LiveResult or None
        Result of the newest frame.
    counts : Counts
        Numbers of frames.
    message : str
        Reason why no frames come; otherwise "".
    error : Exception or None
        Error that ended the worker.
    recording_error : OutputError or None
        Error that ended a recording; what was written before is safe.
    model : str
        Identifier of the tracker model; "" until it is loaded.
    """

    def __init__(
        self,
        source: LiveSource,
        *,
        neutral: Neutral | None = None,
        heads: tuple[LiveHead, ...] = (),
        options: LiveOptions = LiveOptions(),
        load_tracker: Callable[[], FaceTracker] | None = None,
        output: Output | None = None,
    ) -> None:
        self.source, self.heads, self.options = source, heads, options
        self.latest: LiveResult | None = None
        self.counts = Counts()
        self.message = ""
        self.error: Exception | None = None
        self.recording_error: OutputError | None = None
        self._load_tracker = load_tracker or partial(FaceTracker.load, gradual=True, settings=options.tracking)
        self.output = output
        self.displays: tuple[Display, ...] = ()
        self.first = Performer(neutral)
        self._performers = {0: self.first}
        self._recorder: FrameRecorder | None = None
        self._recording = threading.Lock()
        self._drivers = HeadDrivers()
        self._size: tuple[int, ...] = ()
        self._face: tuple[float, float] | None = None
        self._next_face = False
        self._people: PeopleTracker | None = None
        self._roles = PeopleRoles()
        self.model = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="facemime-live", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread is running."""
        return self._thread.is_alive()

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the frames in pixels; (0, 0) before the first frame, and for takes."""
        return (self._size[1], self._size[0]) if self._size else (0, 0)

    def performer(self, number: int) -> Performer | None:
        """Return a performer of a source with several; None if none of their frames has come yet."""
        return self._performers.get(number)

    def close(self) -> None:
        """End the thread, the source and any recording. May be called twice, and before `start`.

        If the source or the disk does not respond, this returns after some seconds anyway: `running` stays true, and
        the thread ends by itself when it can. Raises OutputError if the end of a recording cannot be written.
        """
        self._stop.set()
        self.source.close()
        if self._thread.is_alive():
            self._thread.join(_ENDING)
        if self.output is not None:
            self.output.close()
        self.stop_recording()

    def calibrate(self, *, range_of: bool = False) -> None:
        """Use the next second as the neutral face of all performers, or the next seconds as their range."""
        for performer in tuple(self._performers.values()):
            if not range_of or performer.neutral is not None:
                performer.calibrate(range_of=performer.neutral if range_of else None)

    def forget(self) -> None:
        """Forget all neutral faces. The next second with a face is used, and learning starts from scratch."""
        for performer in tuple(self._performers.values()):
            performer.forget()

    def follow_next(self) -> None:
        """Track another face in view. See `FaceTracker.choose_next`."""
        self._next_face = True

    def recent_take(self) -> Take:
        """Return the take of the last half minute; SourceError before the first frame."""
        recorder = TakeRecorder({"source": self.source.name, "clock": self.source.clock})
        for time, result in tuple(self.first.recent):
            recorder.append(time, result)
        return recorder.finish()

    def record(self, recorder: FrameRecorder) -> None:
        """Record all further frames with `recorder`, which is closed at the end."""
        self.stop_recording()
        with self._recording:
            self._recorder, self.recording_error = recorder, None

    def stop_recording(self) -> None:
        """End the recording, if there is one; OutputError if its end cannot be written."""
        if not self._recording.acquire(timeout=_ENDING):
            raise OutputError(
                "The disk of the recording does not respond. What was written before is safe: restore it "
                "with Find Takes when the disk is back."
            )
        try:
            recorder, self._recorder = self._recorder, None
        finally:
            self._recording.release()
        if recorder is not None:
            recorder.close()

    def _work(self) -> None:
        try:
            tracker = self._load_tracker()
            self.model = tracker.model_id
            with tracker.in_two_threads():
                while not self._stop.is_set() and not self.source.ended:
                    frame = self._read()
                    if frame is not None:
                        self._frame(tracker, frame)
        except Exception as error:  # read by the user's thread
            self.error = error

    def _read(self) -> LiveFrame | None:
        try:
            frame = self.source.read(_PATIENCE)
        except FacemimeError as error:
            if self.counts.tracked == 0:
                raise
            self.message = str(error)
            self._stop.wait(_PATIENCE)
            frame = None
        else:
            if frame is not None or self.source.message:
                self.message = self.source.message
            if frame is not None:
                self.counts.dropped += frame.dropped
        if frame is None:
            self._record()
        return frame

    def _frame(self, tracker: FaceTracker, frame: LiveFrame) -> None:
        began = perf_counter()
        options = self.options
        people: dict[int, tuple[int, ...]] = {}
        if frame.image is None or frame.result is not None or options.people is None:
            faces = [(frame, self._tracked(tracker, frame, options))]
        else:
            faces, people = self._everybody(tracker, frame, options.people)
        learn = options.learn and not self.source.complete
        results = []
        for one, seen in faces:
            performer = self._performer_of(one)
            if not one.filled:
                self._record(one, seen)
            results.append((one, performer, performer.add(one, seen, smoothing=options.smoothing, learn=learn)))
        tracked = perf_counter()
        heads: tuple[HeadFrame, ...] = ()
        prepared: tuple[Any, ...] = ()
        for one, performer, result in results:
            if self.output is not None and performer is self.first:
                self.output.send(one.time, result, performer.neutral, one.image_size)
            heads, prepared = self._drivers.drive(self.heads, performer.neutral, result, one.heads)
        driven = perf_counter()
        for display in self.displays:
            display.show(frame.taken, self._drivers.drivers, heads)
        first = self.first.result or results[0][2]
        shown = [result for _, _, result in results] if people else [first]
        preview = draw_preview(frame.image, shown, options.preview) if options.preview else None
        self.counts.tracked += 1
        self.counts.lost += not any(result.found for _, _, result in results)
        self.latest = LiveResult(
            self.counts.tracked,
            frame.time,
            first,
            heads,
            prepared,
            frame.taken,
            began,
            tracked,
            driven,
            preview,
            people,
        )

    def _everybody(
        self, tracker: FaceTracker, frame: LiveFrame, wanted: tuple[int, ...]
    ) -> tuple[list[tuple[LiveFrame, TrackResult]], dict[int, tuple[int, ...]]]:
        """Track everybody in a frame.

        Returns the frame and the result of each person who drives heads, of nobody if no one does yet, and the heads of
        each person in view.
        """
        assert frame.image is not None
        tracker.settings = self.options.tracking
        if self._people is None or frame.image.shape != self._size:
            tracker.reset()
            self._people, self._roles, self._size = PeopleTracker(tracker), PeopleRoles(), frame.image.shape
        results = self._people.track(frame.image)
        cast = self._roles.assign(wanted, results, frame.time)
        nothing = TrackResult.nothing(tracker.pdm.n_modes)
        faces = [
            (
                replace(frame, performer=person, heads=heads, sender=f"Person {person + 1}"),
                results.get(person, nothing),
            )
            for person, heads in cast.items()
        ]
        return faces or [(frame, nothing)], {person: cast.get(person, ()) for person in results}

    def _performer_of(self, frame: LiveFrame) -> Performer:
        """Return the performer in a frame."""
        if (performer := self._performers.get(frame.performer)) is None:
            performer = self._performers[frame.performer] = Performer()
        if frame.heads is None or 0 in frame.heads:
            self.first = performer
        return performer

    def _tracked(self, tracker: FaceTracker, frame: LiveFrame, options: LiveOptions) -> TrackResult:
        if frame.result is not None:
            return frame.result
        assert frame.image is not None
        tracker.settings, face = options.tracking, options.face
        if frame.image.shape != self._size or face != self._face or self._people is not None:
            tracker.reset()
            self._people = None
            self.first.change()
            self._size, self._face = frame.image.shape, face
            if face is not None:
                tracker.choose(*face)
        if self._next_face:
            self._next_face = False
            tracker.choose_next()
            self.first.change()
        return tracker.track(frame.image)

    def _record(self, frame: LiveFrame | None = None, seen: TrackResult | None = None) -> None:
        """Record a frame, or write pending frames if there is none."""
        with self._recording:
            if self._recorder is None:
                return
            try:
                if frame is None or seen is None:
                    self._recorder.flush()
                else:
                    self._recorder.append(frame, seen)
            except OutputError as error:
                self._recorder = None
                self.recording_error = error

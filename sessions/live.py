"""Live sessions: a worker thread captures and tracks, and the main thread copies the results to the heads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from time import perf_counter

from ..blender.animation.live import LiveHeadObject, flatten_for_keys, require_one_left
from ..blender.undo import push_undo
from ..core.errors import HeadError, OutputError
from ..core.live.sources import LiveSource
from ..core.live.timing import Delays, Stopwatch
from ..core.live.worker import LiveHead, LiveOptions, LiveResult, LiveWorker, Recorder
from ..core.takes.neutral import Neutral
from .session import Session

COUNTDOWN = 3.0
"""Seconds between the request for a calibration and its start."""
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
    on_calibrated : callable, optional
        Called with the `Neutral` of each calibration that was requested.

    Attributes
    ----------
    stopwatch : Stopwatch
    keep : bool
        Whether the heads keep their pose at the end.
    shown : LiveResult or None
        The result on display; the worker may have a newer one.
    warning : str
        What went wrong at the end; "" if nothing.
    """

    def __init__(
        self,
        source: LiveSource,
        heads: Sequence[tuple[LiveHeadObject, LiveHead]],
        *,
        neutral: Neutral | None = None,
        options: LiveOptions = _DEFAULTS,
        on_calibrated: Callable[[Neutral], object] = lambda neutral: None,
    ) -> None:
        super().__init__()
        self.stopwatch, self.keep, self.warning = Stopwatch(), False, ""
        self.shown: LiveResult | None = None
        self._objects = [shown for shown, _ in heads]
        self._on_calibrated = on_calibrated
        self._at: float | None = None
        self._range = False
        self._waiting = False
        self._number = 0
        self.worker = LiveWorker(
            source, neutral=neutral, heads=tuple(head for _, head in heads), options=options, prepare=flatten_for_keys
        )
        try:
            for shown in self._objects:
                shown.attach()
        except Exception:
            self.close()
            raise
        push_undo("Start Puppet")
        self.worker.start()

    @property
    def objects(self) -> Sequence[LiveHeadObject]:
        """Heads in the scene."""
        return self._objects

    def step(self) -> bool:
        """Display the newest result and return whether there was a new one.

        Raises
        ------
        Exception
            If the worker failed, its exception; HeadError if a head was changed, or all were deleted.
        """
        self._count_down()
        latest = self.worker.latest
        if latest is None or latest.number == self._number:
            if self.worker.error is not None:
                raise self.worker.error
            return False
        fetched = perf_counter()
        self._number, self.shown = latest.number, latest
        require_one_left(self._objects)
        for shown, frame, flat in zip(self._objects, latest.heads, latest.prepared, strict=False):
            if not shown.gone:
                shown.write(frame, flat)
        self._measure(latest, fetched)
        return True

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
        self._at, self._range, self._waiting = perf_counter() + countdown, range_of, True
        self.worker.quality = None

    @property
    def countdown(self) -> float | None:
        """Seconds until the calibration starts; 0 while it is running, None if none was requested."""
        if not self._waiting:
            return None
        return 0.0 if self._at is None else max(0.0, self._at - perf_counter())

    def close(self, *, blocks: bool = True) -> None:
        """Stop the worker, release the source and restore the heads, unless `keep` is set; sets `warning`."""
        self._close_worker()
        removed = [shown.detach(keep=self.keep, blocks=blocks) for shown in self._objects]
        super().close()
        if any(removed):
            push_undo("Stop Puppet")

    def abandon(self) -> None:
        """Stop the worker and release the source without touching Blender's data."""
        self._close_worker()
        super().close()

    def _close_worker(self) -> None:
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

    def suspend(self) -> None:
        """Restore the heads while the file is saved."""
        for shown in self._objects:
            shown.detach(keep=False, blocks=False)

    def resume(self) -> None:
        """Display the heads again after `suspend`."""
        for shown in self._objects:
            shown.attach()
        self._number = 0

    def record(self, recorder: Recorder) -> None:
        """Record everything that is tracked from now on."""
        self.worker.record(recorder)

    def _count_down(self) -> None:
        if not self._waiting:
            return
        if self._at is not None:
            if perf_counter() >= self._at:
                self._at = None
                self.worker.calibrate(range_of=self.worker.neutral if self._range else None)
        elif not self.worker.calibrating:
            self._waiting = False
            if self.worker.neutral is not None and self.worker.quality is not None:
                self._on_calibrated(self.worker.neutral)

    def _measure(self, latest: LiveResult, fetched: float) -> None:
        marks = (latest.taken, latest.began, latest.tracked, latest.driven, fetched, perf_counter())
        self.stopwatch.add(Delays(tuple(after - before for before, after in pairwise(marks))))

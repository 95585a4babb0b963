"""Heads moved by a live source: a worker thread captures and tracks, the main thread only shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from time import perf_counter

from ..blender.animation.live import LiveHeadObject, as_keys_take_it, require_one_left
from ..blender.undo import push_undo
from ..core.errors import HeadError, OutputError
from ..core.live.sources import LiveSource
from ..core.live.timing import Delays, Stopwatch
from ..core.live.worker import LiveHead, LiveOptions, LiveResult, LiveWorker, Recorder
from ..core.takes.neutral import Neutral
from .session import Session

COUNTDOWN = 3.0
"""Seconds between asking for a calibration and taking it."""
_DEFAULTS = LiveOptions()


class LiveSession(Session):
    """Moves heads by a live source, until `close`.

    `step` is all that happens in Blender's main thread: it takes the worker's newest result and writes it.

    Parameters
    ----------
    source : LiveSource
    heads : sequence of (LiveHeadObject, LiveHead)
        In the scene, and for the worker.
    neutral : Neutral, optional
        The performer's; without one the first second with a face is taken.
    on_calibrated : callable, optional
        Hears of a calibration that the user asked for.

    Attributes
    ----------
    stopwatch : Stopwatch
    keep : bool
        Whether the heads stay as they are at the end.
    shown : LiveResult or None
        What the heads show: the worker's newest result may be newer.
    warning : str
        What went wrong at the end; "" if all went well.
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
            source, neutral=neutral, heads=tuple(head for _, head in heads), options=options, prepare=as_keys_take_it
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
        """The heads in the scene."""
        return self._objects

    def step(self) -> bool:
        """Show the newest result, if there is a new one; whether there was.

        Raises
        ------
        Exception
            What ended the worker; HeadError where a head was changed, or all are gone.
        """
        self._count_down()
        latest = self.worker.latest
        if latest is None or latest.number == self._number:
            if self.worker.error is not None:
                raise self.worker.error
            return False
        asked = perf_counter()
        self._number, self.shown = latest.number, latest
        require_one_left(self._objects)
        for shown, frame, flat in zip(self._objects, latest.heads, latest.prepared, strict=False):
            if not shown.gone:
                shown.write(frame, flat)
        self._note(latest, asked)
        return True

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames and all is shown."""
        return not self.worker.running and self.worker.error is None

    def update(self, heads: Sequence[LiveHead]) -> None:
        """Drive the same objects by other rigs or options."""
        self.worker.heads = tuple(heads)

    def calibrate(self, *, range_of: bool = False, countdown: float = COUNTDOWN) -> None:
        """After `countdown` seconds take the performer's neutral, or with `range_of` how far eyes and mouth go.

        Raises
        ------
        HeadError
            Where the range is asked for before there is a neutral.
        """
        if range_of and self.worker.neutral is None:
            raise HeadError("The range needs the neutral face first. Calibrate that.")
        self._at, self._range, self._waiting = perf_counter() + countdown, range_of, True
        self.worker.quality = None

    @property
    def countdown(self) -> float | None:
        """Seconds until the calibration begins, 0 while it is taken, None where none is asked for."""
        if not self._waiting:
            return None
        return 0.0 if self._at is None else max(0.0, self._at - perf_counter())

    def close(self, *, blocks: bool = True) -> None:
        """End the worker, release the source, and leave the heads as `keep` says; `warning` tells what went wrong."""
        self._close_worker()
        removed = [shown.detach(keep=self.keep, blocks=blocks) for shown in self._objects]
        super().close()
        if any(removed):
            push_undo("Stop Puppet")

    def abandon(self) -> None:
        """End the worker and release the source alone."""
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
                f"{self.worker.source.name} does not answer. It is left to end by itself; if it does not, unplug it or "
                "restart Blender."
            )

    def suspend(self) -> None:
        """Put the heads back for a moment: to save the file without what is only shown."""
        for shown in self._objects:
            shown.detach(keep=False, blocks=False)

    def resume(self) -> None:
        """Show the heads again after `suspend`."""
        for shown in self._objects:
            shown.attach()
        self._number = 0

    def record(self, recorder: Recorder) -> None:
        """Write what is tracked from now on."""
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

    def _note(self, latest: LiveResult, asked: float) -> None:
        marks = (latest.taken, latest.began, latest.tracked, latest.driven, asked, perf_counter())
        self.stopwatch.add(Delays(tuple(after - before for before, after in pairwise(marks))))

"""Recipients of a live performance: heads, prepared again only if something has changed, some of which are driven by
their own shape keys, and the interfaces of all others: recordings, streams and browsers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..bake.arkit import FrameCoefficients
from ..bake.own_keys import look_factors, reaching
from ..drive.drive_settings import DriveSettings
from ..drive.driver import HeadDriver, HeadFrame
from ..drive.teaching import TaughtKeys
from ..heads.key_map import KeyMap
from ..heads.rig import HeadRig
from ..takes.neutral import Neutral
from ..takes.timing import at_rest
from ..tracking.result import TrackResult
from .sources import LiveFrame


@dataclass(frozen=True, eq=False)
class LiveKeys:
    """Shape keys of a head, and the mapping that drives them.

    Attributes
    ----------
    table : KeyMap
        The key mapping.
    offsets : dict of str to (A, 3) float32
        Displacements at value 1 of the vertices in `HeadRig.all_vertices`: head frame, unit of the mesh.
    ranges : dict of str to (float, float)
        Smallest and largest value of each key.
    rest : dict of str to float
        Values at rest of keys that are not in the mapping but were taught; by default 0.
    lids : (float, float)
        Factors of the left and the right blink that shut the eyes, from `lid_factors`.
    """

    table: KeyMap
    offsets: dict[str, NDArray[np.float32]]
    ranges: dict[str, tuple[float, float]]
    rest: dict[str, float] = field(default_factory=dict)
    lids: tuple[float, float] = (1.0, 1.0)


class KeyDriver:
    """Drives a head by its shape keys, and its pose by a `HeadDriver` with the same neutral face, not mirrored."""

    def __init__(self, head: HeadDriver, neutral: Neutral, keys: LiveKeys) -> None:
        self.head, self.keys = head, keys
        looks, lids = look_factors(head.rig, keys.table, keys.offsets), np.array(keys.lids)
        self._ranges = reaching(keys.ranges, keys.table, lids)
        self._coefficients = FrameCoefficients(neutral, head.options, looks, lids)
        self.taught = TaughtKeys(head.rig.style)

    def frame(self, result: TrackResult) -> HeadFrame:
        """Compute the head for a tracking result with a face."""
        posed = self.head.frame(result)
        values = self.keys.table.apply(self._coefficients.of(result)[None], self._ranges)
        values = self.taught.corrected(values, [self.head.expression(result)], self._ranges, self.keys.rest)
        vertices = np.array(self.head.rest, dtype=np.float32)
        for name, (value,) in values.items():
            if value != 0.0:
                vertices += np.float32(value) * self.keys.offsets[name]
        amounts = np.array([float(values[name][0]) if name in values else 0.0 for name in self.keys.offsets])
        return replace(posed, vertices=vertices, keys=amounts)


@dataclass(frozen=True, eq=False)
class LiveHead:
    """A head to drive.

    Attributes
    ----------
    rig : HeadRig
        The head. If it is replaced by another object, the driver is prepared again.
    options : DriveSettings
        How the performance moves the head.
    prepare : callable
        Called in the worker's thread with each `HeadFrame`, to prepare what would otherwise delay its display.
    keys : LiveKeys, optional
        Shape keys that drive the vertices instead of the landmarks.
    """

    rig: HeadRig
    options: DriveSettings = field(default_factory=DriveSettings)
    prepare: Callable[[HeadFrame], Any] = lambda frame: None
    keys: LiveKeys | None = None


@dataclass
class _Driven:
    """The current state of a head."""

    head: LiveHead
    neutral: Neutral
    result: TrackResult
    driver: HeadDriver | KeyDriver
    frame: HeadFrame
    prepared: Any


class HeadDrivers:
    """Drivers of several heads, which may be replaced from one frame to the next."""

    def __init__(self) -> None:
        self._driven: list[_Driven] = []
        self._heads: tuple[LiveHead, ...] = ()

    @property
    def drivers(self) -> list[HeadDriver | KeyDriver]:
        """Drivers of the heads in the last frame."""
        return [driven.driver for driven in self._driven]

    def drive(
        self,
        heads: tuple[LiveHead, ...],
        neutral: Neutral | None,
        result: TrackResult,
        chosen: tuple[int, ...] | None = None,
    ) -> tuple[tuple[HeadFrame, ...], tuple[Any, ...]]:
        """Drive heads by a result of a performer, and return their frames, and what `LiveHead.prepare` made of each.

        If `heads` or `neutral` is another object than before, drivers are prepared; deformers of unchanged rigs are
        reused. Without a neutral face, or a face in the result, there are no frames. The performer drives the `chosen`
        heads, by default all. The others keep their last frame, initially at rest.
        """
        if neutral is not None and result.found:
            self._update(heads, neutral, result, chosen)
        elif chosen is None:
            return (), ()
        return tuple(driven.frame for driven in self._driven), tuple(driven.prepared for driven in self._driven)

    def _update(
        self, heads: tuple[LiveHead, ...], neutral: Neutral, result: TrackResult, chosen: tuple[int, ...] | None
    ) -> None:
        changed, before = self._heads is not heads, dict(enumerate(self._driven))
        self._heads, drivers = heads, self.drivers
        rest = None if chosen is None else at_rest(neutral, result)
        for number, head in enumerate(heads):
            known = before.get(number)
            if chosen is None or number in chosen:
                driven = _drive(head, neutral, result, drivers, known)
            elif known is None:
                driven = _drive(head, neutral, rest or result, drivers, known)
            elif changed:
                driven = _drive(head, known.neutral, known.result, drivers, known)
            else:
                continue
            self._driven[number : number + 1] = [driven]
        del self._driven[len(heads) :]


def _drive(
    head: LiveHead,
    neutral: Neutral,
    result: TrackResult,
    drivers: list[HeadDriver | KeyDriver],
    known: _Driven | None,
) -> _Driven:
    """Drive a head by a result, with the same driver as before if nothing else has changed."""
    if known is not None and known.head is head and known.neutral is neutral:
        driver = known.driver
    else:
        driver = _prepare(head, neutral, drivers)
    frame = driver.frame(result)
    return _Driven(head, neutral, result, driver, frame, head.prepare(frame))


def _prepare(head: LiveHead, neutral: Neutral, drivers: list[HeadDriver | KeyDriver]) -> HeadDriver | KeyDriver:
    """Create a driver, with the deformer of one of `drivers` that has the same rig."""
    earlier = [driver.head if isinstance(driver, KeyDriver) else driver for driver in drivers]
    before = next((driver for driver in earlier if driver.rig.same_face(head.rig)), None)
    driver = HeadDriver(head.rig, neutral, head.options, reuse=before)
    return driver if head.keys is None else KeyDriver(driver, neutral, head.keys)


class FrameRecorder(Protocol):
    """Interface of a recording."""

    def append(self, frame: LiveFrame, result: TrackResult) -> None:
        """Record a frame and its result, as tracked."""

    def flush(self) -> None:
        """Write pending frames to the disk."""

    def close(self) -> None:
        """End the recording."""


class Output(Protocol):
    """Interface of an output that passes the performance on, such as a stream. It must neither wait nor raise.

    Attributes
    ----------
    sent : int
        Number of frames that were passed on.
    message : str
        Reason why none are; otherwise "".
    """

    sent: int

    @property
    def message(self) -> str:
        """Reason why nothing is passed on; otherwise ""."""

    def send(
        self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int] | None = None
    ) -> None:
        """Pass on a frame and its result, smoothed according to the options.

        `time` is in the source in seconds, `neutral` is None if it is not known, and `size` is the width and height of
        the image in pixels.
        """

    def close(self) -> None:
        """End the output."""


@runtime_checkable
class DrivenOutput(Output, Protocol):
    """Interface of an output whose content depends on how heads move; `options` may be assigned at any time."""

    options: DriveSettings


class Display(Protocol):
    """Interface of a display of the driven heads elsewhere, such as a viewer. It must neither wait nor raise."""

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Show a frame of each head, or none if there is no face; `taken` is `time.perf_counter()` at arrival."""

"""The file of a take, `.facetake`: written while it is recorded, read whatever has happened to it since."""

from __future__ import annotations

import contextlib
import os
import time as clock
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ..capture import check_readable
from ..errors import OutputError, SourceError
from ..files import replacing
from ..reading import read_bytes
from ..tracking.result import TrackResult
from .format import (
    END,
    FRAMES,
    START,
    Chunk,
    NewerFormatError,
    chunk_bytes,
    chunks_in,
    frames_content,
    frames_of,
    info_content,
    info_of,
)
from .take import FIELDS, Take, TakeRecorder, check_increase, check_take

SUFFIX = ".facetake"
LONGEST_WAIT = 1.0
"""Seconds of the take or of the clock, whichever are over sooner, after which frames are handed to the disk."""
FRAMES_A_CHUNK = 64
_MOST_FILE = 1 << 30
_MOST_UNPACKED, _UNPACKED_ANYHOW = 192, 32 << 20
"""Bytes in memory for each of the file's, and beside these. A take in which no face was found has 127; a face, four."""


class TakeWriter:
    """Writes a take frame by frame, such that a crash or a pulled plug loses the last second at most.

    To be used from one thread, whichever that is; a context manager.

    Parameters
    ----------
    path : Path
        Must not exist yet: a recording never replaces another one.
    info : dict
        As `Take.info`. It may be changed until the end: it is written with the first second and again by `close`.
    sync : bool
        Whether every second is forced onto the disk itself. Without, a crash of the computer may lose more.

    Raises
    ------
    OutputError
        Where the file exists or cannot be made; from `append`, `flush` and `close` where it cannot be written, because
        the disk is full, say. What was written before stays readable, and what was not is kept and tried again.
    """

    def __init__(self, path: Path, info: dict[str, Any], *, sync: bool = True) -> None:
        self.path, self.info = Path(path), dict(info)
        self._sync = sync
        self._pending: list[tuple[float, TrackResult]] = []
        self._waiting_since = 0.0
        self._written, self._end, self._last = 0, 0, -np.inf
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = FileIO(self.path, "x")
        except OSError as error:
            raise OutputError(
                f"Cannot write {path}: {(error.strerror or str(error)).lower()}. Give the take another name or place."
            ) from error

    def __len__(self) -> int:
        return self._written + len(self._pending)

    def append(self, time: float, result: TrackResult) -> None:
        """Add one frame at `time` seconds; times must increase (ValueError)."""
        check_increase(self._last, time)
        now = clock.monotonic()
        if not self._pending:
            self._waiting_since = now
        self._pending.append((time, result))
        self._last = time
        waited = max(time - self._pending[0][0], now - self._waiting_since)
        if waited >= LONGEST_WAIT or len(self._pending) >= FRAMES_A_CHUNK:
            self.flush()

    def flush(self) -> None:
        """Hand all frames that came so far to the disk."""
        while batch := self._pending[:FRAMES_A_CHUNK]:
            recorder = TakeRecorder({})
            for time, result in batch:
                recorder.append(time, result)
            if self._end == 0:
                self._write(chunk_bytes(START, info_content(self.info, 0)))
            content = frames_content(recorder.finish())
            self._write(chunk_bytes(FRAMES, content, count=len(batch), first=self._written))
            self._written += len(batch)
            del self._pending[: len(batch)]

    def close(self) -> None:
        """Write what is left and end the file; a recording without a frame leaves none. May be called twice."""
        if self._file.closed:
            return
        try:
            self.flush()
            if self._written:
                self._sync = True
                self._write(chunk_bytes(END, info_content(self.info, self._written)))
        finally:
            self._file.close()
            if self._end == 0:
                self.path.unlink(missing_ok=True)

    def __enter__(self) -> TakeWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, data: bytes) -> None:
        try:
            self._file.seek(self._end)
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) :]
            if self._sync:
                os.fsync(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):  # what cannot be taken back either, readers skip
                self._file.truncate(self._end)
            kept = f"The {self._written} frames before are kept" if self._written else "Nothing is recorded yet"
            raise OutputError(
                f"Cannot write {self.path}: {(error.strerror or str(error)).lower()}. {kept}; free some space or "
                "record to another disk."
            ) from error
        self._end += len(data)


def save_take(take: Take, path: Path) -> None:
    """Write `take` as a whole; a failure leaves what was there before.

    Raises
    ------
    OutputError
        Where `path` cannot be written.
    """
    with replacing(Path(path)) as temporary:
        temporary.unlink()
        try:
            with TakeWriter(temporary, take.info, sync=False) as writer:
                for frame, time in enumerate(take.times.tolist()):
                    writer.append(time, take.result(frame))
        except OutputError as error:
            if not isinstance(error.__cause__, OSError):
                raise
            raise error.__cause__ from error  # which `replacing` tells by the name that the user gave


def load_take(path: Path) -> Take:
    """Read a take. Where its file was cut or damaged, all that is intact is there and `info["recovered"]` tells, in a
    sentence, what is lost.

    Raises
    ------
    SourceError
        Where the file is missing, foreign, of a later format, or without any intact frame.
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError(f"There is no take {path}. Make one with: facemime track VIDEO -o {path.name}")
    try:
        return take_of(read_bytes(path, _MOST_FILE))
    except NewerFormatError as error:
        raise SourceError(f"{path} was written by a newer Facemime. Update Facemime to open it.") from error
    except (ValueError, OSError) as error:
        raise SourceError(
            f"{path} is not a take of Facemime, or it is damaged beyond use ({error}). Track the video again."
        ) from error


def take_of(data: bytes) -> Take:
    """The take that the bytes of a file hold, as `load_take`; ValueError where they hold none."""
    reading, most = _Reading(), _MOST_UNPACKED * len(data) + _UNPACKED_ANYHOW
    for chunk in chunks_in(data):
        if isinstance(chunk, Chunk):
            with contextlib.suppress(ValueError):  # a checksum that is right over content that is not: damage as any
                reading.add(chunk)
            if reading.size > most:
                raise ValueError(f"it unpacks to more than {most >> 20} MB, which no recording of its size does")
    return reading.take()


class _Reading:
    """Puts intact chunks together and keeps account of what is missing between them; `size` is the bytes they take."""

    def __init__(self) -> None:
        self._info: dict[str, Any] | None = None
        self._parts: dict[str, list[Any]] = {name: [] for name in FIELDS}
        self._modes = -1
        self._until = -np.inf
        self._frames, self._stated, self.size = 0, -1, 0
        self._lost: list[str] = []

    def add(self, chunk: Chunk) -> None:
        """Take in the next chunk; ValueError where it holds nothing that can be used."""
        if chunk.kind in (START, END):
            self._info, frames = info_of(chunk.content)
            self._stated = frames if chunk.kind == END else self._stated
        elif chunk.kind == FRAMES and chunk.first >= self._frames:
            part = frames_of(chunk.content, chunk.count)
            check_take(part)
            check_increase(self._until, float(part.times[0]))
            modes = part.shape_params.shape[1]
            if self._modes not in (-1, modes):
                raise ValueError(f"frames of {modes} modes follow such of {self._modes}")
            if missing := chunk.first - self._frames:
                since = f"between {self._until:.2f} s and" if self._modes >= 0 else "before"
                self._lost.append(f"{missing} frames {since} {part.times[0]:.2f} s")
            for name, arrays in self._parts.items():
                array = getattr(part, name)
                arrays.append(array if array.base is None else array.copy())
                self.size += array.nbytes
            self._modes, self._until = modes, float(part.times[-1])
            self._frames = chunk.first + chunk.count

    def take(self) -> Take:
        """All that came, and what is lost in its `info`; to be called once."""
        if self._modes < 0:
            raise ValueError("no frame in it can be read")
        if self._stated < 0:
            self._lost.append(f"what came after {self._until:.2f} s, a second at most")
        elif self._stated > self._frames:
            self._lost.append(f"{self._stated - self._frames} frames after {self._until:.2f} s")
        if self._info is None:
            self._lost.append("how it was made")
        # Array by array, so that no more than one of them is there twice.
        take = Take(**{name: np.concatenate(self._parts.pop(name)) for name in FIELDS}, info=dict(self._info or {}))
        if self._lost:
            take.info["recovered"] = f"The file was cut or damaged, and lost are: {'; '.join(self._lost)}."
        return take

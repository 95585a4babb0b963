"""Reading and writing of `.facetake` files, which are written during the recording and readable after any damage."""

from __future__ import annotations

import contextlib
import os
import time as clock
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, Message, OutputError, SourceError
from ..files.capture import check_readable
from ..files.closing import Closing
from ..files.reading import read_bytes
from ..files.writing import reason_of, replacing
from ..tracking.result import TrackResult
from .correction import solve_pins
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
MAX_WAIT = 1.0
"""Time in seconds, of the take or of the clock, after which pending frames are written."""
FRAMES_PER_CHUNK = 64
_MAX_FILE = 1 << 30
_MAX_RATIO = 192
"""Bytes of memory that are allowed per byte of the file. A take needs 4 with a face, 127 without."""
_MIN_UNPACKED = 32 << 20
"""Bytes of memory that are allowed in addition."""


class TakeWriter(Closing):
    """Writes a take frame by frame, so that a crash or power cut loses no more than a second.

    The writer is a context manager, and may be used by one thread at a time.

    Parameters
    ----------
    path : Path
        The file, which must not exist: a recording never replaces another one.
    info : dict
        As `Take.info`. It may be changed until `close`, as it is written with the first second and again at the end.
    sync : bool
        Whether to flush every second to the disk itself. If not, a crash of the computer may lose more.

    Raises
    ------
    OutputError
        If the file exists or cannot be created; from `append`, `flush` and `close`, if it cannot be written, for
        instance because the disk is full. Frames that were written stay readable, and the rest is retried.
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
                "Cannot write {path}: {reason}. Choose another name or folder.",
                path=path,
                reason=reason_of(error),
            ) from error

    def __len__(self) -> int:
        return self._written + len(self._pending)

    def append(self, time: float, result: TrackResult) -> None:
        """Add a frame. Raises ValueError if its time does not increase, and OutputError if it cannot be written."""
        check_increase(self._last, time)
        now = clock.monotonic()
        if not self._pending:
            self._waiting_since = now
        self._pending.append((time, result))
        self._last = time
        waited = max(time - self._pending[0][0], now - self._waiting_since)
        if waited >= MAX_WAIT or len(self._pending) >= FRAMES_PER_CHUNK:
            self.flush()

    def flush(self) -> None:
        """Write all pending frames."""
        while batch := self._pending[:FRAMES_PER_CHUNK]:
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
        """Write pending frames and end the file, or delete it if there was no frame. May be called twice."""
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

    def _write(self, data: bytes) -> None:
        try:
            self._file.seek(self._end)
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) :]
            if self._sync:
                os.fsync(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):  # if this fails too, readers skip the incomplete chunk
                self._file.truncate(self._end)
            kept = Message("Nothing has been recorded yet")
            if self._written:
                kept = Message("The first {count} frames are safe", count=self._written)
            raise OutputError(
                "Cannot write {path}: {reason}. {kept}. Free some space, or record to another disk.",
                path=self.path,
                reason=reason_of(error),
                kept=kept,
            ) from error
        self._end += len(data)


def save_take(take: Take, path: Path) -> None:
    """Write a whole take to a file. On failure an existing file is kept.

    Parameters
    ----------
    take : Take
        The take.
    path : Path
        The file.

    Raises
    ------
    OutputError
        If `path` cannot be written.

    Examples
    --------
    >>> from facemime import load_take, save_take
    >>> take = load_take("performance.facetake")
    >>> save_take(take.part(take.found), "found.facetake")
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
            raise error.__cause__ from error  # `replacing` reports it with the name that the user gave


def load_take(path: Path, *, solved: bool = True) -> Take:
    """Read a take, and solve it around its pins.

    All intact parts of a truncated or damaged file are read, and ``info["recovered"]`` says in a sentence what is
    missing.

    Parameters
    ----------
    path : Path
        The file.
    solved : bool
        Whether pins correct the landmarks. If not, these are as they were tracked, for editing.

    Returns
    -------
    Take
        The take.

    Raises
    ------
    SourceError
        If the file is missing, not a take, of a newer format, or has no intact frame.

    Examples
    --------
    >>> from facemime import load_take
    >>> load_take("performance.facetake").shape.shape
    (60, 66, 3)
    """
    path = Path(path)
    if not check_readable(path):
        raise SourceError(
            "There is no take {path}. Create one: facemime track VIDEO -o {name}", path=path, name=path.name
        )
    try:
        return take_of(read_bytes(path, _MAX_FILE), solved=solved)
    except NewerFormatError as error:
        raise SourceError("{path} was written by a newer Facemime. Update Facemime to open it.", path=path) from error
    except (ValueError, OSError) as error:
        raise SourceError(
            "{path} is not a Facemime take, or is too damaged to be read ({error}). Track the video again.",
            path=path,
            error=error,
        ) from error


def take_of(data: bytes, *, solved: bool = True) -> Take:
    """Read a take from the bytes of a file, as `load_take` does; ValueError if they contain none."""
    reading, most = _Reading(), _MAX_RATIO * len(data) + _MIN_UNPACKED
    for chunk in chunks_in(data):
        if isinstance(chunk, Chunk):
            with contextlib.suppress(ValueError):  # valid checksum, invalid content: treat it as damage
                reading.add(chunk)
            if reading.size > most:
                raise DataError(
                    "it unpacks to more than {most} MB, which no recording of its size does", most=most >> 20
                )
    take = reading.take()
    return solve_pins(take) if solved else take


def pins_content(take: Take) -> bytes:
    """Return what is to be appended to the file of a take, so that it has the pins of `take`."""
    return chunk_bytes(END, info_content(take.info, len(take)))


def append_pins(take: Take, path: Path) -> None:
    """Append the pins of a take to its file, in which nothing is changed; OutputError if that is not possible."""
    try:
        with open(path, "r+b") as file:
            file.seek(0, os.SEEK_END)
            end = file.tell()
            try:
                file.write(pins_content(take))
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                file.truncate(end)
                raise
    except OSError as error:
        raise OutputError(
            "The pins cannot be saved in {path}: {reason}. Free some space, or change the permissions.",
            path=path,
            reason=reason_of(error),
        ) from error


class _Reading:
    """Assembles intact chunks, and notes what is missing between them; `size` is their size in memory in bytes."""

    def __init__(self) -> None:
        self._info: dict[str, Any] | None = None
        self._parts: dict[str, list[Any]] = {name: [] for name in FIELDS}
        self._modes = -1
        self._until = -np.inf
        self._frames, self._stated, self.size = 0, -1, 0
        self._missing: list[str] = []

    def add(self, chunk: Chunk) -> None:
        """Add the next chunk; ValueError if it contains nothing usable."""
        if chunk.kind in (START, END):
            self._info, frames = info_of(chunk.content)
            self._stated = frames if chunk.kind == END else self._stated
        elif chunk.kind == FRAMES and chunk.first >= self._frames:
            part = frames_of(chunk.content, chunk.count, chunk.version)
            check_take(part)
            check_increase(self._until, float(part.times[0]))
            modes = part.shape_params.shape[1]
            if self._modes not in (-1, modes):
                raise DataError(
                    "frames with {modes} modes follow others with {earlier}", modes=modes, earlier=self._modes
                )
            if missing := chunk.first - self._frames:
                since = f"between {self._until:.2f} s and" if self._modes >= 0 else "before"
                self._missing.append(f"{missing} frames {since} {part.times[0]:.2f} s")
            for name, arrays in self._parts.items():
                array = getattr(part, name)
                arrays.append(array if array.base is None else array.copy())
                self.size += array.nbytes
            self._modes, self._until = modes, float(part.times[-1])
            self._frames = chunk.first + chunk.count

    def take(self) -> Take:
        """Return the take, with what is missing in its `info`; to be called once."""
        if self._modes < 0:
            raise DataError("no frame in it can be read")
        if self._stated < 0:
            self._missing.append(f"up to a second after {self._until:.2f} s")
        elif self._stated > self._frames:
            self._missing.append(f"{self._stated - self._frames} frames after {self._until:.2f} s")
        if self._info is None:
            self._missing.append("the description of the recording")
        # Array by array, so that at most one is in memory twice.
        take = Take(**{name: np.concatenate(self._parts.pop(name)) for name in FIELDS}, info=dict(self._info or {}))
        if self._missing:
            take.info["recovered"] = Message(
                "The file was cut or damaged. Missing: {missing}.", missing="; ".join(self._missing)
            )
        return take

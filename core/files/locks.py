"""Locks between processes, and removal of what killed processes have left behind.

A lock is one of the operating system (`flock`, on Windows `msvcrt.locking`) on a small hidden file. It ends with its
process, even if that crashes, so a leftover file blocks nobody. The name of a temporary file contains that of such a
lock: if the lock is free, its owner is gone, and the file can be deleted.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from io import FileIO
from pathlib import Path

PREFIX = ".facemime-"
_SUFFIX = ".lock"
_OURS = re.compile(rf"{re.escape(PREFIX)}([0-9a-f]{{16}}){re.escape(_SUFFIX)}")
_PAUSE = 0.02


def lock_of(path: Path) -> Path:
    """Return the lock of an output: a file beside it, named by the checksum of its name, which is never too long."""
    mark = hashlib.sha256(os.fsencode(os.path.normcase(path.name))).hexdigest()[:16]
    return path.with_name(_lock_name(mark))


def _lock_name(mark: str) -> str:
    return f"{PREFIX}{mark}{_SUFFIX}"


@contextmanager
def holding(path: Path, patience: float | None = None) -> Iterator[bool]:
    """Hold the lock file `path`, which is deleted at the end, or yield False if another process holds it.

    `patience` is how many seconds to wait for that process; None waits indefinitely. Raises OSError if the file cannot
    be created, or the file system has no locks.
    """
    stream = _acquired(path, patience)
    if stream is None:
        yield False
        return
    with _deleting(stream, path):
        yield True


@contextmanager
def _deleting(stream: FileIO, path: Path) -> Iterator[None]:
    """Delete and close a lock file at the end, as far as possible."""
    try:
        with stream:
            try:
                yield
            finally:
                if sys.platform != "win32":  # where an open file cannot be deleted
                    with suppress(OSError):  # another user's, in a folder where only owners may delete
                        path.unlink()
    finally:
        if sys.platform == "win32":
            with suppress(OSError):  # the next process already has it open
                path.unlink()


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """Yield an empty temporary file in the folder of `path`, with its suffix, which is deleted at the end.

    Raises OSError if it cannot be created.
    """
    mark = secrets.token_hex(8)
    with _held_if_possible(path.with_name(_lock_name(mark))):
        temporary = path.with_name(f"{PREFIX}{mark}{path.suffix}")
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        try:
            yield temporary
        finally:
            with suppress(OSError):  # on Windows, a virus scanner may have it open; `sweep` deletes it later
                temporary.unlink(missing_ok=True)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield an empty temporary folder, which is deleted at the end. Those of killed processes are deleted, too.

    Raises OSError if it cannot be created.
    """
    place = Path(tempfile.gettempdir())
    sweep(place)
    mark = secrets.token_hex(8)
    with _held_if_possible(place / _lock_name(mark)):
        folder = place / f"{PREFIX}{mark}.folder"
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Delete locks and temporary files in `folder` whose process is gone, as far as possible."""
    with suppress(OSError):
        names = os.listdir(folder)
        for name in names:
            if ours := _OURS.fullmatch(name):
                with suppress(OSError):  # another user's, or already gone
                    _sweep_one(folder, ours[1], names)


def _sweep_one(folder: Path, mark: str, names: list[str]) -> None:
    lock = folder / _lock_name(mark)
    stream = FileIO(lock, "r+")
    if not _try_lock(stream):
        stream.close()
        return
    with _deleting(stream, lock):
        for name in names:
            if name.startswith(f"{PREFIX}{mark}.") and name != lock.name:
                _remove(folder / name)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _held_if_possible(path: Path) -> Iterator[None]:
    """Hold a lock that no other process knows yet; go on without it if the file system has no locks."""
    try:
        stream = _acquired(path, 0.0)
    except OSError:
        path.unlink(missing_ok=True)
        stream = None
    with nullcontext() if stream is None else _deleting(stream, path):
        yield


def _acquired(path: Path, patience: float | None) -> FileIO | None:
    """Return the locked file, or None if patience ran out. The file is reopened if it was deleted while waiting."""
    end = None if patience is None else time.monotonic() + patience
    while True:
        stream = _opened(path)
        try:
            got = _lock(stream) if end is None else _try_lock(stream)
            if got and _still_there(stream, path):
                return stream
        except BaseException:
            stream.close()
            raise
        stream.close()
        if not got and end is not None:
            if time.monotonic() >= end:
                return None
            time.sleep(_PAUSE)


def _opened(path: Path) -> FileIO:
    try:
        return FileIO(path, "a")
    except PermissionError:
        if not path.exists():
            raise
        return FileIO(path, "r")  # another user's, which can be locked nevertheless


def _still_there(stream: FileIO, path: Path) -> bool:
    if sys.platform == "win32":
        return True
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(stream.fileno()), os.stat(path))
    return False


if sys.platform == "win32":
    import msvcrt

    def _lock(stream: FileIO) -> bool:
        with suppress(OSError):  # which gives up after ten seconds
            msvcrt.locking(stream.fileno(), msvcrt.LK_LOCK, 1)
            return True
        return False

    def _try_lock(stream: FileIO) -> bool:
        with suppress(OSError):
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
            return True
        return False

else:
    import fcntl

    def _lock(stream: FileIO) -> bool:
        fcntl.flock(stream, fcntl.LOCK_EX)
        return True

    def _try_lock(stream: FileIO) -> bool:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

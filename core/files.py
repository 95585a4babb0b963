"""Writing files so that a failure never leaves half a file in place of a good one."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from .errors import OutputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its suffix; moved onto `path` on success, removed on failure.

    Raises
    ------
    OutputError
        Where the folder does not exist and cannot be made, or nothing can be written in it.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(21, "it is a folder")
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise _refused(path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise _refused(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: Path, suffixes: Collection[str] = ()) -> None:
    """Raise OutputError now rather than after minutes of work where `path` cannot be written or has a wrong suffix.

    An existing file is neither touched nor emptied.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise OutputError(f"Cannot write {path}: give it the suffix {' or '.join(sorted(suffixes))}.")
    folder = path.parent
    while not folder.exists():
        folder = folder.parent
    if path.is_dir():
        raise OutputError(f"Cannot write {path}: it is a folder. Give a file name.")
    if not folder.is_dir():
        raise OutputError(f"Cannot write {path}: {folder} is no folder. Choose another place for the output.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(
            f"Cannot write {path}: the folder {folder} is read-only. Choose another place for the output."
        )
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _refused(path, error) from error


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep others that ask for the same `path` waiting, whatever process they are in; the file is gone afterwards.

    The lock goes with the process that has it, however that ends.

    Raises
    ------
    OutputError
        Where the file cannot be made or locked.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = _lock(path)
    except OSError as error:
        raise _refused(path, error) from error
    with stream:
        yield
        if sys.platform != "win32":  # there an open file cannot be taken away
            path.unlink(missing_ok=True)
    if sys.platform == "win32":
        with suppress(OSError):  # the next one has it open already
            path.unlink()


def _lock(path: Path) -> FileIO:
    """The locked file; it is opened again where the one that was waited for has been taken away meanwhile."""
    while True:
        stream = FileIO(path, "a")
        if sys.platform == "win32":
            import msvcrt

            with suppress(OSError):  # it gives up after ten seconds
                msvcrt.locking(stream.fileno(), msvcrt.LK_LOCK, 1)
                return stream
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(stream.fileno()), os.stat(path)):
                    return stream
        stream.close()


def _refused(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(f"Cannot write {path}: {reason.lower()}. Choose another place for the output.")


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current

"""Atomic writing of files: a failure never replaces a good file by half a new one.

If an output is a symbolic link, its target is replaced. Permissions of a replaced file are kept.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path

from ..errors import Message, OutputError
from .locks import holding, lock_of, sweep, temporary_beside

_PATIENCE = 0.25
"""Seconds to wait for the lock of an output, which another process may hold briefly while it cleans up."""
_INVALID_NAME = 123
"""Windows' error for names with characters such as a question mark."""
_SCAN = 2.0
"""Seconds to wait for a program that has a new file open, on Windows."""
_PAUSE = 0.05
"""Seconds between two attempts to move a file."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its suffix, which replaces it on success and is removed on failure.

    Raises OutputError if the folder cannot be created or written to, or an existing file cannot be replaced; the
    message then names the file that contains the result.
    """
    path = Path(path)
    with _reporting(path), ExitStack() as stack:
        target = _target(path)
        _check_name(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        temporary = stack.enter_context(temporary_beside(target))
        yield temporary
        _copy_permissions(temporary, target)
        try:
            _move(temporary, target)
        except OSError as error:
            kept = free_name(target)
            _move(temporary, kept)
            raise OutputError(
                "Cannot replace {path}: {error}. The result is in {kept}.", path=path, error=reason_of(error), kept=kept
            ) from error


def settle(finished: Path, path: Path) -> None:
    """Move a finished file to its final name, replacing an existing one.

    Raises OutputError if the file cannot be moved; `finished` then stays where it is.
    """
    with _reporting(path):
        target = _target(path)
        try:
            _copy_permissions(finished, target)
            _move(finished, target)
            return
        except OSError as error:
            if error.errno != errno.EXDEV:  # a link to another disk
                raise
        with replacing(target) as temporary:
            shutil.copyfile(finished, temporary)
        finished.unlink()


def _move(source: Path, target: Path) -> None:
    """Move a file as `os.replace` does; on Windows, wait for a program that has it open, such as a virus scanner."""
    end = time.monotonic() + (_SCAN if sys.platform == "win32" else 0.0)
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError:
            if time.monotonic() >= end:
                raise
        time.sleep(_PAUSE)


def free_name(path: Path) -> Path:
    """Return `path` if it does not exist, or a numbered name: NAME-2.SUFFIX and so on."""
    names = (path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(1))
    return next(name for name in names if not os.path.lexists(name))


def check_writable(path: Path, suffixes: Collection[str] = ()) -> None:
    """Raise an OutputError if an output cannot be written, before minutes of work. An existing file is not changed.

    The suffix must be one of `suffixes`, or any if these are empty.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise OutputError(
            "Cannot write {path}: give it the suffix {suffixes}.", path=path, suffixes=" or ".join(sorted(suffixes))
        )
    with _reporting(path):
        target = _target(path)
        _check_name(target)
        folder = target.parent
        while not os.path.exists(folder) and folder != folder.parent:
            folder = folder.parent
        if os.path.isdir(target):
            raise OutputError("Cannot write {path}: it is a folder. Choose a file name.", path=path)
        if not os.path.isdir(folder):
            raise OutputError(
                "Cannot write {path}: {folder} is not a folder. Choose another location for the output.",
                path=path,
                folder=folder,
            )
        if not os.access(folder, os.W_OK | os.X_OK):
            raise OutputError(
                "Cannot write {path}: the folder {folder} is read-only. Choose another location for the output.",
                path=path,
                folder=folder,
            )
        _check_replaceable(path, target)
        with tempfile.TemporaryFile(dir=folder):
            pass


def _check_name(target: Path) -> None:
    """Raise an OSError if no file can have this name; no other call notices names that are too long."""
    with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
        os.lstat(target)


def _check_replaceable(path: Path, target: Path) -> None:
    """Raise an OutputError if an existing file cannot be replaced, or only by its owner."""
    if not os.path.lexists(target):
        return
    found = os.stat(target)
    if not stat.S_ISREG(found.st_mode):
        raise OutputError("Cannot write {path}: it is a pipe or a device. Choose a file name.", path=path)
    if not os.access(target, os.W_OK):
        raise OutputError(
            "Cannot write {path}: the file is write-protected. Choose another name for the output.", path=path
        )
    if os.name != "posix":
        return
    folder, user = os.stat(target.parent), os.geteuid()
    if folder.st_mode & stat.S_ISVTX and user not in (0, found.st_uid, folder.st_uid):
        raise OutputError(
            "Cannot write {path}: only its owner, another user, may replace it in this folder. "
            "Choose another name for the output.",
            path=path,
        )


def check_distinct(outputs: Iterable[Path | None], inputs: Mapping[str, Path | None]) -> None:
    """Raise an OutputError if an output is an input, by any name or link; inputs are given by their description."""
    for output in filter(None, outputs):
        for name, path in inputs.items():
            if path is not None and _same(output, path):
                raise OutputError(
                    "Cannot write {output}: it is {name}. Choose another name for the output.", output=output, name=name
                )


def _same(output: Path, path: Path) -> bool:
    try:
        return os.path.samefile(os.path.realpath(output), path)
    except (OSError, ValueError):  # one of them does not exist
        return False


@contextmanager
def claimed(*paths: Path) -> Iterator[None]:
    """Claim outputs for this process, and delete what killed processes have left in their folders.

    A claim ends with its process, even if that crashes. Raises OutputError if another process has claimed one of the
    outputs, or its folder cannot be created.
    """
    with ExitStack() as stack:
        for target, path in sorted({_target(path): path for path in paths}.items()):
            with _reporting(path):
                stack.enter_context(_folder(target.parent))
                sweep(target.parent)
                _claim(stack, target, path)
        yield


def _claim(stack: ExitStack, target: Path, path: Path) -> None:
    try:
        held = stack.enter_context(holding(lock_of(target), _PATIENCE))
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        return  # a file system without locks
    if not held:
        raise OutputError(
            "Another facemime is writing {path}. Wait until it has finished, or choose another name for the output.",
            path=path,
        )


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """Create a folder if it is missing; if it is still empty at the end, remove it."""
    missing = [place for place in (folder, *folder.parents) if not os.path.lexists(place)]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # something is in it
            for place in missing:
                place.rmdir()


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file `path`, for which other processes wait. It is deleted at the end.

    The lock ends with its process, even if that crashes. Raises OutputError if the file cannot be created or locked.
    """
    path = Path(path)
    with ExitStack() as stack:
        with _reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(holding(path))
        yield


def _target(path: Path) -> Path:
    """Return `path` with its links resolved."""
    try:
        if "\0" in str(path):  # which Windows' `realpath` accepts
            raise ValueError("embedded null byte")
        return Path(os.path.realpath(path))
    except ValueError as error:
        raise OutputError(
            "Cannot write {path!r}: {error}. Choose another name for the output.", path=str(path), error=error
        ) from error


def _copy_permissions(new: Path, old: Path) -> None:
    """Give `new` the permissions of `old`, or the user's default if `old` does not exist."""
    try:
        found = os.stat(old)
    except FileNotFoundError:
        os.chmod(new, 0o666 & ~_umask())
        return
    if os.name == "posix" and os.stat(new).st_gid != found.st_gid:
        with suppress(OSError):  # only members of the group may do this
            os.chown(new, -1, found.st_gid)
    os.chmod(new, stat.S_IMODE(found.st_mode) & 0o777)


@contextmanager
def _reporting(path: Path) -> Iterator[None]:
    """Convert errors of the operating system to an OutputError about `path`."""
    try:
        yield
    except OSError as error:
        advice = Message("Choose another location for the output.")
        if error.errno == errno.ENAMETOOLONG:
            advice = Message("Choose a shorter name for the output.")
        elif getattr(error, "winerror", 0) == _INVALID_NAME:
            advice = Message("Choose another name for the output.")
        raise OutputError(
            "Cannot write {path}: {error}. {advice}", path=path, error=reason_of(error), advice=advice
        ) from error


def reason_of(error: OSError) -> str:
    """Return the reason of an error, for use within a sentence."""
    return (error.strerror or str(error)).lower()


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current

"""Writing files so that a failure never leaves half a file in place of a good one.

An output that is a symbolic link stays one: what it leads to is replaced. What is replaced hands its permissions on.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path

from .errors import OutputError
from .locks import holding, lock_of, sweep, temporary_beside

_PATIENCE = 0.25
"""Seconds to wait for an output: as another process looks for waste it may have the lock for a moment."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its suffix; moved onto `path` on success, removed on failure.

    Raises
    ------
    OutputError
        Where the folder does not exist and cannot be made, nothing can be written in it, or what is at `path` cannot be
        replaced: the message then names the file in which the result is kept instead.
    """
    path = Path(path)
    with _refusing(path), ExitStack() as stack:
        target = _target(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        temporary = stack.enter_context(temporary_beside(target))
        yield temporary
        _take_permissions(temporary, target)
        try:
            os.replace(temporary, target)
        except OSError as error:
            kept = free_name(target)
            os.rename(temporary, kept)
            raise OutputError(f"Cannot replace {path}: {reason_of(error)}. The result is in {kept}.") from error


def settle(finished: Path, path: Path) -> None:
    """Give a finished file the name `path`, in place of what is there.

    Raises
    ------
    OutputError
        Where that cannot be; `finished` stays as it is then.
    """
    with _refusing(path):
        target = _target(path)
        try:
            _take_permissions(finished, target)
            os.replace(finished, target)
            return
        except OSError as error:
            if error.errno != errno.EXDEV:  # a link leads to another disk
                raise
        with replacing(target) as temporary:
            shutil.copyfile(finished, temporary)
        finished.unlink()


def free_name(path: Path) -> Path:
    """`path` where nothing is there, else numbered from 2: NAME-2.SUFFIX."""
    names = (path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(1))
    return next(name for name in names if not os.path.lexists(name))


def check_writable(path: Path, suffixes: Collection[str] = ()) -> None:
    """Raise OutputError now rather than after minutes of work where `path` cannot be written or has a wrong suffix.

    An existing file is neither touched nor emptied.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise OutputError(f"Cannot write {path}: give it the suffix {' or '.join(sorted(suffixes))}.")
    with _refusing(path):
        target = _target(path)
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            os.lstat(target)  # the only call that notices a name that is too long
        folder = target.parent
        while not os.path.exists(folder) and folder != folder.parent:
            folder = folder.parent
        if os.path.isdir(target):
            raise OutputError(f"Cannot write {path}: it is a folder. Give a file name.")
        if not os.path.isdir(folder):
            raise OutputError(f"Cannot write {path}: {folder} is no folder. Choose another place for the output.")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise OutputError(
                f"Cannot write {path}: the folder {folder} is read-only. Choose another place for the output."
            )
        _check_replaceable(path, target)
        with tempfile.TemporaryFile(dir=folder):
            pass


def _check_replaceable(path: Path, target: Path) -> None:
    """Raise OutputError where a file is there that only its owner may replace, or nobody."""
    if not os.path.lexists(target):
        return
    found = os.stat(target)
    if not stat.S_ISREG(found.st_mode):
        raise OutputError(f"Cannot write {path}: it is a pipe or a device. Give a file name.")
    if not os.access(target, os.W_OK):
        raise OutputError(f"Cannot write {path}: the file is write-protected. Give the output another name.")
    if os.name != "posix":
        return
    folder, user = os.stat(target.parent), os.geteuid()
    if folder.st_mode & stat.S_ISVTX and user not in (0, found.st_uid, folder.st_uid):
        raise OutputError(
            f"Cannot write {path}: it belongs to another user, who alone may replace it in this folder. "
            "Give the output another name."
        )


def check_distinct(outputs: Iterable[Path | None], inputs: Mapping[str, Path | None]) -> None:
    """Raise OutputError where one of `outputs` is one of `inputs` (what it is: its path), by whatever name or link."""
    for output in filter(None, outputs):
        for name, path in inputs.items():
            if path is not None and _same(output, path):
                raise OutputError(f"Cannot write {output}: it is {name}. Give the output another name.")


def _same(output: Path, path: Path) -> bool:
    try:
        return os.path.samefile(os.path.realpath(output), path)
    except (OSError, ValueError):  # one of them is not there
        return False


@contextmanager
def claimed(*paths: Path) -> Iterator[None]:
    """Keep other processes from claiming the same outputs, and delete what killed ones left in their folders.

    The claim goes with the process that has it, however that ends.

    Raises
    ------
    OutputError
        Where another process has claimed one of them, or their folder cannot be made.
    """
    with ExitStack() as stack:
        for target, path in sorted({_target(path): path for path in paths}.items()):
            with _refusing(path):
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
            f"Another facemime is writing {path}. Wait until it has ended, or give the output another name."
        )


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """The folder, made where it is missing; what was made for nothing is gone afterwards."""
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
    """Keep others that ask for the same `path` waiting, whatever process they are in; the file is gone afterwards.

    The lock goes with the process that has it, however that ends.

    Raises
    ------
    OutputError
        Where the file cannot be made or locked.
    """
    path = Path(path)
    with ExitStack() as stack:
        with _refusing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(holding(path))
        yield


def _target(path: Path) -> Path:
    """What `path` leads to."""
    try:
        return Path(os.path.realpath(path))
    except ValueError as error:
        raise OutputError(f"Cannot write {str(path)!r}: {error}. Give the output another name.") from error


def _take_permissions(new: Path, old: Path) -> None:
    """Let `new` be read and written by those who may read and write `old`; by the user's default where none is."""
    try:
        found = os.stat(old)
    except FileNotFoundError:
        os.chmod(new, 0o666 & ~_umask())
        return
    if os.name == "posix" and os.stat(new).st_gid != found.st_gid:
        with suppress(OSError):  # to another group only by its members
            os.chown(new, -1, found.st_gid)
    os.chmod(new, stat.S_IMODE(found.st_mode) & 0o777)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn what the system refuses into an OutputError about `path`."""
    try:
        yield
    except OSError as error:
        advice = "Choose another place for the output."
        if error.errno == errno.ENAMETOOLONG:
            advice = "Give the output a shorter name."
        raise OutputError(f"Cannot write {path}: {reason_of(error)}. {advice}") from error


def reason_of(error: OSError) -> str:
    """What the system says, for use within a sentence."""
    return (error.strerror or str(error)).lower()


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current

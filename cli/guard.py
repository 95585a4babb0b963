"""Files of strangers are read in a child process, which may die, with limits of memory and time.

Blender's importers crash on some damaged files. The command runs again as a child, and says so if that dies.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from ..core.errors import SourceError
from .stopping import LEASH, STOPPING

_MARK = "FACEMIME_GUARD"
"""Environment variable with the path of a file that a child removes when it ends in an orderly way."""
_MEMORY = 1 << 30
"""Bytes that reading any file may take."""
_MEMORY_PER_BYTE = 24
"""Bytes that reading may take in addition per byte of the file. Meshes of text take 10, compressed ones 20."""
_SECONDS = 60.0
"""Seconds of processor time that reading any file may take."""
_SECONDS_PER_BYTE = 2e-6
"""Seconds of processor time that reading may take in addition per byte of the file."""
_PATIENCE = 15.0
"""Seconds from a signal to the end of the child."""
_mark = os.environ.pop(_MARK, "")
"""The file that this process removes, if it is such a child; it is not passed on to the processes that it starts."""


def own_command() -> list[str]:
    """The command that starts this `facemime`: through Blender if it runs inside Blender, otherwise through Python."""
    blender = sys.modules.get("bpy")  # always loaded inside Blender; not to be imported for this elsewhere
    if blender is not None and blender.app.binary_path:
        return [blender.app.binary_path, "--command", "facemime"]
    return [sys.executable, "-m", __package__]


def is_child() -> bool:
    """Whether this process is a child that may die."""
    return bool(_mark)


def run_in_child(line: Sequence[str], path: Path) -> int:
    """Run a command line that reads a stranger's file in a child process, and return its exit status.

    Raises SourceError if the child died.
    """
    with tempfile.TemporaryDirectory(prefix="facemime-") as folder:
        mark = Path(folder) / "running"
        mark.touch()
        status = _status_of([*own_command(), *line], mark)
        died = mark.exists()
    if died and not STOPPING.heard:
        raise SourceError(
            "{path} cannot be read: {status}. It may be damaged; export it again.", path=path, status=_reason(status)
        )
    return status if not died else STOPPING.status


def end_child() -> None:
    """Note that this process ends in an orderly way, if it is a child."""
    if _mark:
        with contextlib.suppress(OSError):
            os.unlink(_mark)


@contextlib.contextmanager
def limited(path: Path) -> Iterator[None]:
    """Limit the memory and the processor time for reading a file, in a child and where the system can."""
    if not is_child() or sys.platform != "linux":
        yield
        return
    import resource

    size = path.stat().st_size
    used = resource.getrusage(resource.RUSAGE_SELF)
    wanted = {resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + _SECONDS + _SECONDS_PER_BYTE * size) + 1}
    if (data := _data_size()) is not None:
        wanted[resource.RLIMIT_DATA] = data + _MEMORY + _MEMORY_PER_BYTE * size
    before = {kind: resource.getrlimit(kind) for kind in wanted}
    for kind, limit in wanted.items():
        soft, hard = before[kind]
        resource.setrlimit(kind, (limit if soft == resource.RLIM_INFINITY else min(limit, soft), hard))
    try:
        yield
    finally:
        for kind, limits in before.items():
            resource.setrlimit(kind, limits)


def _data_size() -> int | None:
    """Size in bytes of what RLIMIT_DATA counts; None if the system does not tell, as in a bare chroot."""
    with contextlib.suppress(OSError):
        for row in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            name, _, value = row.partition(":")
            if name == "VmData":
                return 1024 * int(value.split()[0])
    return None


class Leashed(subprocess.Popen[str]):
    """A process that ends, in an orderly way, when the other end of its standard input is closed."""

    leash: IO[bytes]

    def terminate(self) -> None:
        """Let the process end; Windows has no signal for that, and would kill it."""
        if sys.platform == "win32":
            self.leash.close()
        else:
            super().terminate()


@contextlib.contextmanager
def leashed(command: Sequence[str], **options: Any) -> Iterator[Leashed]:
    """Run a command in a process that ends when this one does, even by a crash, as its standard input then ends.

    The options are those of `Popen`.
    """
    end, held = os.pipe()  # not inherited by other processes, so that nothing else keeps it open
    with open(end, "rb") as source, open(held, "wb") as leash:
        environment = {**os.environ, LEASH: "1", **options.pop("env", {})}
        with Leashed(command, stdin=source, text=True, env=environment, **options) as process:
            process.leash = leash
            yield process


def _status_of(command: Sequence[str], mark: Path) -> int:
    """Run a command that ends with this process, passing signals on; returns its exit status."""
    with leashed(command, env={_MARK: str(mark)}) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            with contextlib.suppress(OSError, ValueError):  # Windows itself sends Ctrl-C to the child
                process.send_signal(signal.SIGTERM if STOPPING.status == 128 + signal.SIGTERM else signal.SIGINT)
            try:
                with STOPPING.noting():
                    return process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                return STOPPING.status


def _reason(status: int) -> str:
    if status == -getattr(signal, "SIGXCPU", 0):
        return "it took too long"
    return "Blender crashed or ran out of memory"

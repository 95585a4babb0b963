"""Runners of command lines, each in a process of its own, on this machine or on others through Dask."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from ..core.errors import FacemimeError
from .guard import leashed, own_command

_LINES = 12
_PATIENCE = 10.0
"""Seconds for a process to terminate before it is killed."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of command line number `index`: its exit status, and the last lines of its messages."""

    index: int
    status: int
    said: str


class Runner(Protocol):
    """Runs command lines of `facemime` and reports each as it ends; `close` stops those that still run."""

    def run(self, lines: Sequence[Sequence[str]]) -> Iterator[Outcome]:
        """Run all `lines`, which are arguments of `facemime`, in any order."""
        ...

    def close(self) -> None:
        """Stop running lines and drop waiting ones; may be called twice."""
        ...


class LocalRunner:
    """Runs `jobs` processes at a time on this machine."""

    def __init__(self, jobs: int) -> None:
        self._pool = ThreadPoolExecutor(jobs)
        self._running: set[subprocess.Popen[str]] = set()
        self._closed = False

    def run(self, lines: Sequence[Sequence[str]]) -> Iterator[Outcome]:
        """As `Runner.run`."""
        waiting = [self._pool.submit(self._one, index, line) for index, line in enumerate(lines)]
        for done in as_completed(waiting):
            yield done.result()

    def close(self) -> None:
        """As `Runner.close`; clips that were killed do not count as done."""
        self._closed = True
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in list(self._running):
            process.terminate()
        end = time.monotonic() + _PATIENCE
        while self._running and time.monotonic() < end:
            time.sleep(0.02)
        for process in list(self._running):
            process.kill()
        self._pool.shutdown(wait=True)

    def _one(self, index: int, line: Sequence[str]) -> Outcome:
        if self._closed:
            return Outcome(index, 130, "stopped")
        with _started(line) as process:
            self._running.add(process)
            if self._closed:  # closed meanwhile
                process.terminate()
            try:
                _, said = process.communicate()
            finally:
                self._running.discard(process)
        return Outcome(index, process.returncode, _last(said))


class DaskRunner:
    """Runs lines on the workers of a Dask scheduler, one per thread; those of a lost worker go to another one.

    Facemime has to be installed on the workers, with clips, head and output folder at the same paths.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise FacemimeError(
                "--dask needs Dask's distributed scheduler, which is not installed. Run: pip install distributed"
            ) from error
        try:
            self._client = Client(address, timeout="10s")  # type: ignore[no-untyped-call]  # Dask has no types
        except (OSError, ValueError) as error:
            raise FacemimeError(
                "There is no Dask scheduler at {address}. Start one by running dask scheduler, and use its address.",
                address=address,
            ) from error
        self._waiting: list[object] = []

    def run(self, lines: Sequence[Sequence[str]]) -> Iterator[Outcome]:
        """As `Runner.run`."""
        from distributed import as_completed as each

        futures = {self._client.submit(run_line, list(line), pure=False): i for i, line in enumerate(lines)}
        self._waiting = list(futures)
        for future in each(futures):  # type: ignore[no-untyped-call]  # Dask has no types
            error = future.exception()
            status, said = (1, f"lost with its worker: {error}") if error is not None else future.result()
            yield Outcome(futures[future], status, said)

    def close(self) -> None:
        """As `Runner.close`."""
        self._client.cancel(self._waiting)  # type: ignore[no-untyped-call]  # Dask has no types
        self._client.close()  # type: ignore[no-untyped-call]  # Dask has no types


def run_line(line: list[str]) -> tuple[int, str]:
    """Run a command line of `facemime`; returns its exit status and the last lines of its messages."""
    with _started(line) as process:
        _, said = process.communicate()
    return process.returncode, _last(said)


def _started(line: Sequence[str]) -> AbstractContextManager[subprocess.Popen[str]]:
    output = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "errors": "replace"}
    return leashed([*own_command(), *line], **output)


def _last(said: str) -> str:
    return "\n".join(said.strip().splitlines()[-_LINES:])

"""Runners of clips, some of them in a process one after the other, on this machine or on others through Dask.

A process prints an outcome for each clip. If it dies, the clip that it had begun has failed, and others go on.
"""

from __future__ import annotations

import json
import queue
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from typing import Protocol

from ..core.errors import FacemimeError
from .guard import leashed, own_command

_LINES = 12
_PATIENCE = 10.0
"""Seconds for a process to terminate before it is killed."""
_TOGETHER = 16
"""Largest number of clips in a process: starting Blender takes as long as tracking some seconds of video."""
_STOPPED = 130


@dataclass(frozen=True)
class Outcome:
    """Outcome of clip number `index`: its exit status, and the last lines of its messages."""

    index: int
    status: int
    said: str


class Runner(Protocol):
    """Runs `facemime clip` for many clips and reports each as it ends; `close` stops those that still run."""

    def run(self, clips: Sequence[str], options: Sequence[str]) -> Iterator[Outcome]:
        """Process clips, which are paths, with the same options, in any order."""
        ...

    def close(self) -> None:
        """Stop running clips and drop waiting ones; may be called twice."""
        ...


class LocalRunner:
    """Runs `jobs` processes at a time on this machine."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._running: set[subprocess.Popen[str]] = set()
        self._closed = False
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []

    def run(self, clips: Sequence[str], options: Sequence[str]) -> Iterator[Outcome]:
        """As `Runner.run`."""
        waiting, ended = deque(range(len(clips))), queue.SimpleQueue[Outcome]()

        def work() -> None:
            while indices := self._taken(waiting):
                left = self._several(clips, options, indices, ended)
                with self._lock:
                    waiting.extendleft(reversed(left))

        self._threads = [threading.Thread(target=work, daemon=True) for _ in range(min(self._jobs, len(clips)))]
        for thread in self._threads:
            thread.start()
        for _ in clips:
            yield ended.get()

    def close(self) -> None:
        """As `Runner.close`; clips that were killed do not count as done."""
        self._closed = True
        for process in list(self._running):
            process.terminate()
        end = time.monotonic() + _PATIENCE
        while self._running and time.monotonic() < end:
            time.sleep(0.02)
        for process in list(self._running):
            process.kill()
        for thread in self._threads:
            thread.join()

    def _taken(self, waiting: deque[int]) -> list[int]:
        """Take the clips of one process, fewer towards the end, so that all processes end at about the same time."""
        with self._lock:
            return [waiting.popleft() for _ in range(_share(len(waiting), self._jobs))]

    def _several(
        self, clips: Sequence[str], options: Sequence[str], indices: list[int], ended: queue.SimpleQueue[Outcome]
    ) -> list[int]:
        """Process clips in one process, and return those that it did not begin."""
        if self._closed:
            for index in indices:
                ended.put(Outcome(index, _STOPPED, "stopped"))
            return []
        with ExitStack() as stack:
            try:
                process = stack.enter_context(_started(["clip", *(clips[index] for index in indices), *options]))
            except OSError as error:  # such as too little memory for another process, which passes
                ended.put(Outcome(indices[0], 1, f"no process could be started: {error}"))
                return indices[1:]
            self._running.add(process)
            if self._closed:  # closed meanwhile
                process.terminate()
            try:
                return _followed(process, indices, ended.put)
            finally:
                self._running.discard(process)


class DaskRunner:
    """Runs clips on the workers of a Dask scheduler, a process per thread; those of a lost worker go to another one.

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

    def run(self, clips: Sequence[str], options: Sequence[str]) -> Iterator[Outcome]:
        """As `Runner.run`."""
        from distributed import as_completed as each

        workers = max(sum(self._client.nthreads().values()), 1)  # type: ignore[no-untyped-call]  # Dask has no types
        futures: dict[object, list[int]] = {}
        left = deque(range(len(clips)))
        while left:
            indices = [left.popleft() for _ in range(_share(len(left), workers))]
            futures[self._submit(clips, options, indices)] = indices
        self._waiting = list(futures)
        ended = each(futures)  # type: ignore[no-untyped-call]  # Dask has no types
        for future in ended:
            indices = futures.pop(future)
            if (error := future.exception()) is not None:
                yield from (Outcome(index, 1, f"lost with its worker: {error}") for index in indices)
                continue
            outcomes = future.result()
            yield from (Outcome(index, *outcome) for index, outcome in zip(indices, outcomes, strict=False))
            if again := indices[len(outcomes) :]:
                more = self._submit(clips, options, again)
                futures[more] = again
                self._waiting.append(more)
                ended.add(more)  # type: ignore[no-untyped-call]  # Dask has no types

    def _submit(self, clips: Sequence[str], options: Sequence[str], indices: Sequence[int]) -> object:
        return self._client.submit(run_clips, [clips[index] for index in indices], list(options), pure=False)

    def close(self) -> None:
        """As `Runner.close`."""
        self._client.cancel(self._waiting)  # type: ignore[no-untyped-call]  # Dask has no types
        self._client.close()  # type: ignore[no-untyped-call]  # Dask has no types


def run_clips(clips: Sequence[str], options: Sequence[str]) -> list[tuple[int, str]]:
    """Process clips in one process; returns the exit status and the last lines of the messages of those it began."""
    ended: list[Outcome] = []
    with _started(["clip", *clips, *options]) as process:
        _followed(process, list(range(len(clips))), ended.append)
    return [(outcome.status, outcome.said) for outcome in ended]


def _share(waiting: int, processes: int) -> int:
    """Number of clips for the next process."""
    return min(_TOGETHER, -(-waiting // (2 * processes)))


def _followed(process: subprocess.Popen[str], indices: list[int], ended: Callable[[Outcome], None]) -> list[int]:
    """Report the outcomes of a process as it prints them; returns the clips that it did not begin."""
    assert process.stdout is not None and process.stderr is not None
    said: deque[str] = deque(maxlen=_LINES)
    listening = threading.Thread(target=said.extend, args=(process.stderr,), daemon=True)
    listening.start()
    left = deque(indices)
    for line in process.stdout:
        if left and (outcome := _outcome(line)) is not None:
            ended(Outcome(left.popleft(), *outcome))
    listening.join()
    status = process.wait()
    if left and (status or len(left) == len(indices)):
        ended(Outcome(left.popleft(), status or 1, "".join(said).strip()))
    return list(left)


def _outcome(line: str) -> tuple[int, str] | None:
    """Status and message in a line that `facemime clip` has printed for a clip; None if it is another line."""
    try:
        data = json.loads(line)
        return int(data["status"]), str(data["said"])
    except (ValueError, TypeError, KeyError):
        return None


def _started(line: Sequence[str]) -> AbstractContextManager[subprocess.Popen[str]]:
    return leashed(
        [*own_command(), *line], stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", errors="replace"
    )

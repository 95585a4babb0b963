"""A second thread, for work in numpy and OpenCV, which release Python's lock while they calculate."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

_T = TypeVar("_T")


class SecondThread:
    """Does one piece of work after the other, beside the caller; it starts with the first."""

    def __init__(self) -> None:
        self._process = 0
        self._pool: ThreadPoolExecutor | None = None

    def begin(self, work: Callable[[], _T]) -> Future[_T]:
        """Begin `work`, whose result, or error, the future returns or raises."""
        # A process that was forked has no other threads than the one that forked it.
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(1, "facemime-second"), os.getpid()
        return self._pool.submit(work)

"""Clocks whose seconds pass on request, so that no test depends on how fast the machine is at that moment."""

from __future__ import annotations

import threading
from collections.abc import Callable

from facemime.core.live.sources import Clock

PATIENCE = 300.0
"""Seconds after which a test gives up on something that a busy machine would have done long before."""


class EagerClock(Clock):
    """Never waits: time passes by as much as somebody would have waited."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        """The time so far."""
        return self.time

    def wait_until(self, due: float, timeout: float, closed: threading.Event) -> bool:
        """Pass on to `due`, or by `timeout`."""
        ahead = due - self.time
        self.time += min(max(ahead, 0.0), timeout)
        return ahead <= timeout


class AskedClock(EagerClock):
    """Stands still until a test asks for the next frame; then it is due at once, and none is late or left out."""

    def __init__(self) -> None:
        super().__init__()
        self._news = threading.Condition()
        self._asked = self._waiting = False

    def wait_until(self, due: float, timeout: float, closed: threading.Event) -> bool:
        """Wait for `ask`."""
        with self._news:
            self._waiting = True
            self._news.notify_all()
            self._news.wait_for(lambda: self._asked or closed.is_set(), min(timeout, 0.05))
            if not self._asked:
                return False
            self._asked = self._waiting = False
            self.time = max(self.time, due)
            return True

    def ask(self, running: Callable[[], bool]) -> None:
        """Let one frame come, and wait until whoever reads has done with it and waits for the next, or has ended."""
        with self._news:
            self._asked = True
            self._news.notify_all()
            waited = 0.0
            while running() and (self._asked or not self._waiting):
                assert waited < PATIENCE, "nobody reads the source"
                self._news.wait(0.02)
                waited += 0.02
            self._asked = False

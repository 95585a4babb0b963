"""Clocks that advance on request, so that tests do not depend on the speed of the machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from facemime.core.puppet.sources import Clock

PATIENCE = 300.0
"""Seconds after which a test gives up; even a busy machine needs much less."""


def wait_for(condition: Callable[[], object], meanwhile: Callable[[], object] = lambda: time.sleep(0.002)) -> None:
    """Call `meanwhile` until `condition` holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        meanwhile()


class EagerClock(Clock):
    """Never waits: time advances by the duration of the wait."""

    def __init__(self) -> None:
        self.time = 100.0

    def now(self) -> float:
        """The current time."""
        return self.time

    def wait_until(self, due: float, timeout: float, closed: threading.Event) -> bool:
        """Advance to `due`, or by `timeout`."""
        ahead = due - self.time
        self.time += min(max(ahead, 0.0), timeout)
        return ahead <= timeout


class AskedClock(EagerClock):
    """Stands still until a test requests the next frame, which is then due at once; no frame is late or dropped."""

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
        """Release a frame, and wait until its reader waits for the next one, or has ended."""
        with self._news:
            self._asked = True
            self._news.notify_all()
            waited = 0.0
            while running() and (self._asked or not self._waiting):
                assert waited < PATIENCE, "nobody reads the source"
                self._news.wait(0.02)
                waited += 0.02
            self._asked = False

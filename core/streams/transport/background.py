"""Background threads of senders and servers, which a session starts, feeds with frames, and ends."""

from __future__ import annotations

import asyncio
import threading
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress

from ...files.closing import Closing

_ENDING = 5.0
"""Seconds that `close` waits for a thread."""


class Connecting(Closing):
    """A thread that connects to another program, again and again, and sends new data, until `close`.

    `_news` guards the data that the thread shares with others, and is notified of every change. There are `pause`
    seconds between two attempts.

    Attributes
    ----------
    sent : int
        Number of frames sent, of all heads together.
    message : str
        Reason why nothing is sent; otherwise "".
    """

    def __init__(self, name: str, pause: float) -> None:
        self.sent, self.message = 0, ""
        self._pause, self._over = pause, False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    def close(self) -> None:
        """End the thread. May be called twice."""
        with self._news:
            self._over = True
            self._news.notify()
        self._thread.join(_ENDING)

    @abstractmethod
    def _connect(self) -> None:
        """Connect, and send until the connection is lost or `_over` is set; errors become a message."""

    def _work(self) -> None:
        while not self._over:
            self._connect()
            with self._news:
                self._news.wait_for(lambda: self._over, self._pause)


class Serving(Closing):
    """An event loop in a thread of its own, called `name`, until `close`."""

    def __init__(self, name: str) -> None:
        self._loop, self._over = asyncio.new_event_loop(), asyncio.Event()
        self._frame = b""
        self._wakes: set[asyncio.Event] = set()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)

    def close(self) -> None:
        """End the server. May be called twice."""
        self._call(self._over.set)
        self._thread.join(_ENDING)

    @abstractmethod
    async def _run(self) -> None:
        """Serve until `_over` is set; runs in the thread."""

    def _publish(self, frame: bytes) -> None:
        """Replace the newest frame, and wake what sends it; runs in the thread."""
        self._frame = frame
        for wake in self._wakes:
            wake.set()

    def _call(self, task: Callable[[], object]) -> None:
        """Call a function in the thread, unless the thread has ended."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(task)

    def _work(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._run())
        finally:
            self._loop.close()

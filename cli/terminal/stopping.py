"""Ctrl-C and SIGTERM: a KeyboardInterrupt each, or the end at once where nothing is begun yet.

Imports nothing that takes time, so that it is ready before anything else is.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 130
_TOGETHER = 1.0
"""Seconds within which a second signal is the first one's twin: a terminal's and a parent's, say."""
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Stopping:
    """What signals do to this process.

    Attributes
    ----------
    status : int
        The exit status of a run that a signal ended: 128 and the signal's number, 130 before any came.
    heard : bool
        Whether one came.
    """

    def __init__(self) -> None:
        self.status = INTERRUPTED
        self._handlers: dict[int, Any] = {}
        self.heard = self._at_once = self._over = False
        self._holds, self._last = 0, -_TOGETHER

    def install(self) -> None:
        """Listen to signals, but to those that this process was started to ignore; until `run` they end it at once."""
        self._at_once = True
        for number in _SIGNALS:
            ignored = signal.getsignal(number) is signal.SIG_IGN
            self._handlers[number] = signal.SIG_IGN if ignored else self._handle
        self._restore()

    def run(self) -> None:
        """Let signals be KeyboardInterrupts from now on."""
        self._at_once = False

    def leave(self) -> None:
        """Hear no signal any more: the end is near."""
        self._over = True

    @contextlib.contextmanager
    def starting(self) -> Iterator[None]:
        """Let no thread hear signals that a library starts while it is imported: `importing` could not stop those."""
        over = threading.Event()
        listener = threading.Thread(target=over.wait, name="facemime-signals", daemon=True)
        listener.start()  # hears them in place of the main thread, which acts on them all the same
        try:
            with _blocked():
                yield
        finally:
            over.set()
            listener.join()

    @contextlib.contextmanager
    def importing(self) -> Iterator[None]:
        """Let signals end the process at once, without a traceback, when this is over.

        Blender takes Ctrl-C for itself as soon as it is imported.
        """
        if not self._handlers:
            yield
            return
        self._at_once, before = True, self._at_once
        with _blocked():
            try:
                yield
            finally:
                self._restore()
        self._at_once = before

    @contextlib.contextmanager
    def noting(self) -> Iterator[None]:
        """Raise nothing when a signal comes, but set `heard`.

        Where Blender calls Python, it prints what is raised and goes on. OpenCV 4.11 crashes: it asks for the text of
        an argument's error to choose between the variants of a function, and takes none for impossible.
        """
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1

    @contextlib.contextmanager
    def holding(self) -> Iterator[None]:
        """Let a signal wait until this is over."""
        with self.noting():
            yield
        self.check()

    def check(self) -> None:
        """Raise KeyboardInterrupt where a signal came that waits, or that somebody swallowed."""
        if self.heard:
            raise KeyboardInterrupt

    def _restore(self) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self._over:
            return
        if self._at_once:
            end_at_once(128 + number)
        now = time.monotonic()
        if now - self._last < _TOGETHER:
            return
        self._last, self.heard, self.status = now, True, 128 + number
        if not self._holds:
            raise KeyboardInterrupt


STOPPING = Stopping()


@contextlib.contextmanager
def _blocked() -> Iterator[None]:
    """Let signals wait, where the system can, until this is over."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def end_at_once(status: int) -> NoReturn:
    """End the process before it has written anything, and say so."""
    with contextlib.suppress(OSError):
        os.write(2, b"facemime: interrupted; nothing was written.\n")
    os._exit(status)


def open_standard_streams() -> None:
    """Give the null device to each standard stream that was closed by whoever called.

    A file that is opened later would else be one of them, and Blender would print into it.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - for as long as the process lives

"""Handling of Ctrl-C and SIGTERM: a KeyboardInterrupt, or an immediate end if nothing has begun. A process may also end
together with the one that started it.

Imports nothing that takes time, so that it is ready first.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time

TYPE_CHECKING = False  # as typing has it, whose import takes longer than all the rest of this module
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType
    from typing import Any, NoReturn

LEASH = "FACEMIME_ENDS_WITH_STDIN"
"""Environment variable of processes that end with their standard input."""
_PATIENCE = 3.0
"""Seconds from SIGTERM to the end of the process."""
INTERRUPTED = 130
_TOGETHER = 1.0
"""Seconds within which a second signal is a duplicate, for instance from the terminal and from a parent process."""
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Stopping:
    """The effect of signals on this process.

    Attributes
    ----------
    status : int
        Exit status after a signal: 128 plus its number; 130 before any signal.
    heard : bool
        Whether a signal has arrived.
    """

    def __init__(self) -> None:
        self.status = INTERRUPTED
        self._handlers: dict[int, Any] = {}
        self.heard = self._at_once = self._over = False
        self._holds, self._last = 0, -_TOGETHER

    def install(self) -> None:
        """Handle signals, except those that this process ignores from its start; until `run` they end it at once."""
        self._at_once = True
        for number in _SIGNALS:
            ignored = signal.getsignal(number) is signal.SIG_IGN
            self._handlers[number] = signal.SIG_IGN if ignored else self._handle
        self._restore()

    def run(self) -> None:
        """Raise KeyboardInterrupt on signals from now on."""
        self._at_once = False

    def leave(self) -> None:
        """Ignore further signals, as the process is ending."""
        self._over = True

    @contextlib.contextmanager
    def starting(self) -> Iterator[None]:
        """Keep threads that libraries start during import from receiving signals; `importing` cannot prevent that."""
        import threading

        over = threading.Event()
        listener = threading.Thread(target=over.wait, name="facemime-signals", daemon=True)
        listener.start()  # receives signals for the main thread, which still handles them
        try:
            with _blocked():
                yield
        finally:
            over.set()
            listener.join()

    @contextlib.contextmanager
    def importing(self) -> Iterator[None]:
        """Let signals end the process at once, without a traceback, after this block.

        Blender installs its own handler of Ctrl-C when it is imported.
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
        """On a signal, set `heard` but do not raise.

        Blender prints exceptions of Python code that it calls, and continues. OpenCV 4.11 crashes on exceptions without
        a message, as it examines the messages of argument errors to choose between overloads.
        """
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1

    @contextlib.contextmanager
    def holding(self) -> Iterator[None]:
        """Defer signals to the end of this block."""
        with self.noting():
            yield
        self.check()

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal was deferred or swallowed."""
        if self.heard:
            raise KeyboardInterrupt

    def _restore(self) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self._over:
            return
        if self._at_once:
            _end_at_once(128 + number)
        now = time.monotonic()
        if now - self._last < _TOGETHER:
            return
        self._last, self.heard, self.status = now, True, 128 + number
        if not self._holds:
            raise KeyboardInterrupt


STOPPING = Stopping()


@contextlib.contextmanager
def _blocked() -> Iterator[None]:
    """Block signals until the end, if the system can."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def end_process(status: int) -> NoReturn:
    """End the process without any clean-up.

    On Windows, `os._exit` still unloads libraries, and Blender's reports unfreed memory on the standard output.
    """
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.TerminateProcess(ctypes.c_void_p(-1), status)
    os._exit(status)


def _end_at_once(status: int) -> NoReturn:
    """End the process, which has not written anything yet, with a message."""
    with contextlib.suppress(OSError):
        os.write(2, b"facemime: interrupted; nothing was written.\n")
    end_process(status)


def open_standard_streams() -> None:
    """Open the null device for each standard stream that the caller closed, and let the others escape what their code
    page does not have.

    Otherwise a file that is opened later would become one of them, and Blender would print into it; a name in another
    script would be an error.
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
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - open until the process ends
        if name != "stdin" and hasattr(stream := getattr(sys, name), "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def follow_stdin() -> None:
    """If the environment requests it, end with the standard input: by SIGTERM and, if that fails, at once."""
    if os.environ.pop(LEASH, ""):
        import threading

        from ..core.puppet.camera_process import wait_for_end_of_input

        arguments = (wait_for_end_of_input,)
        threading.Thread(target=_end_after, args=arguments, name="facemime-leash", daemon=True).start()


def _end_after(wait: Callable[[], None]) -> None:
    wait()
    if sys.platform == "win32":  # where `kill` ends a process at once
        signal.raise_signal(signal.SIGTERM)
    else:
        os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_PATIENCE)
    end_process(128 + signal.SIGTERM)

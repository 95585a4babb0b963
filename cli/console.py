"""All output of the command line: results, messages with remedies that fit a terminal, and progress."""

from __future__ import annotations

import os
import sys
import time
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from ..core.errors import OutputError

_ESCAPES = 0x0004
"""ENABLE_VIRTUAL_TERMINAL_PROCESSING, of Windows 10 and later."""
_MARKS = "--mark 36=VERTEX or --mark 36=X,Y,Z, in Blender's coordinates"


_UNSEEN = frozenset({"Cc", "Cs", "Zl", "Zp"})
_TURNING = frozenset("\u200e\u200f\u061c\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def say(text: str) -> None:
    """Write a result to the standard output; a reader that stops early, such as `head`, is not an error.

    Raises OutputError if it cannot be written.
    """
    if sys.stdout is None:  # closed by the caller
        return
    try:
        print("\n".join(printable(line) for line in text.split("\n")), flush=True)
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - receives the rest of the buffer when Python ends
    except OSError as error:
        raise OutputError(
            "Cannot write to the standard output: {reason}.", reason=(error.strerror or str(error)).lower()
        ) from error


def tell(text: str) -> None:
    """Write a message to the standard error; a closed stream or a full disk is not an error."""
    write_error(printable(text) + "\n")


def write_error(text: str) -> None:
    """Write `text` unchanged to the standard error, as `tell` does."""
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - receives the rest of the buffer when Python ends


def printable(text: str) -> str:
    """`text` with control characters escaped, by which the name of a file could control the terminal."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(_escaped(c) if unicodedata.category(c) in _UNSEEN or c in _TURNING else c for c in text)


def _escaped(character: str) -> str:
    if "\udc80" <= character <= "\udcff":  # an undecodable byte
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode()


def understands_escapes(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that understands escape codes, which Windows' has to be told."""
    if not stream.isatty() or os.environ.get("TERM") == "dumb":
        return False
    if sys.platform != "win32":
        return True
    import ctypes
    import msvcrt

    try:
        handle = ctypes.c_void_p(msvcrt.get_osfhandle(stream.fileno()))
    except (OSError, ValueError):
        return False
    mode, kernel = ctypes.c_ulong(), ctypes.windll.kernel32
    return bool(
        kernel.GetConsoleMode(handle, ctypes.byref(mode)) and kernel.SetConsoleMode(handle, mode.value | _ESCAPES)
    )


class Screen:
    """A text that is replaced in place on a terminal with escape codes, and otherwise written once per second."""

    def __init__(self) -> None:
        self._live = sys.stdout is not None and understands_escapes(sys.stdout)
        self._shown = float("-inf")

    def show(self, text: str) -> None:
        """Replace the text; drawn at most five times per second."""
        now = time.perf_counter()
        if now - self._shown < (0.2 if self._live else 1.0):
            return
        self._shown = now
        if self._live:
            print("\x1b[H\x1b[J", end="")
        say(text)


class Progress:
    """A progress line, rewritten in place on a terminal, and otherwise printed once at the end.

    It counts steps of a unit up to the expected total, 0 if that is unknown.
    """

    def __init__(self, title: str, total: int = 0, stream: TextIO | None = None, unit: str = "frames") -> None:
        self.title, self.total, self.done = printable(title), total, 0
        self._unit, self._rate = unit, "fps" if unit == "frames" else f"{unit}/s"
        self._stream = stream
        shown = sys.stderr if stream is None else stream
        self._live = shown is not None and shown.isatty()
        self._start = time.perf_counter()
        self._drawn, self._width = 0.0, 0

    def update(self, done: int, total: int | None = None) -> None:
        """Report that `done` steps are done; drawn at most ten times per second."""
        self.done, self.total = done, self.total if total is None else total
        now = time.perf_counter()
        if self._live and now - self._drawn > 0.1:
            self._drawn = now
            self._write(self._over(self.line()))

    def finish(self, note: str = "") -> None:
        """End the line, with a note."""
        note = f", {printable(note)}" if note else ""
        line = self.line(ended=True) + note
        self._write((self._over(line) if self._live else line) + "\n")

    def _over(self, line: str) -> str:
        """Return what writes a line over the previous one, on any terminal: without escape codes."""
        width, self._width = self._width, len(line)
        return "\r" + line.ljust(width)

    def _write(self, text: str) -> None:
        if self._stream is None:
            write_error(text)
        else:
            self._stream.write(text)
            self._stream.flush()

    def line(self, ended: bool = False) -> str:
        """The current line: title, bar, count, rate and remaining time."""
        elapsed = max(time.perf_counter() - self._start, 1e-6)
        rate = self.done / elapsed
        if ended:
            return f"{self.title}: {self.done} {self._unit} in {elapsed:.1f} s, {rate:.1f} {self._rate}"
        text = f"{self.title} {self.done}"
        if self.total > 0:
            filled = min(20, round(20 * self.done / self.total))
            left = max(0.0, (self.total - self.done) / rate) if rate > 0 else 0.0
            text = f"{self.title} [{'#' * filled}{'.' * (20 - filled)}] {self.done}/{self.total}"
            return f"{text}  {rate:.1f} {self._rate}  {left:.0f} s left"
        return f"{text}  {rate:.1f} {self._rate}"


@contextmanager
def announced(text: str) -> Iterator[None]:
    """On a terminal, show what takes long and cannot tell how much of it is done, until it ends."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    line = printable(text)
    write_error(line)
    try:
        yield
    finally:
        write_error("\r" + " " * len(line) + "\r")


REMEDIES = {
    "Mark the corners of eyes and mouth, nose and chin.": (
        f"Give at least four points with bind: {_MARKS}; facemime bind --help lists them."
    ),
    "Mark the corners of the eyes, and find the face again.": f"Give the corners of the eyes with bind: {_MARKS}.",
    "Mark eyes, nose and mouth.": "Use eyes, nose and mouth.",
    "Mark it again.": "Correct --mark.",
    "Choose its file under Key.": "Give its file with --key; facemime receive --new-key FILE makes one.",
    "Choose protocol ": "Choose --protocol ",
    "Choose one of these senders.": "Choose one of these with --sender.",
    "listen on 0.0.0.0": "use --listen 0.0.0.0",
    "Mark them again; left and right are the head's own.": "Correct --mark; left and right are the head's own.",
    "Use Open Lips, which cuts the mesh between them, or model a slit.": (
        "Use bind with --cut-open, which cuts the mesh between them, or model a slit."
    ),
    "Use Open Lips, which adds a dark pocket behind them, or model the inside of a mouth.": (
        "Use bind with --cut-open, which adds a dark pocket behind them, or model the inside of a mouth."
    ),
    "Use Open Eyes, which cuts the mesh along the lids, or model separate eyes.": (
        "Use bind with --cut-open, which cuts the mesh along the lids, or model separate eyes."
    ),
    "Use Find Face instead.": "Use bind instead.",
    "Find its face instead, or add such keys.": "Use bind instead, or add such keys.",
    "Find its face in Head > Your Own Head, or use the built-in head.": "Use bind, or the built-in head.",
    "Delete them in Edit Mode, where they are selected, and find the face again.": (
        "Delete them in Blender, and run bind again."
    ),
    "Set these parts to Skin, or find the face again.": "Run bind again, or set these parts to Skin in Blender.",
    "Paint their regions over them, or find the face again.": "Paint their regions over them in Blender.",
    "or use Reset Regions.": "or use Reset Regions, in Blender.",
    "Use Learn Controls in the Head panel first.": "Use bind with --learn-controls first.",
    "Learn the controls again.": "Use bind with --learn-controls again.",
    "and find the face again.": "and run bind again.",
    "or find the face again.": "or run bind again.",
    "Find the face again.": "Run bind again.",
}
"""Remedies of the terminal by those of the window; of two that fit, the first one."""


def for_terminal(message: str) -> str:
    """Return a message with remedies that do not need a window."""
    for window, terminal in REMEDIES.items():
        message = message.replace(window, terminal)
    return message

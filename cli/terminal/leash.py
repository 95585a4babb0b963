"""Ending a process together with the one that started it, when its standard input ends.

Imports nothing that takes time, so that it can run first in a process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time

LEASH = "FACEMIME_ENDS_WITH_STDIN"
"""Environment variable of processes that end with their standard input."""
_PATIENCE = 3.0
"""Seconds from SIGTERM to the end of the process."""


def follow_stdin() -> None:
    """If the environment requests it, end with the standard input: by SIGTERM and, if that fails, at once."""
    if os.environ.pop(LEASH, ""):
        threading.Thread(target=_end_with_stdin, name="facemime-leash", daemon=True).start()


def _end_with_stdin() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 1024):
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_PATIENCE)
    os._exit(128 + signal.SIGTERM)

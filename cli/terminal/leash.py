"""How a process ends with the one that started it: when its standard input does, whatever became of that one.

Imports nothing that takes time, so that it can be the first thing that a process does.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time

LEASH = "FACEMIME_ENDS_WITH_STDIN"
"""Set in the environment of a process that is to end so."""
_PATIENCE = 3.0
"""Seconds that a tidy end may take."""


def follow_stdin() -> None:
    """Where the environment asks for it, end when the standard input does: by SIGTERM, and if need be at once."""
    if os.environ.pop(LEASH, ""):
        threading.Thread(target=_end_with_stdin, name="facemime-leash", daemon=True).start()


def _end_with_stdin() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 1024):
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_PATIENCE)
    os._exit(128 + signal.SIGTERM)

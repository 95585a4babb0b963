"""The command line in separate processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import facemime

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"
START = [sys.executable, "-m", "facemime.cli"]
_INSTALLED = Path(sys.prefix) / "bin" / "facemime"
COMMAND = [str(_INSTALLED)] if _INSTALLED.exists() else START
"""What a user types."""
needs_posix = pytest.mark.skipif(os.name != "posix", reason="signals and pipes as POSIX has them")


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess:
    """Run the command in a separate process."""
    line = [*START, *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120, check=False, **options)


def broken_off(*arguments: object, when: Path, by: int = signal.SIGINT) -> tuple[int, str]:
    """Return exit status and messages of the command when it gets the signal `by` once `when` has frames."""
    with subprocess.Popen([*START, *map(str, arguments)], stderr=subprocess.PIPE, text=True) as process:
        while not (when.exists() and when.stat().st_size > 5_000):
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(by)
        said = process.stderr.read()
    return process.returncode, said

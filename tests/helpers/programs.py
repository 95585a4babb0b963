"""Programs from Debian that tests use."""

import os
import shutil
from pathlib import Path

import pytest

_REASONS = Path(__file__).resolve().parents[2] / "build" / "missing"


def program(name: str) -> str:
    """Return the path of a program; skip the test with the reason if it could not be installed."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}{os.pathsep}/usr/sbin")  # where Debian has servers
    if found is None:
        reason = _REASONS / f"{name}.txt"
        pytest.skip(reason.read_text().strip() if reason.exists() else f"{name} is missing: make programs")
    return found

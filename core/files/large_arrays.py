"""Arrays that may be larger than the memory, such as the motion of all vertices over a long take."""

from __future__ import annotations

import os
import sys
import tempfile
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError

_IN_MEMORY = 1 << 30
"""Largest number of bytes that stay in memory."""
_LASTING = Path("/var/tmp")
"""Folder for large files on Linux, where the usual one is often a part of the memory."""
_BLOCK = 1 << 24
"""Bytes that are written at a time."""


def large_array(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return an array of float32 with any content, to be filled.

    One of more than a gibibyte is kept in a temporary file, which vanishes with the array. The system then decides what
    of it is in memory. Raises OutputError if there is no room for the file.
    """
    size = 4 * prod(shape)
    if size <= _IN_MEMORY:
        return np.empty(shape, dtype=np.float32)
    folder = _folder()
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            _reserve(file, size)
            return np.memmap(file, np.float32, "r+", shape=shape)
    except OSError as error:
        raise OutputError(
            "The motion of all vertices takes {size:.1f} GB, for which {folder} has no room. "
            "Free some space there, or use a shorter part of the take.",
            size=size / 1e9,
            folder=folder,
        ) from error


def _folder() -> Path:
    """Folder for the file: the one that the user chose, or else one on a disk."""
    chosen = any(os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP"))
    lasting = sys.platform == "linux" and os.access(_LASTING, os.W_OK)
    return _LASTING if lasting and not chosen else Path(tempfile.gettempdir())


def _reserve(file: IO[Any], size: int) -> None:
    """Take up the space of a file: where it is missing only once the array is filled, the program is killed."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    zeros = bytes(_BLOCK)
    for start in range(0, size, _BLOCK):
        file.write(zeros[: size - start])
    file.flush()

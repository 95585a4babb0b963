"""QR codes of addresses, which save typing on a phone."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_QUIET = 4
"""Width of the margin in modules that ISO/IEC 18004 requires."""


def qr_code(text: str) -> NDArray[np.bool_]:
    """Return the modules of the QR code of a text, (N, N), true where dark, with the margin."""
    dark = cv2.QRCodeEncoder.create().encode(text) < 128
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    inner = dark[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return np.asarray(np.pad(inner, _QUIET), dtype=np.bool_)


def as_text(code: NDArray[np.bool_]) -> str:
    """Format a QR code as lines of half blocks, for a terminal with light text on a dark background."""
    padded = np.pad(code, ((0, len(code) % 2), (0, 0)))
    pairs = zip(padded[::2], padded[1::2], strict=True)
    return "\n".join("".join("█▀▄ "[2 * a + b] for a, b in zip(*pair, strict=True)) for pair in pairs)

"""Tables of coefficients as other programs write them."""

from __future__ import annotations

from collections.abc import Iterable

from facemime.core.face.names import COEFFICIENTS

NAMES = COEFFICIENTS[:20]


def table_lines(times: Iterable[object], title: str = "Timecode") -> list[str]:
    """Titles, and a row per time in which all coefficients have the same value of 0.2 to 0.8."""
    rows = [",".join([str(time), *[f"{0.5 + 0.1 * (row % 7 - 3):.4f}"] * 20]) for row, time in enumerate(times)]
    return [",".join([title, *NAMES]), *rows]


def stamps(count: int, rate: int = 60, start: int = 0, clock: str = "10:20") -> list[str]:
    """Timecodes of Live Link Face."""
    return [f"{clock}:{i // rate:02d}:{i % rate:02d}.000" for i in range(start, start + count)]

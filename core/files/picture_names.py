"""Order of pictures by the numbers in their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

_PARTS = re.compile(r"(\D*)(\d*)")
_LAST_NUMBER = re.compile(r"(.*?)(-?)(\d{1,9})")
_SPARSE = 2
"""How many times as long as its pictures a numbered sequence may be; longer ones are pictures that were picked."""


def in_order(pictures: Sequence[Path]) -> list[Path]:
    """Return pictures by name, numbers in their order; negative ones come first, as in -0001.png, 0000.png."""
    keys = []
    for path, numbered in zip(pictures, _numbers(pictures), strict=True):
        if numbered is None or numbered[1] >= 0:
            keys.append(_parts(path.name))
            continue
        before, number = numbered
        parts = _parts(f"{before}{-number}{path.suffix}")
        place = len(re.findall(r"\d+", before))
        parts[place] = number, parts[place][1]
        keys.append(parts)
    return [path for _, path in sorted(zip(keys, pictures, strict=True))]


def places(pictures: Sequence[Path]) -> Sequence[int | None]:
    """Return the position of each picture in its numbered sequence, from 0; all None if the names are no sequence."""
    named = [numbered for numbered in _numbers(pictures) if numbered is not None]
    if len(named) == len(pictures) > 1 and len({before for before, _ in named}) == 1:
        numbers = np.array([number for _, number in named])
        found = (numbers - numbers[0]) // max(int(np.gcd.reduce(np.diff(numbers))), 1)
        if np.diff(found).min() > 0 and found[-1] < _SPARSE * len(found):
            return [int(place) for place in found]
    return [None] * len(pictures)


def _numbers(pictures: Sequence[Path]) -> list[tuple[str, int] | None]:
    """Return the last number of each name, and the text before it; None for names that do not end with a number."""
    found = [_LAST_NUMBER.fullmatch(path.stem) for path in pictures]
    # A hyphen is a sign, as Blender writes it, at the start, or if others have the same text without one.
    signed = {""} | {match[1] for match in found if match and not match[2]}
    return [
        None if match is None
        else (match[1], -int(match[3])) if match[2] and match[1] in signed
        else (match[1] + match[2], int(match[3]))
        for match in found
    ]  # fmt: skip


def _parts(name: str) -> list[tuple[int, str]]:
    return [(int(number or 0), text) for text, number in _PARTS.findall(name)]

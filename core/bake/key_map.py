"""Tables that say which shape keys of a mesh a performance moves: source -> key, times a gain, plus an offset.

Sources are ARKit's 52 coefficients. Presets for the vocabularies in use lie in `assets/key_maps`; names are compared
without case, separators and ways to write left and right: `eyeBlink_L`, `EyeBlinkLeft` and `eye blink.l` are one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..assets import ASSETS
from ..errors import SourceError
from ..reading import as_list, as_number, as_object, as_text, parse_json, read_text, shown
from .arkit import COEFFICIENTS
from .least_squares import bounded_least_squares

PRESETS = ASSETS / "key_maps"
_FORMAT = "facemime-key-map"
_MOST_ROWS, _LARGEST = 10_000, 1e6
"""Rows, and gains and offsets, of any table that makes sense."""
_KINDS = ("modifier", "expression", "phoneme")
_FEWEST = 3
_RIDGE = 1e-3
_SMALLEST_GAIN = 0.01


@dataclass(frozen=True)
class KeyRow:
    """A row of a table: `key` gets `gain` times the coefficient `source`, plus `offset`; rows of a key add up."""

    source: str
    key: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class KeyPose:
    """Keys as the user posed them: their `values` by name, for a frame with `coefficients` (52,)."""

    coefficients: FloatArray
    values: dict[str, float]

    def to_json(self) -> str:
        """As `from_json` reads it."""
        return json.dumps({"coefficients": self.coefficients.tolist(), "values": self.values})

    @classmethod
    def from_json(cls, text: str) -> KeyPose:
        """From what `to_json` gave; SourceError where it is something else."""
        try:
            data = as_object(parse_json(text), "the text")
            numbers = as_list(data.get("coefficients"), "coefficients", len(COEFFICIENTS))
            if len(numbers) != len(COEFFICIENTS):
                raise ValueError(f"there are {len(numbers)} coefficients, not {len(COEFFICIENTS)}")
            values = as_object(data.get("values"), "values")
            return cls(
                np.array([as_number(number, "a coefficient", -_LARGEST, _LARGEST) for number in numbers]),
                {key: as_number(value, shown(key), -_LARGEST, _LARGEST) for key, value in values.items()},
            )
        except ValueError as error:
            raise SourceError(
                f"A stored pose is damaged ({error}) and was removed. Add it again, or learn from the others."
            ) from error


@dataclass(frozen=True)
class KeyMap:
    """A table, by `name`."""

    name: str
    rows: tuple[KeyRow, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that it moves, each once, in their order."""
        return tuple(dict.fromkeys(row.key for row in self.rows))

    def apply(self, coefficients: FloatArray, ranges: Mapping[str, tuple[float, float]]) -> dict[str, FloatArray]:
        """Values (N,) of each key that is in `ranges`, kept within them, for (N, 52) coefficients."""
        names, values = COEFFICIENTS, {}
        for key in self.keys:
            if key in ranges:
                rows = [row for row in self.rows if row.key == key]
                mixed = sum(row.gain * coefficients[:, names.index(row.source)] + row.offset for row in rows)
                values[key] = np.clip(np.asarray(mixed), *ranges[key])
        return values

    def matched(self, keys: Iterable[str]) -> KeyMap:
        """The rows whose key is among `keys`, however that is written, under the names that `keys` has."""
        known = {normalised(key): key for key in reversed(list(keys))}
        rows = (replace(row, key=known[normalised(row.key)]) for row in self.rows if normalised(row.key) in known)
        return KeyMap(self.name, tuple(rows))

    def to_json(self) -> str:
        """As `from_json` reads it."""
        return json.dumps(
            {"format": _FORMAT, "name": self.name, "rows": [asdict(row) for row in self.rows]},
            indent=1,
            ensure_ascii=False,
        )


def from_json(text: str) -> KeyMap:
    """The table that `text` holds; SourceError where it is none."""
    try:
        data = as_object(parse_json(text), "the text")
        if data.get("format") != _FORMAT:
            raise ValueError("it does not say that it is one")
        rows = as_list(data.get("rows"), "rows", _MOST_ROWS)
        return KeyMap(as_text(data.get("name"), "name"), tuple(_row(as_object(row, "a row")) for row in rows))
    except ValueError as error:
        raise SourceError(f"This is no table of keys ({error}). Give one that Facemime exported.") from error


def _row(data: Mapping[str, Any]) -> KeyRow:
    if (source := as_text(data.get("source"), "source")) not in COEFFICIENTS:
        raise ValueError(f"{shown(source)} is not an ARKit coefficient")
    key = as_text(data.get("key"), "key")
    gain, offset = (
        as_number(data.get(name, default), f"the {name} of {shown(key)}", -_LARGEST, _LARGEST)
        for name, default in (("gain", 1.0), ("offset", 0.0))
    )
    return KeyRow(source, key, gain, offset)


def load_map(path: Path) -> KeyMap:
    """The table at `path`; SourceError where there is none."""
    try:
        return from_json(read_text(Path(path)))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read ({error}). Give a table of keys.") from error
    except SourceError as error:
        raise SourceError(f"{path}: {error}") from error


@lru_cache(maxsize=1)
def presets() -> tuple[KeyMap, ...]:
    """The tables that ship, ARKit's first."""
    return tuple(load_map(path) for path in sorted(PRESETS.glob("*.json")))


def best_preset(keys: Sequence[str]) -> KeyMap | None:
    """The preset that moves the most of `keys`, with the names they have; None where none moves three."""
    matches = [preset.matched(keys) for preset in presets()]
    best = max(matches, key=lambda match: len(match.keys), default=None)
    return best if best is not None and len(best.keys) >= _FEWEST else None


def expression_keys(keys: Sequence[str]) -> list[str]:
    """Those of `keys` that some preset knows for an expression; all where none is known."""
    known = {normalised(key) for preset in presets() for key in preset.keys}
    return [key for key in keys if normalised(key) in known] or list(keys)


def normalised(name: str) -> str:
    """`name` as it is compared: `eyeBlink_L` and `Modifier EyeBlink-Left` both give "eyeblinkleft"."""
    words = re.sub(r"[\W_]+", " ", name).strip()
    for short, side in (("L", "left"), ("R", "right")):
        words = re.sub(rf"(?<= ){short}$", side, words, flags=re.IGNORECASE)
    first, _, rest = words.partition(" ")
    return (rest if rest and first.lower() in _KINDS else words).replace(" ", "").casefold()


def learn_map(coefficients: FloatArray, poses: FloatArray, keys: Sequence[str], start: KeyMap) -> KeyMap:
    """A table whose gains put `keys` as the user posed them, next to `start` where the poses do not tell.

    Parameters
    ----------
    coefficients : (P, 52) array
        Of the frames that the user posed.
    poses : (P, K) array
        Values of `keys` in these frames.
    start : KeyMap
        The table so far; its offsets stay.

    Notes
    -----
    For each key the gains g >= 0 that minimise `|C g + offset - pose|^2 + r |g - g_start|^2`: few poses leave most
    gains open, and these stay as they were.
    """
    names = COEFFICIENTS
    coefficients = np.asarray(coefficients, dtype=np.float64)
    before, offsets = np.zeros((len(keys), len(names))), np.zeros(len(keys))
    for row in start.rows:
        if row.key in keys:
            before[keys.index(row.key), names.index(row.source)] += max(row.gain, 0.0)
            offsets[keys.index(row.key)] += row.offset
    gram = coefficients.T @ coefficients + _RIDGE * np.eye(len(names))
    products = (np.asarray(poses).T - offsets[:, None]) @ coefficients + _RIDGE * before
    gains = bounded_least_squares(gram, products, np.zeros(len(names)), np.full(len(names), np.inf))
    rows = [row for row in start.rows if row.key not in keys]
    for key, row_gains, offset in zip(keys, gains, offsets, strict=True):
        chosen = np.flatnonzero(row_gains >= _SMALLEST_GAIN)
        for place, source in enumerate(chosen):
            rows.append(KeyRow(names[source], key, float(row_gains[source]), float(offset) if place == 0 else 0.0))
    return KeyMap(f"{start.name}, learnt" if not start.name.endswith("learnt") else start.name, tuple(rows))

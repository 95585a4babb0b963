"""Key mappings: tables from ARKit's coefficients to the shape keys of a mesh (method.md, section 9.4).

Presets for common vocabularies are in `assets/key_maps`. Names are compared regardless of case, separators and the
spelling of left and right: `eyeBlink_L`, `EyeBlinkLeft` and `eye blink.l` are equal.
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

from ..errors import DataError, Message, SourceError
from ..face.names import COEFFICIENTS, EXCLUSIVE_NAMES, names_of, normalised, without_node
from ..files.reading import as_list, as_number, as_object, as_text, parse_format, parse_json, read_text, shown
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_least_squares

_FORMAT = "facemime-key-map"
_MAX_ROWS = 10_000
"""Largest number of rows in a file."""
_MAX_VALUE = 1e6
"""Largest gains and offsets in a file."""
_RIDGE = 1e-3
"""Ridge of equation 9.8 towards the gains of the given table."""
_FIRMNESS = 1e5
"""Weight of the given values in `KeyMap.invert`, relative to the coefficients that are near: far more, but well within
double precision."""
_MIN_GAIN = 0.01
"""Smallest learnt gain that is kept."""


@dataclass(frozen=True)
class KeyRow:
    """A row of a table: it sets `key` to `gain` times the coefficient `source`, plus `offset`; rows of a key add up.

    A row with a higher `rank` is used only for meshes that have no key of a lower rank of the same source: meshes have
    one key for both eyelids, or two, or all three.

    Examples
    --------
    >>> from facemime import KeyRow
    >>> KeyRow("jawOpen", "Mouth Closed", gain=-1.0, offset=1.0).key
    'Mouth Closed'
    """

    source: str
    key: str
    gain: float = 1.0
    offset: float = 0.0
    rank: int = 0


@dataclass(frozen=True)
class KeyPose:
    """Shape key values that the user posed for a frame.

    Attributes
    ----------
    coefficients : (52,) float64
        ARKit's coefficients of the frame.
    values : dict of str to float
        Value of each shape key, by name.
    """

    coefficients: FloatArray
    values: dict[str, float]

    def to_json(self) -> str:
        """Serialise to the text that `from_json` parses."""
        return json.dumps({"coefficients": self.coefficients.tolist(), "values": self.values})

    @classmethod
    def from_json(cls, text: str) -> KeyPose:
        """Parse the result of `to_json`; SourceError if it is anything else."""
        try:
            data = as_object(parse_json(text), "the text")
            numbers = as_list(data.get("coefficients"), "coefficients", len(COEFFICIENTS))
            if len(numbers) != len(COEFFICIENTS):
                raise DataError(
                    "there are {numbers} coefficients, not {coefficients}",
                    numbers=len(numbers),
                    coefficients=len(COEFFICIENTS),
                )
            values = as_object(data.get("values"), "values")
            return cls(
                np.array([as_number(number, "a coefficient", -_MAX_VALUE, _MAX_VALUE) for number in numbers]),
                {key: as_number(value, shown(key), -_MAX_VALUE, _MAX_VALUE) for key, value in values.items()},
            )
        except ValueError as error:
            raise SourceError(
                "A stored pose is damaged ({error}) and was removed. Add it again, or learn from the others.",
                error=error,
            ) from error


@dataclass(frozen=True)
class KeyMap:
    """A key mapping: a named table of rows.

    Examples
    --------
    >>> from facemime import COEFFICIENTS, KeyMap, KeyRow
    >>> table = KeyMap("Mine", (KeyRow("jawOpen", "Jaw Open"),))
    >>> values = np.zeros((10, len(COEFFICIENTS)))
    >>> values[:, COEFFICIENTS.index("jawOpen")] = 0.5
    >>> float(table.apply(values, {"Jaw Open": (0.0, 1.0)})["Jaw Open"][0])
    0.5
    """

    name: str
    rows: tuple[KeyRow, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that the table sets, each once, in order."""
        return tuple(dict.fromkeys(row.key for row in self.rows))

    @property
    def short_name(self) -> str:
        """The name of the set without what it is also used by, and without numbers: "ARKit"."""
        return re.sub(r"\s\d+$", "", self.name.partition(",")[0])

    @property
    def sources(self) -> frozenset[str]:
        """Coefficients that the table uses."""
        return frozenset(row.source for row in self.rows)

    def summary(self) -> str:
        """Return a text that says how much of a performance the keys can show."""
        values: dict[str, Any] = {"short_name": self.short_name, "keys": len(self.keys)}
        if len(self.sources) == len(COEFFICIENTS):
            return Message("{short_name}: {keys} shape keys for all 52 movements.", **values)
        values["shown_of"] = len(self.sources)
        if any(source.startswith("brow") for source in self.sources):
            return Message("{short_name}: {keys} shape keys for {shown_of} of 52 movements.", **values)
        return Message("{short_name}: {keys} shape keys for {shown_of} of 52 movements, none of the brows.", **values)

    def apply(self, coefficients: FloatArray, ranges: Mapping[str, tuple[float, float]]) -> dict[str, FloatArray]:
        """Compute the values of shape keys.

        Parameters
        ----------
        coefficients : (N, 52) float64
            Coefficients in the order of `COEFFICIENTS`.
        ranges : mapping of str to (float, float)
            Range of each shape key of the mesh.

        Returns
        -------
        dict of str to (N,) float64
            Values, clipped to the ranges, of the keys that are both in the table and in the mesh.
        """
        names, values = COEFFICIENTS, {}
        for key in self.keys:
            if key in ranges:
                rows = [row for row in self.rows if row.key == key]
                mixed = sum(row.gain * coefficients[:, names.index(row.source)] + row.offset for row in rows)
                values[key] = np.clip(np.asarray(mixed), *ranges[key])
        return values

    def invert(self, values: Mapping[str, FloatArray], near: FloatArray) -> FloatArray:
        """Compute coefficients from the values of shape keys.

        Parameters
        ----------
        values : mapping of str to (N,) float64
            Values of all keys in the table.
        near : (N, 52) float64
            Coefficients, 0 to 1, to which the result is as near as the values permit, unless each key is a coefficient.

        Returns
        -------
        (N, 52) float64
            Coefficients, 0 to 1, for which `apply` gives the values. If each key of the table is a coefficient, they
            are those values, negative ones as the coefficient of the opposite motion, and others are 0.
        """
        names = COEFFICIENTS
        if self._states_each_once():
            found = np.zeros((len(near), len(names)))
            for row in self.rows:  # of keys of several nodes, the one furthest from 0
                column, value = names.index(row.source), (values[row.key] - row.offset) / row.gain
                found[:, column] = np.where(np.abs(value) > np.abs(found[:, column]), value, found[:, column])
            return np.clip(_without_opposites(found), 0.0, 1.0)
        gains, wanted = np.zeros((len(self.keys), len(names))), np.column_stack([values[key] for key in self.keys])
        for row in self.rows:
            gains[self.keys.index(row.key), names.index(row.source)] += row.gain
            wanted[:, self.keys.index(row.key)] -= row.offset
        gram = _FIRMNESS * gains.T @ gains + np.eye(len(names))
        products = _FIRMNESS * wanted @ gains + near
        return bounded_least_squares(gram, products, np.zeros(len(names)), np.ones(len(names)))

    def _states_each_once(self) -> bool:
        """Return whether each key is a coefficient, of which each has one key, or one of each node."""
        names = {(row.source, normalised(without_node(row.key))) for row in self.rows}
        single = len(self.rows) == len(self.keys) and all(row.gain for row in self.rows)
        return single and (len(names) == len(self.sources) or len(self.keys) == len(self.sources))

    def matched(self, keys: Iterable[str], *, ranked: bool = True) -> KeyMap:
        """Return the rows whose key is among `keys`, regardless of spelling, with the names in `keys`; if `ranked`,
        those of the lowest rank of each source.

        A key of each node counts, as Maya has a node for each mesh.
        """
        known = _by_name(tuple(keys), frozenset(normalised(row.key) for row in self.rows))
        rows = [row for row in self.rows if normalised(row.key) in known]
        first: dict[str, int] = {}
        for row in rows:
            first[row.source] = min(row.rank, first.get(row.source, row.rank))
        rows = [row for row in rows if row.rank == first[row.source] or not ranked]
        return KeyMap(self.name, tuple(replace(row, key=key) for row in rows for key in known[normalised(row.key)]))

    def to_json(self) -> str:
        """Serialise to the text that `from_json` parses."""
        return json.dumps(
            {"format": _FORMAT, "name": self.name, "rows": [asdict(row) for row in self.rows]},
            indent=1,
            ensure_ascii=False,
        )


def _without_opposites(coefficients: FloatArray) -> FloatArray:
    """Turn negative coefficients, (N, 52), into positive ones of the motions that these exclude."""
    pairs = np.array([[COEFFICIENTS.index(name) for name in pair] for pair in EXCLUSIVE_NAMES])
    pairs, turned = np.concatenate([pairs, pairs[:, ::-1]]), coefficients.copy()
    turned[:, pairs[:, 0]] += np.maximum(-coefficients[:, pairs[:, 1]], 0.0)
    return turned


def from_json(text: str) -> KeyMap:
    """Parse a key mapping; SourceError if `text` is anything else."""
    try:
        data = parse_format(text, _FORMAT)
        rows = as_list(data.get("rows"), "rows", _MAX_ROWS)
        return KeyMap(as_text(data.get("name"), "name"), tuple(_row(as_object(row, "a row")) for row in rows))
    except ValueError as error:
        raise SourceError("This is not a key mapping ({error}). Use one exported by Facemime.", error=error) from error


def _row(data: Mapping[str, Any]) -> KeyRow:
    if (source := as_text(data.get("source"), "source")) not in COEFFICIENTS:
        raise DataError("{source} is not an ARKit coefficient", source=shown(source))
    key = as_text(data.get("key"), "key")
    gain, offset = (
        as_number(data.get(name, default), f"the {name} of {shown(key)}", -_MAX_VALUE, _MAX_VALUE)
        for name, default in (("gain", 1.0), ("offset", 0.0))
    )
    rank = int(as_number(data.get("rank", 0), f"the rank of {shown(key)}", 0, _MAX_ROWS))
    return KeyRow(source, key, gain, offset, rank)


def load_map(path: Path) -> KeyMap:
    """Load a key mapping from a file; SourceError if the file does not contain one."""
    try:
        return from_json(read_text(Path(path)))
    except (OSError, ValueError) as error:
        raise SourceError("{path} cannot be read ({error}). Choose a key mapping.", path=path, error=error) from error
    except SourceError as error:
        raise SourceError("{path}: {error}", path=path, error=error) from error


def exclusive_keys(keys: Sequence[str]) -> list[tuple[int, int]]:
    """Return the pairs of `keys`, by position, that are named as ARKit's coefficients which exclude each other."""
    known = _by_name(tuple(keys), frozenset(map(normalised, COEFFICIENTS)))
    places = {key: place for place, key in reversed(list(enumerate(keys)))}
    pairs = [[known.get(normalised(name), []) for name in pair] for pair in EXCLUSIVE_NAMES]
    return [(places[one], places[other]) for ones, others in pairs for one in ones for other in others]


@lru_cache(maxsize=64)
def _by_name(keys: tuple[str, ...], known: frozenset[str]) -> dict[str, list[str]]:
    """Return keys by each of their names of a vocabulary; the first one of each node."""
    found: dict[str, dict[str, str]] = {}
    for key, names in names_of(keys, known).items():
        for name in names:
            found.setdefault(name, {}).setdefault(key.removesuffix(without_node(key)), key)
    return {name: list(of.values()) for name, of in found.items()}


def learn_map(coefficients: FloatArray, poses: FloatArray, keys: Sequence[str], start: KeyMap) -> KeyMap:
    """Learn the gains of K shape keys from P frames that the user posed (equation 9.8).

    The frames have coefficients (P, 52) and values of the keys (P, K). A few poses leave most gains undetermined; these
    keep the values of `start`, as all its offsets do.
    """
    names = COEFFICIENTS
    coefficients = np.asarray(coefficients, dtype=np.float64)
    # Gains of the given table, which are the centre of the ridge.
    before, offsets = np.zeros((len(keys), len(names))), np.zeros(len(keys))
    for row in start.rows:
        if row.key in keys:
            before[keys.index(row.key), names.index(row.source)] += max(row.gain, 0.0)
            offsets[keys.index(row.key)] += row.offset
    # Equation 9.8 for all keys at once.
    gram = coefficients.T @ coefficients + _RIDGE * np.eye(len(names))
    products = (np.asarray(poses).T - offsets[:, None]) @ coefficients + _RIDGE * before
    gains = bounded_least_squares(gram, products, np.zeros(len(names)), np.full(len(names), np.inf))
    rows = [row for row in start.rows if row.key not in keys]
    for key, row_gains, offset in zip(keys, gains, offsets, strict=True):
        chosen = np.flatnonzero(row_gains >= _MIN_GAIN)
        for place, source in enumerate(chosen):
            rows.append(KeyRow(names[source], key, float(row_gains[source]), float(offset) if place == 0 else 0.0))
    return KeyMap(f"{start.name}, learnt" if not start.name.endswith("learnt") else start.name, tuple(rows))

"""The vocabularies that are shipped as key mappings, and which of them a mesh has (method.md, section 9.4)."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence, Set
from functools import lru_cache

from ..face.names import is_facial_morph, normalised
from ..files.assets import ASSETS
from .key_map import KeyMap, KeyRow, load_map

PRESETS = ASSETS / "key_maps"
ESSENTIAL = frozenset({"jawOpen", "eyeBlinkLeft", "eyeBlinkRight"})
"""Coefficients without which keys do not form a set for a whole face."""
_MIN_MATCHES = 3
"""Smallest number of keys by which a preset is recognised."""
_SHOWN = 0.5
"""Smallest gain with which a key of another preset shows a movement, as one does that moves both eyelids. What has less
only resembles it, as *th* does a tongue."""
_TWICE = 1.9
"""Ratio of gains above which such a key shows a movement instead: the blink of one eyelid instead of that of both."""
_GROUPS = {
    "Brows": ("brow",),
    "Eyes": ("eye", "lid", "blink"),
    "Jaw": ("jaw",),
    "Mouth": ("mouth", "tongue", "lip", "smile", "phoneme"),
    "Cheeks and Nose": ("cheek", "nose", "sneer"),
}
"""For each group of curves, what coefficients and other names of it contain."""
_LOOK = "eyelook"
"""What the names of the coefficients of the gaze contain."""
_OTHERS = "Face"
"""Group of all other curves."""


@lru_cache(maxsize=1)
def presets() -> tuple[KeyMap, ...]:
    """Return the shipped tables, ARKit's first."""
    return tuple(load_map(path) for path in sorted(PRESETS.glob("*.json")))


def best_preset(keys: Sequence[str]) -> KeyMap | None:
    """Return the preset that fits `keys` best, with the names in `keys`, or None if none sets at least three.

    It is completed by others, as meshes may have the vowels of one vocabulary and the blinks of another. The best one
    then sets most of the essential coefficients; among equals it sets all of them by itself, or else most of the keys.
    """
    tables = [(preset.matched(keys), {*preset.matched(keys, ranked=False).keys}) for preset in presets()]
    tables.sort(key=lambda table: -len(table[0].keys))
    others = [table for table, _ in tables]

    def fitness(pair: tuple[KeyMap, KeyMap]) -> tuple[int, bool, int]:
        own, completed = pair
        return len(ESSENTIAL & completed.sources), own.sources >= ESSENTIAL, len(own.keys)

    pairs = [(own, _completed(own, known, others)) for own, known in tables if len(own.keys) >= _MIN_MATCHES]
    return max(pairs, key=fitness)[1] if pairs else None


def _completed(table: KeyMap, known: Set[str], others: Iterable[KeyMap]) -> KeyMap:
    """Let others show what a table lacks, or shows half as much, by keys that are not `known` to its vocabulary."""
    rows = list(table.rows)
    for other in others:
        for source in dict.fromkeys(row.source for row in other.rows):
            more = [row for row in other.rows if row.source == source]
            less = [row for row in rows if row.source == source]
            shown = max(_SHOWN, _TWICE * _strongest(less))
            if _strongest(more) >= shown and known.isdisjoint(row.key for row in more):
                rows = [*(row for row in rows if row.source != source), *more]
    return KeyMap(table.name, tuple(rows))


def _strongest(rows: Iterable[KeyRow]) -> float:
    return max((row.gain for row in rows), default=0.0)


def with_others(table: KeyMap, fitted: Container[str], keys: Iterable[str]) -> KeyMap:
    """Add to the result of `best_preset` for keys `fitted` what its set assigns to the others of `keys`."""
    whole = next(preset for preset in presets() if preset.name == table.name).matched(keys)
    return KeyMap(table.name, (*table.rows, *(row for row in whole.rows if row.key not in fitted)))


def expression_keys(keys: Sequence[str]) -> list[str]:
    """Return those of `keys` that are in any preset, or all if none is."""
    return known_expressions(keys) or list(keys)


def known_expressions(keys: Sequence[str]) -> list[str]:
    """Return those of `keys` that are in any preset, or that FaceGen's heads name as expressions."""
    known = {key for preset in presets() for key in preset.matched(keys, ranked=False).keys}
    return [key for key in keys if key in known or is_facial_morph(key)]


def curve_groups(keys: Sequence[str]) -> dict[str, str]:
    """Return the name of the group of curves for each of `keys`, by what it moves."""
    sources = {row.key: row.source for preset in reversed(presets()) for row in preset.matched(keys, ranked=False).rows}
    return {key: _group(sources.get(key, key)) for key in keys}


def gaze_keys(keys: Sequence[str]) -> set[str]:
    """Return those of `keys` that show where the eyes look."""
    sources = {row.key: row.source for preset in reversed(presets()) for row in preset.matched(keys, ranked=False).rows}
    return {key for key in keys if _LOOK in normalised(sources.get(key, key))}


def _group(name: str) -> str:
    words = normalised(name)
    return next((group for group, parts in _GROUPS.items() if any(part in words for part in parts)), _OTHERS)

"""Names of ARKit's 52 coefficients, of facial actions that no landmark shows, and of shape keys as programs write them.

Each is measured as an activation from 0 to about 1, with the names and the meaning of ARKit's coefficients. Those
with a side have one value per side; right and left are the performer's own.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Container, Iterable, Iterator, Mapping, Set
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_SINGLE_ACTIONS = ("tongueOut", "mouthRollLower", "mouthRollUpper")
_SIDED_ACTIONS = ("cheekPuff", "mouthPress", "browInnerUp", "browDown", "noseSneer", "cheekSquint")
_KINDS = ("modifier", "expression", "phoneme", "arkit", "blendshape", "blendshapes", "bs", "morph")
"""First words of names that are ignored: those of FaceGen's morphs, and what others put before the name of a key."""
_FACEGEN_KINDS = {"modifier", "expression", "phoneme"}
_SHAPES = {"earsout", "epicanthicfold"}
"""FaceGen's modifiers that do not move a face."""


_SIDED = (
    *("browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp"),
    *("eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown", "mouthPress", "mouthSmile"),
    *("mouthStretch", "mouthUpperUp", "noseSneer"),
)
_SINGLE = (
    *("browInnerUp", "cheekPuff", "jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose", "mouthFunnel"),
    *("mouthLeft", "mouthPucker", "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower"),
    *("mouthShrugUpper", "tongueOut"),
)
COEFFICIENTS = tuple(sorted([*_SINGLE, *(name + side for name in _SIDED for side in ("Left", "Right"))]))
"""Names of the 52 coefficients, alphabetically; left and right are the performer's own."""
COEFFICIENT_INDEX = {name: i for i, name in enumerate(COEFFICIENTS)}
"""Column of each coefficient."""
N_COEFFICIENTS = len(COEFFICIENTS)
FITTED: NDArray[np.intp] = np.array([i for i, name in enumerate(COEFFICIENTS) if not name.startswith("eyeLook")])
"""(44,) columns of the coefficients that are fitted: all but the eight of the eyes' direction."""
_LOOKS = (("eyeLookDown", "eyeLookUp"), ("eyeLookIn", "eyeLookOut"))
EXCLUSIVE_NAMES = (
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("eyeBlinkLeft", "eyeWideLeft"),
    ("eyeBlinkRight", "eyeWideRight"),
    ("mouthSmileLeft", "mouthFrownLeft"),
    ("mouthSmileRight", "mouthFrownRight"),
    *((one + side, other + side) for one, other in _LOOKS for side in ("Left", "Right")),
)
"""Coefficients that exclude each other, as their motions are opposite."""
EXCLUSIVE: NDArray[np.intp] = np.array(
    [[COEFFICIENT_INDEX[name] for name in pair] for pair in EXCLUSIVE_NAMES if not pair[0].startswith("eyeLook")]
)
"""(P, 2) columns of those that are fitted."""


def _mirrored(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name


COEFFICIENT_MIRROR: NDArray[np.intp] = np.array([COEFFICIENT_INDEX[_mirrored(name)] for name in COEFFICIENTS])
"""(52,) mirror image of each coefficient: ``a[COEFFICIENT_MIRROR]`` are the coefficients of a face that was flipped
left to right."""


def _spellings() -> dict[str, tuple[int, str]]:
    """Column and half of each coefficient by its spellings as letters in lower case: `eyeblinkleft` and `eyeblinkl`.

    Some programs divide coefficients that have no sides into halves, such as `browInnerUp_L`; others have the half "".
    """
    found = {}
    for name, column in COEFFICIENT_INDEX.items():
        stem = name.removesuffix("Left").removesuffix("Right")
        for side in ("Left", "Right"):
            half = side if stem == name else ""
            if half or name.endswith(side):
                found[f"{stem}{side}".lower()] = found[f"{stem}{side[0]}".lower()] = column, half
        found[name.lower()] = column, ""
    return found


_SPELLINGS: Mapping[str, tuple[int, str]] = _spellings()
_SUFFIX = re.compile(r"[.|:/](?:weight|value)s?$|[\])]$", re.IGNORECASE)
_PREFIX = re.compile(r"^.*[.|:/\[(](?=...)")
"""That of a node, but not the name before the `.L` of a side."""
_SET = re.compile(r"^(?:arkit|blendshapes?|bs)")
"""Names of the set that some programs put before those of its coefficients."""


@lru_cache(maxsize=1024)
def _read(name: str) -> tuple[int | None, str]:
    letters = re.sub(r"[\W_]", "", _PREFIX.sub("", _SUFFIX.sub("", name.strip()))).lower()
    found = _SPELLINGS.get(letters) or _SPELLINGS.get(_SET.sub("", letters))
    return (None, "") if found is None else found


def column_of(name: str) -> int | None:
    """Return the column of a coefficient by any of its usual names, or None for other names.

    Capitals and what separates words do not matter, as in `eye_blink_left` or `EyeBlink_L`, nor does the name of a node
    or a set, as in `blendShapes.EyeBlinkLeft`, `Head|jawOpen` or `weights[jawOpen]`. A coefficient without sides may be
    divided into halves, as in `browInnerUp_L`.
    """
    return _read(name)[0]


def half_of(name: str) -> str:
    """Return which half of a coefficient without sides a name states, "Left" or "Right"; "" for any other name."""
    return _read(name)[1]


def combined(values: Iterable[tuple[str, float]]) -> dict[int, float]:
    """Return the values of coefficients by their columns, for values by name, of which others are left out.

    Of several spellings of a coefficient the largest value counts, as programs send those that they do not measure as
    0; of its halves the mean.
    """
    found: dict[int, dict[str, float]] = {}
    for name, value in values:
        column, half = _read(name)
        if column is not None:
            halves = found.setdefault(column, {})
            halves[half] = max(value, halves.get(half, value))
    return {column: _whole(halves) for column, halves in found.items()}


def _whole(halves: dict[str, float]) -> float:
    if len(halves) == 1:
        return next(iter(halves.values()))
    sides = [value for half, value in halves.items() if half]
    return max(halves.get("", -np.inf), sum(sides) / len(sides))


ACTIONS: tuple[str, ...] = (*_SINGLE_ACTIONS, *(name + side for name in _SIDED_ACTIONS for side in ("Right", "Left")))
"""Names of the actions."""
N_ACTIONS = len(ACTIONS)


def action_indices(names: Iterable[str]) -> NDArray[np.intp]:
    """Return the positions of actions in `ACTIONS`; ValueError for an unknown name."""
    return np.array([ACTIONS.index(name) for name in names], dtype=np.intp)


ACTION_MIRROR: NDArray[np.intp] = action_indices(_mirrored(name) for name in ACTIONS)
"""Mirror image of each action: ``actions[ACTION_MIRROR]`` are the actions of a face that was flipped left to right."""


_SIDE_FIRST = re.compile(r"((?i:left|right))(?: |(?=[A-Z]))")
"""A side before the rest of a name, as in `L_eyeBlink` or `leftEyeBlink`."""
_NODE = re.compile(r"[.:|]|_(?=Fcl_)", re.IGNORECASE)
"""What is between the name of a node and that of a key, as Maya and VRoid Studio write it."""
_FIRST = re.compile(r"^[\W_]*[^\W_]+[\W_]+(?=.)|^[\W_]+(?=.)")
"""First word of a name, as in `Head_jawOpen`."""
_LAST = re.compile(r"(?<=.)[\W_]+[^\W_]+$")
"""Last word of a name, as in `jawOpen_Mesh`."""
_MOST_FIRST = 3
"""Words that may come before a name: `Genesis9__facs_bs_JawOpen_div2`."""
_MOST_LAST = 2
"""Words that may come after a name."""
_LEAST_LETTERS = 6
"""Letters of a known name that is found at the end of another without a separator: the names of vowels are in all."""
_MIN_AFFIXED = 8
"""Known names that have to have a prefix or suffix before it is taken for one. By chance, the keys of one of the
shipped tables have at most 5 names of another in common (Daz's are ARKit's, and so are ten of SRanipal's; the plain
words are also those of others).
"""


@lru_cache(maxsize=1 << 14)
def normalised(name: str) -> str:
    """Normalise a name for comparison: `Modifier EyeBlink-Left` and `L_eyeBlink` give "eyeblinkleft"."""
    words = _words(name)
    first, _, rest = words.partition(" ")
    if rest and first.lower() in _KINDS:  # first, as the R of "Phoneme: R" is no side
        words = rest
    for short, side in (("L", "left"), ("R", "right")) if " " in words else ():
        words = re.sub(rf"\b{short}\b", side, words, flags=re.IGNORECASE)
    if side_first := _SIDE_FIRST.match(words):
        words = words[side_first.end() :] + side_first[1]
    return words.replace(" ", "").casefold()


def _words(name: str) -> str:
    name = unicodedata.normalize("NFKC", name)
    return re.sub(r"[\W_]+", " ", re.sub(r"(?<=[a-z])(?=[LR]$)", " ", name)).strip()


def is_facial_morph(name: str) -> bool:
    """Return whether a name is that of one of FaceGen's morphs that move the face, rather than shape a person."""
    kind, colon, _ = name.partition(":")
    return bool(colon) and kind.strip().lower() in _FACEGEN_KINDS and normalised(name) not in _SHAPES


def without_node(name: str) -> str:
    """Return the name of a key without that of the node that has it."""
    return list(_without_nodes(name))[-1]


def _without_nodes(name: str) -> Iterator[str]:
    """Yield a name, and what comes after each separator in it."""
    yield name
    yield from (name[match.end() :] for match in _NODE.finditer(name))


def names_of(keys: Iterable[str], known: Set[str]) -> dict[str, set[str]]:
    """Return the normalised names for which each key may stand.

    A key stands for its name with and without that of its node. One that is not `known` may have a prefix and a suffix
    that are not of its name: those without which many keys would be known. Digits in them may differ.
    """
    names = {key: set(map(normalised, _without_nodes(key))) for key in keys}
    taken = set().union(*names.values())
    shorter: dict[tuple[str, str], dict[str, str]] = {}
    for key in (key for key, own in names.items() if own.isdisjoint(known)):
        for affix, name in {*_by_words(key, known), *_by_letters(key, known)}:
            if name not in taken:
                shorter.setdefault(affix, {}).setdefault(key, name)
    for of in shorter.values():
        if len(set(of.values())) >= _MIN_AFFIXED:
            for key, name in of.items():
                names[key].add(name)
    return names


def _by_words(key: str, known: Container[str]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield the words before and after known names in `key`, and these names.

    Of several numbers, the last one of a name may not be its own, as in `AU_01_Wrinkle3`.
    """
    for before, shortened in _without(key, _FIRST, _MOST_FIRST):
        for after, name in _without(shortened, _LAST, _MOST_LAST):
            counted = name[-1:].isdigit() and _numbered(before + after) != before + after
            if (before or after) and normalised(name) in known and not counted:
                yield (_numbered(before), _numbered(after)), normalised(name)


def _without(name: str, word: re.Pattern[str], most: int) -> Iterator[tuple[str, str]]:
    """Yield up to `most` words at one end of a name, and the rest, from none on."""
    affix = ""
    yield affix, name
    for _ in range(most):
        if (match := word.search(name)) is None:
            return
        affix, name = affix + match[0], word.sub("", name)
        yield affix, name


def _by_letters(key: str, known: Iterable[str]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield the letters before or after the longest known name at an end of `key`, and that name."""
    own = normalised(key)
    long = [name for name in known if _LEAST_LETTERS <= len(name) < len(own)]
    if name := max(filter(own.endswith, long), key=len, default=""):
        yield (_numbered(own.removesuffix(name)), ""), name
    if name := max(filter(own.startswith, long), key=len, default=""):
        yield ("", _numbered(own.removeprefix(name))), name


def _numbered(affix: str) -> str:
    return re.sub(r"\d+", "#", affix)

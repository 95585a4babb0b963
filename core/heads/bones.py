"""Bones of head, eyes and jaw, found by the names that rigs give them (method.md, section 7.6)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_LEFT, _RIGHT = {"l", "left"}, {"r", "right"}
_AFFIXES = {"base", "mixamorig", "bip", "biped", "valve", "facial", "master", "def", "adj", "j", "c", "cc", "b", "x"}
"""Words that rigs put before or after a name, or that mark a bone as deforming or central."""
_HEADS = ({"head"}, {"skull"}, {"kopf"}, {"tete"})
_JAWS = ({"jaw"}, {"jawbone"}, {"jaw", "root"}, {"mandible"})
_EYES = ({"eye"}, {"face", "eye"}, {"eyeball"}, {"eye", "socket"})


@dataclass(frozen=True)
class FaceBones:
    """Names of the bones that move with a face; "" where a rig has none. Left and right are the character's own."""

    head: str = ""
    eye_right: str = ""
    eye_left: str = ""
    jaw: str = ""


def find_bones(names: Sequence[str], weights: Mapping[str, float]) -> FaceBones:
    """Find the bones of head, eyes and jaw.

    Parameters
    ----------
    names : sequence of str
        Bones of the armature.
    weights : mapping of str to float
        Share of the skin of the face that each bone moves, for rigs with uninformative names.

    Returns
    -------
    FaceBones
        Their names. Of several candidates, the one with the fewest other words in its name.

    Notes
    -----
    Names are split into words. Case, side and the prefixes of Mixamo, VRM, 3ds Max, Rigify, Auto-Rig and MetaHuman are
    ignored.
    """
    head = _best(names, _HEADS, set()) or max(weights, key=lambda name: weights[name], default="")
    return FaceBones(head, _best(names, _EYES, _RIGHT), _best(names, _EYES, _LEFT), _best(names, _JAWS, set()))


def _best(names: Sequence[str], wanted: Sequence[set[str]], side: set[str]) -> str:
    """Return the best of `names` whose words are one of `wanted` and a side; "" if there is none."""
    for words in wanted:
        for name in names:
            found = _words(name)
            sides = found & (_LEFT | _RIGHT)
            if found - _LEFT - _RIGHT - _AFFIXES == words and (bool(sides & side) if side else not sides):
                return name
    return ""


def _words(name: str) -> set[str]:
    """Return the words of a name in lower case, without numbers: `J_Bip_C_Head` and `head.x` contain "head"."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return {word for word in re.split(r"[^a-z]+", apart.lower()) if word}

"""What the names of controls say on rigs that many animators know: the part of the face that each is meant to move.

What was learnt decides: a name gives a control its label, and its region only if the control does move that. Each name
was found in two public sources: Rigify's face and its generated rigs, Auto-Rig Pro, BlenRig's guide, and MetaHuman's
board. Names of ARKit's coefficients count as well.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from ..errors import messages
from ..face.names import COEFFICIENTS, column_of

ROLES = messages(
    {
        "Brow": "Brow",
        "Blink": "Blink",
        "Upper Lid": "Upper Lid",
        "Lower Lid": "Lower Lid",
        "Cheek": "Cheek",
        "Nose": "Nose",
        "Mouth": "Mouth",
        "Lip Corner": "Lip Corner",
        "Upper Lip": "Upper Lip",
        "Lower Lip": "Lower Lip",
        "Chin": "Chin",
        "Jaw": "Jaw",
    }
)
"""What a control is meant to move."""
REGION_OF: Mapping[str, str] = {
    **{"Brow": "Brows", "Blink": "Eyes", "Upper Lid": "Eyes", "Lower Lid": "Eyes", "Nose": "Nose", "Mouth": "Mouth"},
    **{"Lip Corner": "Mouth", "Upper Lip": "Mouth", "Lower Lip": "Mouth", "Chin": "Jaw", "Jaw": "Jaw"},
}
"""Region of the face of each; cheeks belong to whichever they move."""
_STEMS: Mapping[str, str] = {
    # Rigify
    **{"jaw master": "Jaw", "jaw": "Jaw", "chin": "Chin", "lips": "Lip Corner", "lip t": "Upper Lip"},
    **{"lip b": "Lower Lip", "lid t": "Upper Lid", "lid b": "Lower Lid", "brow t": "Brow", "brow b": "Brow"},
    **{"cheek t": "Cheek", "cheek b": "Cheek", "nose master": "Nose", "nose": "Nose"},
    # Auto-Rig Pro
    **{"c jawbone x": "Jaw", "c lips smile": "Lip Corner", "c lips top": "Upper Lip", "c lips top x": "Upper Lip"},
    **{"c lips bot": "Lower Lip", "c lips bot x": "Lower Lip", "c lips roll top x": "Upper Lip"},
    **{"c lips roll bot x": "Lower Lip", "c eyelid top": "Upper Lid", "c eyelid bot": "Lower Lid"},
    **{"c eyebrow full": "Brow", "c eyebrow": "Brow", "c cheek smile": "Cheek", "c cheek inflate": "Cheek"},
    # BlenRig
    **{"mouth ctrl": "Mouth", "mouth mstr ctrl": "Mouth", "mouth corner": "Lip Corner", "lip up ctrl": "Upper Lip"},
    **{"lip low ctrl": "Lower Lip", "mouth up ctrl": "Upper Lip", "mouth low ctrl": "Lower Lip"},
    **{"blink ctrl": "Blink", "eyelid up ctrl": "Upper Lid", "eyelid low ctrl": "Lower Lid"},
    **{"brow ctrl in": "Brow", "brow ctrl curve": "Brow", "brow ctrl out": "Brow", "cheek ctrl": "Cheek"},
    **{"nose frown ctrl": "Nose", "nose ctrl": "Nose"},
}
"""What names mean, as words in lower case, without the side and the number at the end."""
_BOARD: tuple[tuple[str, str], ...] = (
    ("brow ", "Brow"),
    ("eye blink", "Blink"),
    ("eye eyelidu", "Upper Lid"),
    ("eye eyelidd", "Lower Lid"),
    ("eye squintinner", "Lower Lid"),
    ("eye cheekraise", "Cheek"),
    ("nose", "Nose"),
    *((f"mouth {name}", "Lip Corner") for name in ("cornerpull", "cornerdepress", "dimple", "stretch")),
    ("mouth upperlipraise", "Upper Lip"),
    ("mouth lowerlipdepress", "Lower Lip"),
    *((f"mouth {name}u", "Upper Lip") for name in ("funnel", "purse", "press", "lipsroll", "lipstogether")),
    *((f"mouth {name}d", "Lower Lip") for name in ("funnel", "purse", "press", "lipsroll", "lipstogether")),
    ("mouth", "Mouth"),
    ("jaw", "Jaw"),
)
"""What names of MetaHuman's board, without `CTRL` and the side, begin with."""
_COEFFICIENTS: tuple[tuple[str, str], ...] = (
    *(("brow", "Brow"), ("eyeBlink", "Blink"), ("eyeWide", "Upper Lid"), ("eyeSquint", "Lower Lid")),
    *(("cheek", "Cheek"), ("nose", "Nose"), ("jaw", "Jaw")),
    *((f"mouth{name}", "Lip Corner") for name in ("Smile", "Frown", "Stretch", "Dimple")),
    *((f"mouth{name}", "Upper Lip") for name in ("UpperUp", "RollUpper", "ShrugUpper")),
    *((f"mouth{name}", "Lower Lip") for name in ("LowerDown", "RollLower", "ShrugLower")),
    ("mouth", "Mouth"),
)
"""What names of coefficients begin with."""
_SIDE = re.compile(
    r"(?<![a-zA-Z])(?:[Ll]eft|LEFT|[Rr]ight|RIGHT|[LlRr])(?![a-zA-Z])|(?<=[a-z])(?:Left|Right|L|R)(?![a-zA-Z])"
)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
_NUMBER = re.compile(r"(?: \d+)?(?: end)?$")
_CENTRE = re.compile(r"(?<![a-zA-Z])c(?![a-zA-Z])")


@lru_cache(maxsize=4096)
def role_of(name: str) -> str:
    """Return what a control is meant to move by its name, a key of `ROLES`; "" if the name is not known.

    >>> role_of("lid.T.L.002"), role_of("CTRL_R_mouth_cornerPull"), role_of("hinge")
    ('Upper Lid', 'Lip Corner', '')
    """
    words = re.sub(r"[\W_]+", " ", _without_side(name)).strip().lower()
    if words.startswith("ctrl "):
        words = re.sub(r" +", " ", _CENTRE.sub("", words.removeprefix("ctrl "))).strip()
        return _beginning(words, _BOARD)
    if (found := _STEMS.get(words) or _STEMS.get(_NUMBER.sub("", words))) is not None:
        return found
    column = column_of(name)
    return "" if column is None else _beginning(COEFFICIENTS[column], _COEFFICIENTS)


def mirrored(name: str) -> str:
    """Return the name of the control on the other side, the same name for one in the middle.

    >>> mirrored("lid.T.L.002"), mirrored("browDownLeft"), mirrored("jaw")
    ('lid.T.R.002', 'browDownRight', 'jaw')
    """
    found = list(_SIDE.finditer(name))
    if not found:
        return name
    match = found[-1]
    other = _OTHER[match[0].lower()]
    other = other.upper() if match[0].isupper() else other.capitalize() if match[0][0].isupper() else other
    return name[: match.start()] + other + name[match.end() :]


def _without_side(name: str) -> str:
    for match in list(_SIDE.finditer(name))[-1:]:
        name = f"{name[: match.start()]} {name[match.end() :]}"
    return name


def _beginning(name: str, table: tuple[tuple[str, str], ...]) -> str:
    return next((role for start, role in table if name.startswith(start)), "")

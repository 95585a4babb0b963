"""What a driven take is baked to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..settings import Choice, setting
from .key_map import KeyMap

Keys = Literal["new", "named", "mapped", "cache", "alembic"]


@dataclass(frozen=True)
class BakeSettings:
    """What a driven take is baked to.

    Attributes
    ----------
    keys : {"new", "named", "mapped", "cache", "alembic"}
        New shape keys; those that the mesh has, fitted to the motion of its vertices; those, by a table from ARKit's
        coefficients; a point cache that the Mesh Cache modifier plays; that, and an Alembic file beside it.
    max_keys : int
        Of new ones at most; the report tells the error.
    clean : float
        How far vertices may end from where all keyframes would put them, eye distances; 0 leaves none out.
    nla : bool
        Whether the curves go onto an NLA track instead of the active action.
    table : KeyMap or None
        For "mapped"; None takes the preset that fits the mesh's keys best.
    path : Path or None
        Of the cache, which needs one; the Alembic file's differs in its suffix.
    """

    keys: Keys = setting(
        "new",
        "Bake To",
        "What a take becomes",
        choices=(
            Choice("new", "New Shape Keys", "As few as the motion needs"),
            Choice("named", "Own Shape Keys", "The head's own, fitted to the motion of its skin"),
            Choice("mapped", "Own Shape Keys by Table", "The head's own, by the table of keys"),
            Choice("cache", "Mesh Cache", "Every vertex exactly, in a .pc2 file"),
            Choice("alembic", "Mesh Cache and Alembic", "Every vertex exactly, and an .abc file for other programs"),
        ),
    )
    max_keys: int = setting(64, "Max Keys", "Maximum number of new shape keys", low=1, high=512)
    clean: float = setting(
        0.0,
        "Clean Curves",
        "Error allowed when removing keyframes, relative to the eye distance; 0 keeps every frame",
        low=0.0,
        high=0.1,
        soft_high=0.02,
        unit="percent",
    )
    nla: bool = setting(False, "Push to NLA", "Put the animation onto an NLA track instead of the active action")
    table: KeyMap | None = None
    path: Path | None = None


KEYS = tuple(BakeSettings.__dataclass_fields__["keys"].metadata["setting"].values)

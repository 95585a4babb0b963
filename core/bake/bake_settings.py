"""Settings of a bake."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..files.setting import Choice, setting
from ..heads.key_map import KeyMap

AUTOMATIC, CONTROLS = "automatic", "controls"
FIRST_FRAME, CURRENT_FRAME, SCENE_START = "first", "current", "scene"
Start = Literal["first", "current", "scene"]
Keys = Literal["automatic", "new", "named", "mapped", "controls", "cache", "alembic"]


@dataclass(frozen=True)
class BakeSettings:
    """What a take is baked to, and how.

    Attributes
    ----------
    keys : {"automatic", "new", "named", "mapped", "controls", "cache", "alembic"}
        "automatic" is "named" for a built-in head with shape keys for expressions, "mapped" for another character with
        a known set, and otherwise "new". "new" adds shape keys. "named" fits the mesh's existing shape keys to the
        motion of its vertices. "mapped" sets them from ARKit's coefficients by a key mapping. "controls" sets the
        controls of the character's own rig, which were learnt. "cache" writes a point cache for the Mesh Cache
        modifier, and "alembic" also an Alembic file.
    max_keys : int
        Maximum number of new shape keys; the report states the error.
    residual : bool
        Whether "named" also adds shape keys for what the existing ones cannot show.
    positive : bool
        Whether new shape keys have values of 0 to 1 alone. Those that move both ways become two.
    whole_frames : bool
        Whether keyframes are on whole frames of the scene. Otherwise they are at the times of the take, one for each of
        its frames, and linear.
    clean : float
        Error of the vertices that fewer keyframes on whole frames may cause, in eye distances; with 0, each frame has a
        keyframe.
    nla : bool
        Whether the curves go onto an NLA track instead of the active action.
    keep_animation : bool
        Whether the take is added to animation of the same shape keys and bones, instead of muting that.
    start : {"first", "current", "scene"}
        Frame of the scene at 0 s of the take: frame 1, the current frame, or the first of the scene's frame range.
    fit_range : bool
        Whether the scene's frame range becomes that of the take. Otherwise only the default range of a scene without
        other animation does.
    table : KeyMap or None
        Key mapping for "mapped"; None selects the preset that fits the mesh's shape keys best.
    path : Path or None
        File of the cache, required for "cache" and "alembic"; the Alembic file differs only in its suffix.
    """

    keys: Keys = setting(
        AUTOMATIC,
        "Bake To",
        "What the take is baked to",
        choices=(
            Choice(
                AUTOMATIC,
                "Automatic",
                "Use shape keys for expressions if the character has a known set, such as ARKit's or VRM's; "
                "otherwise add new ones",
                5,
            ),
            Choice("new", "New Shape Keys", "Add as few shape keys as the motion needs", 0),
            Choice("named", "Existing Shape Keys", "Fit the head's shape keys to the motion of its skin", 1),
            Choice(
                "mapped",
                "Existing Shape Keys by Mapping",
                "Animate the head's shape keys according to the key mapping",
                2,
            ),
            Choice(
                CONTROLS,
                "Rig Controls",
                "Animate the controls of the character's own rig, once Learn Controls has found them",
                6,
            ),
            Choice("cache", "Mesh Cache", "Store every vertex exactly, in a .pc2 file", 3),
            Choice(
                "alembic",
                "Mesh Cache and Alembic",
                "Store every vertex exactly, and export an .abc file for other programs",
                4,
            ),
        ),
    )
    max_keys: int = setting(64, "Max Keys", "Maximum number of new shape keys", low=1, high=512)
    residual: bool = setting(
        True,
        "Residual Keys",
        "Add shape keys for what the existing ones cannot show, in a group of curves that can be muted",
    )
    positive: bool = setting(
        False,
        "Positive Values",
        "Split new shape keys that move both ways in two, as many programs cut off values below 0",
    )
    whole_frames: bool = setting(
        True,
        "Whole Frames",
        "Put keyframes on whole frames of the scene, as few as Detail needs; otherwise at the times of the take",
    )
    clean: float = setting(
        0.005,
        "Curve Error",
        "Error that fewer keyframes may cause, relative to the eye distance; 0 gives every frame a keyframe",
        low=0.0,
        high=0.1,
        soft_high=0.02,
        unit="percent",
    )
    nla: bool = setting(False, "Push to NLA", "Put the animation on an NLA track instead of the active action")
    keep_animation: bool = setting(
        False,
        "Keep Animation",
        "Add the take to other animation of the same shape keys and bones, instead of muting it",
    )
    start: Start = setting(
        FIRST_FRAME,
        "Start",
        "Frame of the scene at which the take starts",
        choices=(
            Choice(FIRST_FRAME, "At Frame 1", "The take's time 0 is at frame 1", 0),
            Choice(CURRENT_FRAME, "At Current Frame", "The take's time 0 is at the current frame", 1),
            Choice(SCENE_START, "At Scene Start", "The take's time 0 is at the first frame of the scene's range", 2),
        ),
    )
    fit_range: bool = setting(
        False,
        "Fit Frame Range",
        "Set the scene's frame range to that of the take even if the scene has its own range or other animation",
    )
    table: KeyMap | None = None
    path: Path | None = None

    @property
    def uses_existing_keys(self) -> bool:
        """Whether the bake animates shape keys that the mesh has, whatever the mesh."""
        return self.keys in ("named", "mapped")

    @property
    def writes_cache(self) -> bool:
        """Whether the bake writes a point cache."""
        return self.keys in ("cache", "alembic")


KEYS = tuple(BakeSettings.__dataclass_fields__["keys"].metadata["setting"].values)

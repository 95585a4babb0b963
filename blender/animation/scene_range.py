"""Where a take starts in a scene, and the scene's frame range, which is the user's unless nothing else needs it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.bake_settings import CURRENT_FRAME, SCENE_START
from ...core.errors import Message
from ..muting import others_playing
from ..names import RANGE_PROPERTY
from ..reference import is_of_take, strips_of
from ..timeline import keyed_frame, shown_frames

_PARTS = ("shape_keys", "node_tree")
"""Data-blocks that belong to one other."""
_DEFAULT_RANGE = (1, 250)
"""Frame range of Blender's default scene, which nobody chose."""


def start_frame(scene: bpy.types.Scene, choice: str) -> float:
    """Return the frame of keyframes at 0 s of a take, for a choice as in `BakeSettings.start`."""
    shown = {CURRENT_FRAME: scene.frame_current, SCENE_START: scene.frame_start}
    return keyed_frame(scene, shown.get(choice, 1))


def fit_range(scene: bpy.types.Scene, frames: NDArray[np.floating[Any]], choice: str, *, asked: bool = False) -> None:
    """Set the frame range of a scene to that of a take's keyframes, if it is free or this was asked for.

    A take that starts with the scene (see `BakeSettings.start`) leaves the first frame of the range.
    """
    if not asked and not _is_free(scene):
        return
    first, last = _ends(scene, frames)
    if choice != SCENE_START:
        scene.frame_start = first
    scene.frame_end = max(scene.frame_start, last)
    scene[RANGE_PROPERTY] = [scene.frame_start, scene.frame_end]


def outside_range(scene: bpy.types.Scene, frames: NDArray[np.floating[Any]]) -> str:
    """Return a warning if a take is not all in the frame range of a scene, and otherwise an empty text."""
    first, last = _ends(scene, frames)
    start, end = scene.frame_start, scene.frame_end
    if start <= first and last <= end:
        return ""
    return Message(
        "The take plays from frame {first} to {last}, and the scene from {start} to {end}. "
        "Choose where the take starts, or fit the frame range to it.",
        first=first,
        last=last,
        start=start,
        end=end,
    )


@contextmanager
def holding_take(scene: bpy.types.Scene, frames: NDArray[np.floating[Any]]) -> Iterator[None]:
    """Extend the frame range of a scene for a while, if it does not contain all of a take, to that or to the take."""
    before = scene.frame_start, scene.frame_end
    if outside_range(scene, frames):
        first, last = _ends(scene, frames)
        apart = last < before[0] or first > before[1]
        scene.frame_start = first if apart else min(first, before[0])
        scene.frame_end = last if apart else max(last, before[1])
    try:
        yield
    finally:
        scene.frame_start, scene.frame_end = before


def _ends(scene: bpy.types.Scene, frames: NDArray[np.floating[Any]]) -> tuple[int, int]:
    """Return the first and the last frame of a scene in which keyframes at `frames` play."""
    shown = shown_frames(scene, frames)
    return int(np.floor(shown[0] + 1e-3)), int(np.ceil(shown[-1] - 1e-3))


def _is_free(scene: bpy.types.Scene) -> bool:
    """Return whether the range is Blender's default or that of an earlier take, and nothing else is animated."""
    known = scene.get(RANGE_PROPERTY)
    ours = None if known is None else tuple(known)
    if (scene.frame_start, scene.frame_end) not in (_DEFAULT_RANGE, ours) or scene.timeline_markers:
        return False
    if scene.sequence_editor is not None and any(not is_of_take(strip) for strip in strips_of(scene.sequence_editor)):
        return False
    return not any(map(others_playing, _animatable(scene)))


def _animatable(scene: bpy.types.Scene) -> set[bpy.types.ID]:
    """Return the data-blocks of a scene that may be animated."""
    objects = set(scene.objects)
    data = {obj.data for obj in objects}
    materials = {slot.material for obj in objects for slot in obj.material_slots}
    parts = {getattr(block, name, None) for block in data | materials | {scene.world} for name in _PARTS}
    found = {scene, scene.world, *objects, *data, *materials, *parts}
    return {block for block in found if block is not None and hasattr(block, "animation_data")}

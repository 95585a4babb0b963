"""Curves of an action, in every Blender from 4.2 (legacy actions) to 5.x (slots), which of them Facemime made, the NLA
tracks of its bakes, and actions that several characters share.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from typing import Any
from zlib import crc32

import bpy
import numpy as np

from .names import BAKE_PROPERTY, CURVES_PROPERTY, LAYER_PROPERTY, WRITTEN_PROPERTY

TRACK = "Facemime"
"""Name of a bake's NLA tracks, numbered if there are several; a renamed track belongs to the user."""


Holder = bpy.types.AnimData | bpy.types.NlaStrip
"""What plays an action: the animation of a data-block, or a strip."""


def slot_handle(holder: Holder) -> int:
    """Return the handle of the slot that a holder plays; 0 if it plays none, or if actions have no slots."""
    slot = getattr(holder, "action_slot", None)
    return 0 if slot is None else int(slot.handle)


def action_name(holder: Holder | None) -> str:
    """Return the name of the action that a holder plays; "" if it plays none."""
    return "" if holder is None or holder.action is None else holder.action.name


def drivers_of(owner: bpy.types.ID) -> Sequence[bpy.types.FCurve]:
    """Return the drivers of a data-block."""
    return () if owner.animation_data is None else owner.animation_data.drivers[:]


def tracks_of(owner: bpy.types.ID) -> Sequence[bpy.types.NlaTrack]:
    """Return the NLA tracks of a data-block."""
    return () if owner.animation_data is None else owner.animation_data.nla_tracks[:]


def curves_in(holder: Holder | None) -> Any:
    """Return the curves that a holder plays, or an empty collection; nothing is created."""
    if holder is None or (action := holder.action) is None:
        return ()
    if not hasattr(action, "slots"):
        return action.fcurves
    if holder.action_slot is None or not action.layers or not action.layers[0].strips:
        return ()
    bag = _keyframes(action.layers[0].strips[0]).channelbag(holder.action_slot)
    return () if bag is None else bag.fcurves


def curves_to_fill(owner: bpy.types.ID, holder: Holder) -> tuple[Any, Any]:
    """Return the curves of a holder of `owner`, which has an action, and their groups.

    A slot is added if actions have slots.
    """
    action = _action(holder)
    if not hasattr(action, "slots"):
        return action.fcurves, action.groups
    if holder.action_slot is None:
        holder.action_slot = action.slots.new(id_type=owner.id_type, name=owner.name)
    layer = action.layers[0] if action.layers else action.layers.new("Facemime")
    strip = layer.strips[0] if layer.strips else layer.strips.new(type="KEYFRAME")
    bag = _keyframes(strip).channelbag(holder.action_slot, ensure=True)
    return bag.fcurves, bag.groups


def _action(holder: Holder) -> bpy.types.Action:
    """Return the action of a holder that has one."""
    assert holder.action is not None
    return holder.action


def _keyframes(strip: bpy.types.ActionStrip) -> bpy.types.ActionKeyframeStrip:
    """Return a strip of an action as the only kind there is so far."""
    assert isinstance(strip, bpy.types.ActionKeyframeStrip)
    return strip


class CharacterAction:
    """An action that is added to a character: one with a slot for each of its data-blocks.

    Where actions have no slots, each data-block has its own.

    Parameters
    ----------
    name : str
        Name for the action, if it has to be created.
    owners : iterable of bpy.types.ID
        Data-blocks of the character, which may play it already.
    kind : str
        `BAKE_PROPERTY` or `LAYER_PROPERTY`.
    """

    def __init__(self, name: str, owners: Iterable[bpy.types.ID], kind: str = BAKE_PROPERTY) -> None:
        self._name, self._kind = name, kind
        playing = (data.action for owner in owners if (data := owner.animation_data) is not None)
        self._action = next((action for action in playing if action is not None and kind in action), None)
        self._strips: bpy.types.Action | None = None

    @property
    def name(self) -> str:
        """Name of the action."""
        return self._name if self._action is None else self._action.name

    def give(self, owner: bpy.types.ID, name: str) -> None:
        """Let a data-block without an action play this one, or one of that name where actions have no slots."""
        data = owner.animation_data or owner.animation_data_create()
        if "slots" not in bpy.types.Action.bl_rna.properties:
            data.action = bpy.data.actions.new(name)
            data.action[self._kind] = True
            return
        if self._action is None:
            self._action = bpy.data.actions.new(self._name)
            self._action[self._kind] = True
        data.action = self._action
        data.action_slot = self._action.slots.new(id_type=owner.id_type, name=owner.name)

    def add_strip(self, owner: bpy.types.ID, track: bpy.types.NlaTrack, frame: int, name: str) -> bpy.types.NlaStrip:
        """Add a strip to a track of a data-block, which plays the action of all strips of the character, or one of that
        name where actions have no slots.
        """
        if "slots" not in bpy.types.Action.bl_rna.properties:
            return track.strips.new(name, frame, bpy.data.actions.new(name))
        if self._strips is None:
            self._strips = bpy.data.actions.new(self._name)
        strip = track.strips.new(name, frame, self._strips)
        strip.action_slot = self._strips.slots.new(id_type=owner.id_type, name=owner.name)
        return strip


def is_layer(holder: Holder | None) -> bool:
    """Return whether a holder plays the user's corrections of a bake; Merge Animation moves them to another action."""
    if holder is None or holder.action is None:
        return False
    added = isinstance(holder, bpy.types.AnimData) and holder.action_blend_type in ("ADD", "COMBINE")
    return LAYER_PROPERTY in holder.action or (added and LAYER_PROPERTY in holder.id_data)


def find_curve(action: bpy.types.Action, handle: int, path: str, index: int) -> bpy.types.FCurve | None:
    """Return a curve of the slot with a handle; an action without slots has a single set of curves."""
    if not hasattr(action, "slots"):
        return action.fcurves.find(path, index=index)
    bags = (bag for layer in action.layers for strip in layer.strips for bag in _keyframes(strip).channelbags)
    found = (bag.fcurves.find(path, index=index) for bag in bags if bag.slot_handle == handle)
    return next((curve for curve in found if curve is not None), None)


def owned_paths(holder: Holder | None) -> set[str]:
    """Return the data paths of the curves of a holder that Facemime made.

    They are known by what they contain where Blender gave the slot to another action, or a shape key another name.
    """
    if holder is None or (action := holder.action) is None:
        return set()
    lines = "\n".join(str(action.get(name, "")) for name in _names(holder))
    listed = set(filter(None, lines.split("\n")))
    written = _written(holder)
    present = {curve.data_path for curve in curves_in(holder)} if written else listed
    if present <= listed:
        return listed
    contents = _contents(holder, present - listed)
    if not listed:
        known = contents.keys() & written.keys()
        same = [curve for curve in known if contents[curve] == written[curve]]
        if 2 * len(same) < max(len(known), 1):  # the user may have edited some of a bake's
            return set()
        listed = {path for path, _ in known}
    lost = {content for (path, _), content in written.items() if path not in present}
    return listed.union(path for (path, _), content in contents.items() if content in lost)


def own_paths(holder: Holder, paths: Iterable[str]) -> None:
    """Note that Facemime made the curves of these data paths."""
    paths = set(paths)
    _action(holder)[_names(holder)[-1]] = "\n".join(sorted(owned_paths(holder) | paths))
    written = _written(holder) | _contents(holder, paths)
    owner = holder.id_data
    assert owner is not None
    lines = (f"{content} {index} {path}" for (path, index), content in sorted(written.items()))
    owner[WRITTEN_PROPERTY] = "\n".join(lines)


def _written(holder: Holder) -> dict[tuple[str, int], str]:
    """Return the contents of the curves that bakes wrote for the data-block of a holder, by data path and index."""
    assert holder.id_data is not None
    lines = [line.split(" ", 2) for line in str(holder.id_data.get(WRITTEN_PROPERTY, "")).split("\n") if line]
    return {(path, int(index)): content for content, index, path in lines}


def _contents(holder: Holder, paths: Collection[str]) -> dict[tuple[str, int], str]:
    """Return checksums of the keyframes of the curves of a holder that have some data paths, by data path and index."""
    found = {}
    for curve in curves_in(holder):
        if curve.data_path in paths:
            found[curve.data_path, curve.array_index] = content_of(curve)
    return found


def content_of(curve: bpy.types.FCurve) -> str:
    """Return a checksum of the keyframes of a curve, and of a driver's expression and variables."""
    points = np.empty(2 * len(curve.keyframe_points), dtype=np.float32)
    curve.keyframe_points.foreach_get("co", points)
    sum_of_points = crc32(points.tobytes())
    if (driver := curve.driver) is None:
        return f"{sum_of_points:08x}"
    variables = [(one.name, one.type, *(target.data_path for target in one.targets)) for one in driver.variables]
    return f"{crc32(repr((driver.type, driver.expression, variables)).encode(), sum_of_points):08x}"


def content_of_track(track: bpy.types.NlaTrack) -> str:
    """Return a checksum of where the strips of a track are, and of what they play."""
    places = [(strip.frame_start, strip.frame_end, strip.blend_type, action_name(strip)) for strip in track.strips]
    return f"{crc32(repr(places).encode()):08x}"


def disown_paths(holder: Holder) -> None:
    """Note that Facemime made no curve of a holder."""
    action = _action(holder)
    for name in _names(holder):
        if name in action:
            action[name] = ""


def forget_contents(owner: bpy.types.ID) -> None:
    """Forget what bakes wrote for a data-block, after all of it was removed."""
    if WRITTEN_PROPERTY in owner:
        del owner[WRITTEN_PROPERTY]


def _names(holder: Holder) -> list[str]:
    """Return the properties with the paths: that of files without slots, and that of the slot."""
    handle = slot_handle(holder)
    return [CURVES_PROPERTY, *([f"{CURVES_PROPERTY}.{handle}"] if handle else [])]


_TRACK_NAME = re.compile(rf"{TRACK}(\.\d{{3}})?")


def tracks_of_bakes(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks of `owner` that a bake added."""
    return [track for track in tracks_of(owner) if _TRACK_NAME.fullmatch(track.name)]


def tracked_strips(owner: bpy.types.ID) -> list[bpy.types.NlaStrip]:
    """Return the strips on these tracks, among which may be strips of the user."""
    return [strip for track in tracks_of_bakes(owner) for strip in track.strips]


def is_baked(strip: bpy.types.NlaStrip) -> bool:
    """Return whether a bake wrote the action of a strip."""
    return bool(owned_paths(strip))


def make_actions_own(owners: Iterable[bpy.types.ID]) -> None:
    """Give data-blocks of a character a copy of each action that plays elsewhere too, or is linked.

    `owners` are all data-blocks whose animation will be changed. Those that share an action also share its copy.
    Actions with slots are shared by what has the same slot only.
    """
    playing = [(owner, data) for owner in dict.fromkeys(owners) if (data := owner.animation_data) is not None]
    animated = [owner for owner, data in playing if data.action is not None]
    copies: dict[bpy.types.Action, bpy.types.Action] = {}
    for _, data in playing:
        action, handle = data.action, slot_handle(data)
        if action is not None and action not in copies and _plays_elsewhere(action, handle, animated):
            copies[action] = action.copy()
    for _, data in playing:
        handle = slot_handle(data)
        if data.action is not None and (copy := copies.get(data.action)) is not None:
            data.action = copy
            if handle:
                data.action_slot = next(slot for slot in copy.slots if slot.handle == handle)


def _plays_elsewhere(action: bpy.types.Action, handle: int, owners: list[bpy.types.ID]) -> bool:
    """Return whether a slot of an action plays on another data-block, or on a strip, or cannot be changed here."""
    if action.library is not None:
        return True
    for user in bpy.data.user_map(subset=[action])[action]:
        if (data := getattr(user, "animation_data", None)) is None:
            continue
        if user not in owners and data.action == action and slot_handle(data) == handle:
            return True
        strips = (strip for track in data.nla_tracks for strip in track.strips)
        if any(strip.action == action and slot_handle(strip) == handle for strip in strips):
            return True
    return False

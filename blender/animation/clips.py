"""The clips of an animated character: actions of one name on its objects, of which one is played."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.errors import HeadError
from ..fcurves import find_curve
from ..meshes import mesh_of
from .bake_keys import value_path

_JOINT = "|"
"""Separates the object, the take and the layer in the names of actions that the FBX importer makes."""


@dataclass
class AnimationClip:
    """A clip of the character.

    Attributes
    ----------
    actions : dict of bpy.types.ID to (bpy.types.Action, handle)
        Action of each animated data-block, and the handle of its slot; 0 if actions have none.
    plays : bool
        Whether it plays now.
    """

    actions: dict[bpy.types.ID, tuple[bpy.types.Action, int]] = field(default_factory=dict)
    plays: bool = False

    @property
    def frames(self) -> tuple[int, int]:
        """First and last frame."""
        ranges = np.array([action.frame_range for action, _ in self.actions.values()])
        return int(np.floor(ranges[:, 0].min())), int(np.ceil(ranges[:, 1].max()))


def owners_of(objects: Iterable[bpy.types.Object]) -> list[bpy.types.ID]:
    """Return the data-blocks that an animation of `objects` may move: themselves, and their shape keys."""
    objects = list(objects)
    meshes = [mesh_of(obj) for obj in objects if obj.type == "MESH"]
    keys = {mesh.shape_keys for mesh in meshes if mesh.shape_keys is not None}
    return [*objects, *sorted(keys, key=lambda key: key.name)]


def clips_of(owners: Iterable[bpy.types.ID]) -> dict[str, AnimationClip]:
    """Return the clips of some data-blocks by name.

    A clip is what NLA tracks or actions of one name hold, as importers make them.
    """
    owners, clips = list(owners), dict[str, AnimationClip]()
    for owner in owners:
        if (data := owner.animation_data) is None:
            continue
        active = data.action
        for track in data.nla_tracks:
            for strip in track.strips:
                if strip.action is None:
                    continue
                clip = clips.setdefault(track.name, AnimationClip())
                clip.actions[owner] = strip.action, _handle(strip)
                clip.plays |= strip.action == active if active is not None else not (track.mute or strip.mute)
        if active is not None and not any(clip.actions.get(owner, (None,))[0] == active for clip in clips.values()):
            clip = clips.setdefault(_take_of(active), AnimationClip())
            clip.actions[owner], clip.plays = (active, _handle(data)), True
    for action, owner in _unassigned(owners):
        clips.setdefault(_take_of(action), AnimationClip()).actions.setdefault(owner, (action, 0))
    return dict(sorted(clips.items()))


def play(clips: dict[str, AnimationClip], name: str, owners: Iterable[bpy.types.ID]) -> None:
    """Play only the clip `name` of `clips` on some data-blocks; raises HeadError if there is no such clip."""
    if name not in clips:
        if not clips:
            raise HeadError("There is no clip {name}, nor any other.", name=name)
        raise HeadError("There is no clip {name}. Choose one of: {known}.", name=name, known=", ".join(clips))
    for owner in owners:
        if (data := owner.animation_data) is not None:
            data.action = None
            for track in data.nla_tracks:
                track.mute = True
    _assign(clips[name])


def play_single(clips: dict[str, AnimationClip]) -> None:
    """Play also the clips whose data-blocks are in no other one.

    Exporters may write the actions of a performance, such as that of the head and that of its shape keys, as a clip
    each, of which the importer of glTF plays the first.
    """
    count = Counter(owner for clip in clips.values() for owner in clip.actions)
    for clip in clips.values():
        if not clip.plays and all(count[owner] == 1 for owner in clip.actions):
            _assign(clip)


def make_room(clips: dict[str, AnimationClip]) -> None:
    """Extend the ranges of shape keys to the keyframes of imported clips.

    The importers of glTF and USD leave them at 0 to 1, to which Blender clips the values.
    """
    animated = ((owner, *played) for clip in clips.values() for owner, played in clip.actions.items())
    for owner, action, handle in animated:
        for key in owner.key_blocks if isinstance(owner, bpy.types.Key) else ():
            if (curve := find_curve(action, handle, value_path(key.name), 0)) is not None:
                values = [point.co[1] for point in curve.keyframe_points]
                key.slider_min = min([key.slider_min, *values])
                key.slider_max = max([key.slider_max, *values])


def _assign(clip: AnimationClip) -> None:
    """Make the actions of a clip the active ones."""
    clip.plays = True
    for owner, (action, handle) in clip.actions.items():
        data = owner.animation_data_create()
        data.action = action
        if not hasattr(data, "action_slot_handle"):  # up to Blender 4.3
            continue
        if handle:
            data.action_slot_handle = handle
        elif data.action_slot is None and len(data.action_suitable_slots):
            data.action_slot = data.action_suitable_slots[0]


def _handle(user: bpy.types.AnimData | bpy.types.NlaStrip) -> int:
    return int(getattr(user, "action_slot_handle", 0))


def _take_of(action: bpy.types.Action) -> str:
    parts = str(action.name).split(_JOINT)
    return parts[1] if len(parts) > 1 else parts[0]


def _unassigned(owners: list[bpy.types.ID]) -> list[tuple[bpy.types.Action, bpy.types.ID]]:
    """Actions that the FBX importer made for a data-block, by the name in theirs, and did not assign."""
    named = {owner.name: owner for owner in reversed(owners)}
    free = [action for action in bpy.data.actions if _JOINT in action.name and not action.users - action.use_fake_user]
    found = ((action, named.get(action.name.split(_JOINT)[0])) for action in free)
    return [(action, owner) for action, owner in found if owner is not None]

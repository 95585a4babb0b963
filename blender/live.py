"""A head in the scene while it is puppeted: shown by one shape key, and put back as it was.

The rest shape lies in the basis key and is never written, so that whatever happens to a session (a crash, an undo, a
file saved in the middle) the mesh itself is safe.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.drive import HeadFrame
from ..core.errors import HeadError
from .actions import baked_paths, mute_bake, mute_curves
from .bake import EYE_PARTS, JAW_PARTS
from .bake_cache import MODIFIER
from .bake_keys import BAKED_KEY_PREFIX, require_relative, value_path
from .frames import flat_in_blender
from .meshes import mesh_of
from .names import PART_PROPERTY
from .targets import PoseTarget

LIVE_KEY = "Facemime Live"


@dataclass
class Follow:
    """What of a performance the scene's objects follow: the head's `rotation` and `translation`."""

    rotation: bool = True
    translation: bool = False


@dataclass(eq=False)
class LiveHeadObject:
    """One head that follows a performance.

    Parameters
    ----------
    obj : bpy.types.Object
        A mesh that can be driven.
    targets : mapping
        "head" and, where others than its own eyeballs take the gaze, "eye_left" and "eye_right".
    """

    obj: bpy.types.Object
    targets: Mapping[str, PoseTarget]
    follow: Follow = field(default_factory=Follow)

    def __post_init__(self) -> None:
        mesh = mesh_of(self.obj)
        if mesh.library is not None or self.obj.library is not None:
            raise HeadError(
                f"{self.obj.name} is linked from another file and cannot be moved here. "
                "Make it local: Object > Relations > Make Local."
            )
        require_relative(self.obj)
        self._parts = [(child, _kind(child)) for child in self.obj.children if _kind(child)]
        self._count = len(mesh.vertices)
        self._had_keys = mesh.shape_keys is not None
        self._muted: list = []
        self._pinned = False
        self._cache_played = (False, False)
        self._shown = False

    @property
    def vertices(self) -> int:
        """How many vertices the mesh had when this began."""
        return self._count

    def attach(self) -> None:
        """Make the live key, and silence what an earlier bake left to move the same things."""
        self._had_keys = self.obj.data.shape_keys is not None
        if not self._had_keys:
            self.obj.shape_key_add(name="Basis", from_mix=False)
        self._key()
        self._muted = []
        owners = [self.obj, *(child for child, _ in self._parts), *(target.obj for target in self.targets.values())]
        for owner in owners:
            self._muted += mute_curves(owner, "delta_") + mute_bake(owner)
        keys = self.obj.data.shape_keys
        baked = baked_paths(keys)
        for key in keys.key_blocks:
            ours = key.name.startswith(BAKED_KEY_PREFIX) or value_path(key.name) in baked
            if ours and key.name != LIVE_KEY and not key.mute:
                key.mute = True
                self._muted.append(key)
        self._pinned, self.obj.show_only_shape_key = self.obj.show_only_shape_key, False
        if (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            self._cache_played = (cache.show_viewport, cache.show_render)
            cache.show_viewport = cache.show_render = False
        self._shown = True

    def write(self, frame: HeadFrame, flat: NDArray[np.float32] | None = None) -> None:
        """Show `frame`; what is being edited in Edit mode is left alone.

        Parameters
        ----------
        flat : (3 V,) float32, optional
            `as_keys_take_it(frame)`, where it was made beforehand.

        Raises
        ------
        HeadError
            Where the mesh was changed so that it can no longer be driven.
        """
        if self.obj.mode == "EDIT":
            return
        mesh = self.obj.data
        if len(mesh.vertices) != self.vertices or len(frame.vertices) != self.vertices:
            raise HeadError(f"{self.obj.name} was changed: its vertices are others now. Bind the landmarks again.")
        self._key().points.foreach_set("co", as_keys_take_it(frame) if flat is None else flat)
        mesh.update_tag()
        self.targets["head"].apply(
            frame.rotation if self.follow.rotation else None, frame.translation if self.follow.translation else None
        )
        for child, kind in self._parts:
            if kind not in self.targets:
                PoseTarget(child).apply(frame.jaw if kind == "jaw" else frame.gaze, None)
        for eye in ("eye_left", "eye_right"):
            if eye in self.targets:
                self.targets[eye].apply(frame.gaze, None)

    def detach(self, *, keep: bool) -> None:
        """End the showing; `keep` leaves the head as it is, with the live key, else all is as before."""
        if not self._shown:
            return
        self._shown = False
        for silenced in self._muted:
            silenced.mute = False
        self._muted = []
        if (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            cache.show_viewport, cache.show_render = self._cache_played
        if keep:
            return
        if (keys := self.obj.data.shape_keys) is not None and (key := keys.key_blocks.get(LIVE_KEY)) is not None:
            _remove(self.obj, key)
            if not self._had_keys and len(keys.key_blocks) == 1:
                self.obj.shape_key_clear()
        self.obj.show_only_shape_key = self._pinned
        for target in (*self.targets.values(), *(PoseTarget(child) for child, _ in self._parts)):
            with contextlib.suppress(ReferenceError):  # the user deleted it
                target.rest()

    def _key(self) -> bpy.types.ShapeKey:
        key = self.obj.data.shape_keys.key_blocks.get(LIVE_KEY)
        if key is None:
            key = self.obj.shape_key_add(name=LIVE_KEY, from_mix=False)
            key.value = 1.0
        return key


def as_keys_take_it(frame: HeadFrame) -> NDArray[np.float32]:
    """(3 V,) float32 of a frame's vertices, as the points of a shape key are set; touches nothing of Blender.

    Made by the thread that drives: OpenCV lets other threads run meanwhile, for which the main thread would wait.
    """
    return flat_in_blender(frame.vertices)


def _remove(obj: bpy.types.Object, key: bpy.types.ShapeKey) -> None:
    """Remove `key`, whatever mode `obj` is in, and leave the active key where it was."""
    active = obj.active_shape_key
    name = None if active is None or active == key else active.name
    obj.shape_key_remove(key)
    if name is not None:
        obj.active_shape_key_index = obj.data.shape_keys.key_blocks.find(name)


def _kind(child: bpy.types.Object) -> str:
    part = str(child.get(PART_PROPERTY, ""))
    return "jaw" if part in JAW_PARTS else part if part in EYE_PARTS else ""

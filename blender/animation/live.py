"""A head in the scene while it is puppeted: shown by one shape key, and put back as it was.

The rest shape lies in the basis key and is never written, so that whatever happens to a session (a crash, an undo, a
file saved in the middle) the mesh itself is safe.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadFrame
from ...core.errors import HeadError
from ..actions import Muted, baked_paths, mute_bake, mute_curves
from ..frames import flat_in_blender
from ..meshes import exists, mesh_of, read_vertices, write_vertices
from ..names import LIVE_PROPERTY, PART_PROPERTY
from .bake import EYE_PARTS, JAW_PARTS
from .bake_cache import MODIFIER
from .bake_keys import BAKED_KEY_PREFIX, require_relative, value_path
from .targets import PoseTarget

LIVE_KEY = "Facemime Live"
_HAD_KEYS, _MADE_KEYS = 1, 2
_TARGET_NAMES = {"head": "object or bone that takes the head's pose"} | {
    eye: f"object or bone that takes the gaze of the {eye.removeprefix('eye_')} eye" for eye in sorted(EYE_PARTS)
}


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
        self._name = self.obj.name
        self._parts = [(child, _kind(child)) for child in self.obj.children if _kind(child)]
        self._mesh = mesh
        self._count = len(mesh.vertices)
        self._muted: list[Muted] = []
        self._rest: NDArray[np.float32] | None = None
        self._pinned = False
        self._cache_played = (False, False)
        self._shown = False

    @property
    def vertices(self) -> int:
        """How many vertices the mesh had when this began."""
        return self._count

    @property
    def gone(self) -> bool:
        """Whether the head was deleted."""
        return not exists(self.obj)

    def attach(self) -> None:
        """Make the live key, and mute what an earlier bake left to move the same things; nothing if the head is gone.

        Raises
        ------
        HeadError
            If the mesh was replaced or changed so that it can no longer be driven.
        """
        if self.gone:
            return
        self._require_same_mesh()
        if not self._mesh.is_editmode:
            self._rest = read_vertices(self._mesh)
        if self._mesh.shape_keys is None:
            self.obj.shape_key_add(name="Basis", from_mix=False)
            self._mesh[LIVE_PROPERTY] = _MADE_KEYS
        elif LIVE_PROPERTY not in self._mesh:
            self._mesh[LIVE_PROPERTY] = _HAD_KEYS
        self._key().value = 1.0  # what Edit mode brings back of one that was removed is at 0
        self._muted = []
        targets = [target.obj for target in self.targets.values() if target.exists]
        for owner in dict.fromkeys([self.obj, *(child for child, _ in self._living_parts()), *targets]):
            self._muted += mute_curves(owner, "delta_") + mute_bake(owner)
        keys = self._mesh.shape_keys
        baked = baked_paths(keys)
        ours = [
            key.name
            for key in keys.key_blocks
            if key.name != LIVE_KEY and (key.name.startswith(BAKED_KEY_PREFIX) or value_path(key.name) in baked)
        ]
        self._muted += Muted.all_of([partial(_find_key, keys, name) for name in ours])
        self._pinned, self.obj.show_only_shape_key = self.obj.show_only_shape_key, False
        if (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            self._cache_played = (cache.show_viewport, cache.show_render)
            cache.show_viewport = cache.show_render = False
        self._shown = True

    def write(self, frame: HeadFrame, flat: NDArray[np.float32] | None = None) -> None:
        """Show `frame`; what is being edited in Edit mode is left alone, and so are parts that were deleted.

        Parameters
        ----------
        flat : (3 V,) float32, optional
            `as_keys_take_it(frame)`, where it was made beforehand.

        Raises
        ------
        HeadError
            If the mesh was changed so that it can no longer be driven, or an object or bone chosen under Pose is gone.
        """
        if self.obj.mode == "EDIT":
            return
        self._require_same_mesh()
        if len(frame.vertices) != self.vertices:
            raise _changed(self._name)
        for name, target in self.targets.items():
            if not target.exists:
                raise HeadError(
                    f"The {_TARGET_NAMES[name]} was deleted. Choose another one under Pose, or clear that field; then "
                    "start again."
                )
        self._key().points.foreach_set("co", as_keys_take_it(frame) if flat is None else flat)
        self._mesh.update_tag()
        self.targets["head"].apply(
            frame.rotation if self.follow.rotation else None, frame.translation if self.follow.translation else None
        )
        for child, kind in self._living_parts():
            if kind not in self.targets:
                PoseTarget(child).apply(frame.jaw if kind == "jaw" else frame.gaze, None)
        for eye in ("eye_left", "eye_right"):
            if eye in self.targets:
                self.targets[eye].apply(frame.gaze, None)

    def detach(self, *, keep: bool, blocks: bool = True) -> bool:
        """End the showing.

        Parameters
        ----------
        keep : bool
            Leave the head as it is, with the live key; otherwise all that is still there is put back.
        blocks : bool
            Whether data-blocks may be removed; not between two undo steps (`blender.undo`).

        Returns
        -------
        bool
            Whether one was, so that an undo step is due.
        """
        if not self._shown:
            return False
        self._shown = False
        for muted in self._muted:
            muted.unmute()
        self._muted = []
        if not self.gone and (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            cache.show_viewport, cache.show_render = self._cache_played
        if keep and exists(self._mesh):
            self._mesh.pop(LIVE_PROPERTY, None)
        if keep:
            return False
        removed = False
        if exists(self._mesh):
            # What nobody uses is not saved, and one undo step brings a deleted head back.
            deleted = self.gone and not self._mesh.users
            removed = clear_live(self._mesh, self.obj, self._rest, blocks=blocks and not deleted)
        if not self.gone and self.obj.data == self._mesh:
            self.obj.show_only_shape_key = self._pinned
        for target in (*self.targets.values(), *(PoseTarget(child) for child, _ in self._parts)):
            if target.exists:
                target.rest()
        return removed

    def _require_same_mesh(self) -> None:
        keys_deleted = self._shown and (self._mesh.shape_keys is None or _basis_lost(self._mesh))
        if self.obj.data != self._mesh or len(self._mesh.vertices) != self._count or keys_deleted:
            raise _changed(self._name)

    def _living_parts(self) -> list[tuple[bpy.types.Object, str]]:
        return [(child, kind) for child, kind in self._parts if exists(child)]

    def _key(self) -> bpy.types.ShapeKey:
        """The live key, made again if it alone was deleted."""
        key = self._mesh.shape_keys.key_blocks.get(LIVE_KEY)
        if key is None:
            key = self.obj.shape_key_add(name=LIVE_KEY, from_mix=False)
            key.value = 1.0
        return key


def clear_live(
    mesh: bpy.types.Mesh,
    obj: bpy.types.Object | None = None,
    rest: NDArray[np.float32] | None = None,
    *,
    blocks: bool = True,
) -> bool:
    """Take out of `mesh` what a live session shows in it, even one that ended long ago with a crash.

    Parameters
    ----------
    obj : optional
        One with that mesh, where one is known.
    rest : (V, 3), optional
        Where the vertices belong if the basis was deleted and the live key has become it.
    blocks : bool
        As for `LiveHeadObject.detach`.

    Returns
    -------
    bool
        Whether shape keys that were made for the session are gone, which is a data-block.
    """
    keys, made = mesh.shape_keys, mesh.get(LIVE_PROPERTY) == _MADE_KEYS
    lost = _basis_lost(mesh) and rest is not None
    if lost:
        keys.reference_key.points.foreach_set("co", flat_in_blender(rest))
    with _object_of(mesh, obj) as holder:
        if keys is not None and LIVE_KEY in keys.key_blocks and (blocks or len(keys.key_blocks) > 1):
            _remove(holder, keys.key_blocks[LIVE_KEY])
        if blocks and made and mesh.shape_keys is not None and len(mesh.shape_keys.key_blocks) == 1:
            holder.shape_key_clear()
    if lost and mesh.shape_keys is None and not mesh.is_editmode:
        write_vertices(mesh, rest)
    if blocks or not made:
        mesh.pop(LIVE_PROPERTY, None)
    return keys is not None and mesh.shape_keys is None


def clear_all_live(*, blocks: bool) -> bool:
    """Take out of all meshes what a session showed that no longer runs: in a file that was opened, or a step undone.

    Returns whether a data-block is gone, as `clear_live`.
    """
    left = [mesh for mesh in bpy.data.meshes if LIVE_PROPERTY in mesh and mesh.library is None]
    gone = [clear_live(mesh, blocks=blocks) for mesh in left]
    return any(gone)


def require_one_left(heads: Sequence[LiveHeadObject]) -> None:
    """Raise HeadError if all of `heads` were deleted."""
    if all(shown.gone for shown in heads):
        raise HeadError("The head was deleted. Add or select another one, and start again.")


def as_keys_take_it(frame: HeadFrame) -> NDArray[np.float32]:
    """(3 V,) float32 of a frame's vertices, as the points of a shape key are set; touches nothing of Blender.

    Made by the thread that drives: OpenCV lets other threads run meanwhile, for which the main thread would wait.
    """
    return flat_in_blender(frame.vertices)


def _basis_lost(mesh: bpy.types.Mesh) -> bool:
    """Whether the basis was deleted: Blender makes the next key the basis then, and that may be the live one."""
    keys = mesh.shape_keys
    return keys is not None and keys.reference_key.name == LIVE_KEY


def _find_key(keys: bpy.types.Key, name: str) -> bpy.types.ShapeKey | None:
    """The key of that name. Not a bound `keys.key_blocks.get`: Blender invalidates data-blocks, but no collections."""
    return keys.key_blocks.get(name)


def _remove(obj: bpy.types.Object, key: bpy.types.ShapeKey) -> None:
    """Remove `key`, whatever mode `obj` is in, and leave the active key where it was."""
    active = obj.active_shape_key
    name = None if active is None or active == key else active.name
    obj.shape_key_remove(key)
    if name is not None:
        obj.active_shape_key_index = obj.data.shape_keys.key_blocks.find(name)


@contextlib.contextmanager
def _object_of(mesh: bpy.types.Mesh, obj: bpy.types.Object | None) -> Iterator[bpy.types.Object]:
    """An object with `mesh`, through which alone its shape keys can be removed: `obj`, or one made for the moment."""
    if obj is not None and exists(obj) and obj.data == mesh:
        yield obj
        return
    stand_in = bpy.data.objects.new("Facemime", mesh)
    try:
        yield stand_in
    finally:
        bpy.data.objects.remove(stand_in)


def _changed(name: str) -> HeadError:
    return HeadError(f"The mesh of {name} has changed. Undo that change, or bind the landmarks again, and start again.")


def _kind(child: bpy.types.Object) -> str:
    part = str(child.get(PART_PROPERTY, ""))
    return "jaw" if part in JAW_PARTS else part if part in EYE_PARTS else ""

"""A mesh during a session: displayed by one shape key, and restored at the end.

The rest shape is in the Basis and is never written, so that the mesh itself is safe whatever happens to the session (a
crash, an undo, a file saved while it runs).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ..actions import baked_paths
from ..characters import Member
from ..frames import flat_in_blender
from ..meshes import exists, mesh_of, read_vertices, write_vertices
from ..muting import Muted
from ..names import LIVE_PROPERTY
from .bake_cache import MODIFIER
from .bake_keys import BAKED_KEY_PREFIX, require_relative, value_path

LIVE_KEY = "Facemime Live"
_HAD_KEYS, _MADE_KEYS = 1, 2


class LiveMesh:
    """A mesh that displays a performance.

    Parameters
    ----------
    member : Member
        The mesh, and which vertices of the head it has.

    Raises
    ------
    HeadError
        If the object is not a mesh, is linked, or has absolute shape keys.
    """

    def __init__(self, member: Member) -> None:
        self.member, self.obj = member, member.obj
        mesh = mesh_of(self.obj)
        if mesh.library is not None or self.obj.library is not None:
            raise HeadError(
                f"{self.obj.name} is linked from another file and cannot be moved here. "
                "Make it local: Object > Relations > Make Local."
            )
        require_relative(self.obj)
        self._name = self.obj.name
        self._mesh = mesh
        self._count = len(mesh.vertices)
        self._rest: NDArray[np.float32] | None = None
        self._muted: list[Muted] = []
        self._pinned = False
        self._cache_played = (False, False)
        self._shown = False

    @property
    def gone(self) -> bool:
        """Whether the object was deleted."""
        return not exists(self.obj)

    def attach(self) -> None:
        """Add the live shape key, and mute the keys and the cache of an earlier bake.

        Raises
        ------
        HeadError
            If the mesh was replaced or changed so that it can no longer be driven.
        """
        self.require_same()
        if not self._mesh.is_editmode:
            self._rest = read_vertices(self._mesh)
        if self._mesh.shape_keys is None:
            self.obj.shape_key_add(name="Basis", from_mix=False)
            self._mesh[LIVE_PROPERTY] = _MADE_KEYS
        elif LIVE_PROPERTY not in self._mesh:
            self._mesh[LIVE_PROPERTY] = _HAD_KEYS
        self._key().value = 1.0  # Edit Mode restores a key that was removed, with value 0
        keys = self._mesh.shape_keys
        baked = baked_paths(keys)
        names = [
            key.name
            for key in keys.key_blocks
            if key.name != LIVE_KEY and (key.name.startswith(BAKED_KEY_PREFIX) or value_path(key.name) in baked)
        ]
        self._muted = Muted.all_of([partial(_find_key, keys, name) for name in names])
        self._pinned, self.obj.show_only_shape_key = self.obj.show_only_shape_key, False
        if (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            self._cache_played = (cache.show_viewport, cache.show_render)
            cache.show_viewport = cache.show_render = False
        self._shown = True

    def write(self, flat: NDArray[np.float32]) -> None:
        """Display positions, (3 V,) float32 as `Member.local` returns them; does nothing in Edit Mode.

        Raises
        ------
        HeadError
            If the mesh was changed so that it can no longer be driven.
        """
        if self.obj.mode == "EDIT":
            return
        self.require_same()
        self._key().points.foreach_set("co", flat)
        self._mesh.update_tag()

    def detach(self, *, keep: bool, blocks: bool) -> bool:
        """Stop displaying; parameters and result are as for `LiveHeadObject.detach`."""
        if not self._shown:
            return False
        self._shown = False
        for muted in self._muted:
            muted.unmute()
        self._muted = []
        if not self.gone and (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            cache.show_viewport, cache.show_render = self._cache_played
        if keep:
            if exists(self._mesh):
                self._mesh.pop(LIVE_PROPERTY, None)
            return False
        removed = False
        if exists(self._mesh):
            # A mesh without users is not saved, and a single undo step restores a deleted head.
            deleted = self.gone and not self._mesh.users
            removed = clear_live(self._mesh, self.obj, self._rest, blocks=blocks and not deleted)
        if not self.gone and self.obj.data == self._mesh:
            self.obj.show_only_shape_key = self._pinned
        return removed

    def require_same(self) -> None:
        """Raise HeadError if the mesh was replaced, or changed so that it can no longer be driven."""
        keys_deleted = self._shown and (self._mesh.shape_keys is None or _basis_lost(self._mesh))
        if self.obj.data != self._mesh or len(self._mesh.vertices) != self._count or keys_deleted:
            raise changed(self._name)

    def _key(self) -> bpy.types.ShapeKey:
        """Return the live shape key, which is added again if the user deleted it."""
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
    """Remove what a live session displays in a mesh, even one that ended earlier in a crash.

    Parameters
    ----------
    mesh : bpy.types.Mesh
    obj : bpy.types.Object, optional
        An object with that mesh, if known.
    rest : (V, 3) float32, optional
        Vertices at rest in the head frame, used if the Basis was deleted so that the live key has become it.
    blocks : bool
        As for `LiveHeadObject.detach`.

    Returns
    -------
    bool
        Whether the data-block of shape keys that was created for the session was removed.
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
    """Remove from all meshes what a session that has ended displayed, after a file was loaded or a step undone.

    Parameters
    ----------
    blocks : bool
        As for `LiveHeadObject.detach`.

    Returns
    -------
    bool
        Whether a data-block was removed, as for `clear_live`.
    """
    meshes = [mesh for mesh in bpy.data.meshes if LIVE_PROPERTY in mesh and mesh.library is None]
    removed = [clear_live(mesh, blocks=blocks) for mesh in meshes]
    return any(removed)


def _basis_lost(mesh: bpy.types.Mesh) -> bool:
    """Return whether the Basis was deleted, so that the live key has become the reference key."""
    keys = mesh.shape_keys
    return keys is not None and keys.reference_key.name == LIVE_KEY


def _find_key(keys: bpy.types.Key, name: str) -> bpy.types.ShapeKey | None:
    """Return the key of that name. A bound `keys.key_blocks.get` would not notice that the data-block was deleted."""
    return keys.key_blocks.get(name)


def _remove(obj: bpy.types.Object, key: bpy.types.ShapeKey) -> None:
    """Remove `key` in any mode of `obj`, keeping the active key."""
    active = obj.active_shape_key
    name = None if active is None or active == key else active.name
    obj.shape_key_remove(key)
    if name is not None:
        obj.active_shape_key_index = obj.data.shape_keys.key_blocks.find(name)


@contextlib.contextmanager
def _object_of(mesh: bpy.types.Mesh, obj: bpy.types.Object | None) -> Iterator[bpy.types.Object]:
    """Yield an object with `mesh`, without which its shape keys cannot be removed: `obj`, or a temporary one."""
    if obj is not None and exists(obj) and obj.data == mesh:
        yield obj
        return
    stand_in = bpy.data.objects.new("Facemime", mesh)
    try:
        yield stand_in
    finally:
        bpy.data.objects.remove(stand_in)


def changed(name: str) -> HeadError:
    """Return the error for a mesh that can no longer be driven."""
    return HeadError(
        f"The mesh of {name} has changed. Undo that change, or find the face again; then restart the puppet."
    )

"""A mesh during a session: displayed by one shape key, or by the values of its own, and restored at the end.

The rest shape is in the Basis and is never written, so that the mesh itself is safe whatever happens to the session (a
crash, an undo, a file saved while it runs).
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ..actions import baked_paths
from ..characters import Member
from ..frames import flat_in_blender
from ..meshes import exists, keys_of, mesh_of, read_vertices, write_vertices
from ..names import BAKED_KEY_PREFIX, LIVE_PROPERTY, VALUES_PROPERTY
from ..own_pose import release_live
from ..switching import bake_of_keys, keys
from .aside import display_of, restore, restore_all, set_aside
from .bake_keys import require_relative, value_path
from .live_controls import clear_all_controls
from .live_keys import LiveValues, clear_values

LIVE_KEY = "Facemime Live"
_HAD_KEYS, _MADE_KEYS = 1, 2


class LiveMesh:
    """A mesh that displays a performance.

    Raises HeadError if the object is not a mesh, is linked, or has absolute shape keys.
    """

    def __init__(self, member: Member) -> None:
        self.member, self.obj = member, member.obj
        mesh = mesh_of(self.obj)
        if mesh.library is not None or self.obj.library is not None:
            raise HeadError(
                "{name} is linked from another file and cannot be moved here. "
                "Make it local: Object > Relations > Make Local.",
                name=self.obj.name,
            )
        require_relative(self.obj)
        self._name: str = self.obj.name
        self.mesh: bpy.types.Mesh = mesh
        self._count: int = len(mesh.vertices)
        self._rest: NDArray[np.float32] | None = None
        self._values: LiveValues | None = None
        self._shown: bool = False

    @property
    def gone(self) -> bool:
        """Whether the object was deleted."""
        return not exists(self.obj)

    def attach(self, values: LiveValues | None = None, *, by_rig: bool = False) -> None:
        """Add the live shape key, or take over the values of the mesh's own keys, or leave them to the rig.

        The keys and the cache of an earlier bake are muted. Raises HeadError if the mesh was replaced or changed so
        that it can no longer be driven.
        """
        self.require_same()
        self._values = values
        if values is None:
            self._add_live_key()
        if (own := self.mesh.shape_keys) is not None:
            baked = baked_paths(own) if values is None else set()
            names = [key.name for key in own.key_blocks if key.name.startswith(BAKED_KEY_PREFIX)]
            names += [key.name for key in own.key_blocks if value_path(key.name) in baked]
            set_aside(own, keys(own, [name for name in dict.fromkeys(names) if name != LIVE_KEY]))
            set_aside(own, bake_of_keys(own) if by_rig else ())
        if values is not None:
            values.attach()
        set_aside(self.obj, display_of(self.obj))
        self._shown = True

    def _add_live_key(self) -> None:
        if not self.mesh.is_editmode:
            self._rest = read_vertices(self.mesh)
        if self.mesh.shape_keys is None:
            self.obj.shape_key_add(name="Basis", from_mix=False)
            self.mesh[LIVE_PROPERTY] = _MADE_KEYS
        elif LIVE_PROPERTY not in self.mesh:
            self.mesh[LIVE_PROPERTY] = _HAD_KEYS
        self._key().value = 1.0  # Edit Mode restores a key that was removed, with value 0

    def write(self, flat: NDArray[np.float32], amounts: NDArray[np.float64]) -> None:
        """Display positions (3 V,) from `Member.local`, and values of the shape keys (K,); does nothing in Edit Mode.

        Raises HeadError if the mesh was changed so that it can no longer be driven.
        """
        if self.obj.mode == "EDIT":
            return
        self.require_same()
        if self._values is not None:
            self._values.write(amounts)
            return
        self._key().points.foreach_set("co", flat)
        self.mesh.update_tag()

    def detach(self, *, keep: bool, blocks: bool) -> bool:
        """Stop displaying; parameters and result are as for `LiveHeadObject.detach`."""
        if not self._shown:
            return False
        self._shown = False
        if self._values is not None:
            self._values.detach(keep=keep)
        if not self.gone:
            restore(self.obj)
        if exists(self.mesh) and self.mesh.shape_keys is not None:
            restore(self.mesh.shape_keys)
        if keep:
            if exists(self.mesh):
                self.mesh.pop(LIVE_PROPERTY, None)
            return False
        if not exists(self.mesh) or self._values is not None:
            return False
        # A mesh without users is not saved, and a single undo step restores a deleted head.
        deleted = self.gone and not self.mesh.users
        return _clear_live(self.mesh, self.obj, self._rest, blocks=blocks and not deleted)

    @property
    def left_in_file(self) -> bool:
        """Whether the open file has the mesh as a session displays it, as after undoing a step of the session."""
        own = None if self.gone else mesh_of(self.obj).shape_keys
        return not self.gone and (LIVE_PROPERTY in mesh_of(self.obj) or (own is not None and VALUES_PROPERTY in own))

    def require_same(self) -> None:
        """Raise HeadError if the mesh was replaced, or changed so that it can no longer be driven."""
        if not exists(self.mesh):
            raise changed(self._name)
        keys_deleted = self._shown and (self.mesh.shape_keys is None or _basis_lost(self.mesh))
        if self.obj.data != self.mesh or len(self.mesh.vertices) != self._count or keys_deleted:
            raise changed(self._name)

    def _key(self) -> bpy.types.ShapeKey:
        """Return the live shape key, which is added again if the user deleted it."""
        own = self.mesh.shape_keys
        assert own is not None, "require_same checks it"
        key = own.key_blocks.get(LIVE_KEY)
        if key is None:
            key = self.obj.shape_key_add(name=LIVE_KEY, from_mix=False)
            key.value = 1.0
        return key


def _clear_live(
    mesh: bpy.types.Mesh,
    obj: bpy.types.Object | None = None,
    rest: NDArray[np.float32] | None = None,
    *,
    blocks: bool = True,
) -> bool:
    """Remove what a live session displays in a mesh, even one that ended earlier in a crash.

    Returns whether the data-block of shape keys that was created for the session was removed, for which `blocks` is as
    in `LiveHeadObject.detach`. `rest` (V, 3) are vertices at rest in the head frame, used if the Basis was deleted so
    that the live key has become it.
    """
    keys, made = mesh.shape_keys, mesh.get(LIVE_PROPERTY) == _MADE_KEYS
    lost_rest = rest if _basis_lost(mesh) else None
    if lost_rest is not None and keys is not None:
        keys.reference_key.points.foreach_set("co", flat_in_blender(lost_rest))
    with _object_of(mesh, obj) as holder:
        if keys is not None and LIVE_KEY in keys.key_blocks and (blocks or len(keys.key_blocks) > 1):
            _remove(holder, keys.key_blocks[LIVE_KEY])
        if blocks and made and mesh.shape_keys is not None and len(mesh.shape_keys.key_blocks) == 1:
            holder.shape_key_clear()
    if lost_rest is not None and mesh.shape_keys is None and not mesh.is_editmode:
        write_vertices(mesh, lost_rest)
    if blocks or not made:
        mesh.pop(LIVE_PROPERTY, None)
    mesh.update_tag()
    return keys is not None and mesh.shape_keys is None


def clear_all_live(*, blocks: bool, but: Collection[bpy.types.ID] = ()) -> bool:
    """Put at rest what sessions have left as they displayed it, and return whether a data-block was removed.

    This is for files that were loaded, steps that were undone, and objects that were duplicated. `but` has the objects,
    meshes and shape keys of the running session; `blocks` is as for `LiveHeadObject.detach`.
    """
    restore_all(but)
    clear_all_controls(but)
    release_live(but)
    for own in bpy.data.shape_keys:
        if VALUES_PROPERTY in own and own.library is None and own not in but:
            clear_values(own)
    meshes = [mesh for mesh in bpy.data.meshes if LIVE_PROPERTY in mesh and mesh.library is None and mesh.users]
    removed = [_clear_live(mesh, blocks=blocks) for mesh in meshes if mesh not in but]
    return any(removed)


def _basis_lost(mesh: bpy.types.Mesh) -> bool:
    """Return whether the Basis was deleted, so that the live key has become the reference key."""
    keys = mesh.shape_keys
    return keys is not None and keys.reference_key.name == LIVE_KEY


def _remove(obj: bpy.types.Object, key: bpy.types.ShapeKey) -> None:
    """Remove `key` in any mode of `obj`, keeping the active key."""
    active = obj.active_shape_key
    name = None if active is None or active == key else active.name
    obj.shape_key_remove(key)
    if name is not None:
        obj.active_shape_key_index = keys_of(obj).key_blocks.find(name)


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
        "The mesh of {name} has changed. Undo that change, or find the face again; then restart the puppet.", name=name
    )

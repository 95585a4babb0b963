"""Heads during a session: displayed by one shape key, and restored at the end.

The rest shape is in the Basis and is never written, so that the mesh itself is safe whatever happens to the session (a
crash, an undo, a file saved in the middle).
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
from .bake import EYE_PARTS, JAW_PARTS, has_tongue, show_tongue
from .bake_cache import MODIFIER
from .bake_keys import BAKED_KEY_PREFIX, require_relative, value_path
from .targets import PoseTarget

LIVE_KEY = "Facemime Live"
_HAD_KEYS, _MADE_KEYS = 1, 2
_TARGET_LABELS = {"head": "Pose Object", "eye_left": "Left Eye", "eye_right": "Right Eye"}
"""Labels of the fields in which targets are chosen."""


@dataclass
class Follow:
    """Whether a head follows the performer's rotation and translation."""

    rotation: bool = True
    translation: bool = False


@dataclass(eq=False)
class LiveHeadObject:
    """A head that displays a performance.

    Parameters
    ----------
    obj : bpy.types.Object
        A mesh that can be driven.
    targets : mapping
        "head", and optionally "eye_left" and "eye_right", which replace the eyes of `obj`.
    follow : Follow, optional

    Raises
    ------
    HeadError
        If the object is not a mesh, is linked, or has absolute shape keys.
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
        """Vertex count at the start of the session."""
        return self._count

    @property
    def gone(self) -> bool:
        """Whether the head was deleted."""
        return not exists(self.obj)

    def attach(self) -> None:
        """Add the live shape key, and mute an earlier bake of the head; does nothing if the head was deleted.

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
        self._key().value = 1.0  # Edit Mode restores a key that was removed, with value 0
        self._muted = []
        targets = [target.obj for target in self.targets.values() if target.exists]
        for owner in dict.fromkeys([self.obj, *(child for child, _ in self._living_parts()), *targets]):
            self._muted += mute_curves(owner, "delta_") + mute_bake(owner)
        for tongue in filter(has_tongue, (child for child, _ in self._living_parts())):
            self._muted += mute_bake(tongue.data.shape_keys)
        keys = self._mesh.shape_keys
        baked = baked_paths(keys)
        names = [
            key.name
            for key in keys.key_blocks
            if key.name != LIVE_KEY and (key.name.startswith(BAKED_KEY_PREFIX) or value_path(key.name) in baked)
        ]
        self._muted += Muted.all_of([partial(_find_key, keys, name) for name in names])
        self._pinned, self.obj.show_only_shape_key = self.obj.show_only_shape_key, False
        if (cache := self.obj.modifiers.get(MODIFIER)) is not None:
            self._cache_played = (cache.show_viewport, cache.show_render)
            cache.show_viewport = cache.show_render = False
        self._shown = True

    def write(self, frame: HeadFrame, flat: NDArray[np.float32] | None = None) -> None:
        """Display a frame; does nothing in Edit Mode, and skips parts that were deleted.

        Parameters
        ----------
        frame : HeadFrame
        flat : (3 V,) float32, optional
            `flatten_for_keys(frame)`, if it is already computed.

        Raises
        ------
        HeadError
            If the mesh was changed so that it can no longer be driven, or an object or bone that takes the pose was
            deleted.
        """
        if self.obj.mode == "EDIT":
            return
        self._require_same_mesh()
        if len(frame.vertices) != self.vertices:
            raise _changed(self._name)
        for name, target in self.targets.items():
            if not target.exists:
                label = _TARGET_LABELS[name]
                raise HeadError(
                    f"The object or bone chosen as {label} was deleted. Choose another one in Puppet > "
                    "Head and Eyes, or clear that field, and start again."
                )
        self._key().points.foreach_set("co", flatten_for_keys(frame) if flat is None else flat)
        self._mesh.update_tag()
        self.targets["head"].apply(
            frame.rotation if self.follow.rotation else None, frame.translation if self.follow.translation else None
        )
        for child, kind in self._living_parts():
            if kind not in self.targets:
                PoseTarget(child).apply(frame.jaw if kind == "jaw" else frame.gaze[EYE_PARTS.index(kind)], None)
            show_tongue(child, frame.tongue)
        for side, eye in enumerate(EYE_PARTS):
            if eye in self.targets:
                self.targets[eye].apply(frame.gaze[side], None)

    def detach(self, *, keep: bool, blocks: bool = True) -> bool:
        """Stop displaying frames.

        Parameters
        ----------
        keep : bool
            Whether to keep the pose and the live shape key; otherwise everything that still exists is restored.
        blocks : bool
            Whether data-blocks may be removed; not allowed between two undo steps (`blender.undo`).

        Returns
        -------
        bool
            Whether a data-block was removed, so that an undo step must be pushed.
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
            # A mesh without users is not saved, and a single undo step restores a deleted head.
            deleted = self.gone and not self._mesh.users
            removed = clear_live(self._mesh, self.obj, self._rest, blocks=blocks and not deleted)
        if not self.gone and self.obj.data == self._mesh:
            self.obj.show_only_shape_key = self._pinned
        for target in (*self.targets.values(), *(PoseTarget(child) for child, _ in self._parts)):
            if target.exists:
                target.rest()
        for child, _ in self._living_parts():
            show_tongue(child, 0.0)
        return removed

    def _require_same_mesh(self) -> None:
        keys_deleted = self._shown and (self._mesh.shape_keys is None or _basis_lost(self._mesh))
        if self.obj.data != self._mesh or len(self._mesh.vertices) != self._count or keys_deleted:
            raise _changed(self._name)

    def _living_parts(self) -> list[tuple[bpy.types.Object, str]]:
        return [(child, kind) for child, kind in self._parts if exists(child)]

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


def require_one_left(heads: Sequence[LiveHeadObject]) -> None:
    """Raise HeadError if all of `heads` were deleted."""
    if all(shown.gone for shown in heads):
        raise HeadError("The head was deleted. Add or select another one, and restart the puppet.")


def flatten_for_keys(frame: HeadFrame) -> NDArray[np.float32]:
    """Return the vertices of a frame as the (3 V,) float32 array that sets the points of a shape key.

    It does not touch Blender's data, and runs in the worker's thread to keep the main thread free.
    """
    return flat_in_blender(frame.vertices)


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


def _changed(name: str) -> HeadError:
    return HeadError(
        f"The mesh of {name} has changed. Undo that change, or bind the landmarks again; then restart the puppet."
    )


def _kind(child: bpy.types.Object) -> str:
    part = str(child.get(PART_PROPERTY, ""))
    return "jaw" if part in JAW_PARTS else part if part in EYE_PARTS else ""

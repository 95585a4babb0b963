"""Sets of shape keys, such as ARKit's face units, added to any head."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.expression_keys import expression_keys, refined_keys
from ...core.bake.key_quality import KeyQuality, findings, key_qualities
from ...core.bake.key_sets import KEY_SETS, KeySet
from ...core.errors import HeadError, Message
from ...core.face.names import COEFFICIENT_INDEX
from ...core.heads.built_in import HEAD_FILE, WOMAN_FILE, HeadPart, load_head
from ...core.heads.rig import HeadRig
from ...core.takes.take import Take
from ..characters import members_of
from ..frames import to_blender
from ..meshes import keys_of, mesh_of, object_of, read_vertices, require_own
from ..names import PART_PROPERTY
from ..rigs import read_rig
from ..work import Task, Work, do_at_once

_MAKING = 0.7
"""Share of the time that making the keys takes; the rest is for measuring them."""
_REFINING = 0.4
"""Share of the time, the first part of that, in which takes refine the keys."""
_STILL = 1e-5
"""Motion relative to the eye distance below which a mesh other than the head is still and gets no keys."""

_RESTS = 1e-4
"""Motion in metres up to which a part of the built-in head gets no keys."""


@dataclass(frozen=True)
class MadeKeys:
    """The keys added to a head.

    Attributes
    ----------
    added : int
        Keys of the head that were added, or existed without a motion.
    kept : tuple of str
        Those that existed already, with a motion.
    qualities : list of KeyQuality
        Of those that were added.
    takes : int
        Number of takes that refined them.
    """

    added: int
    kept: tuple[str, ...]
    qualities: list[KeyQuality]
    takes: int = 0

    def summary(self) -> str:
        """Return the numbers of keys as text."""
        if self.takes:
            return Message(
                "{added} shape keys added, {kept} kept; takes that refined them: {takes}",
                added=self.added,
                kept=len(self.kept),
                takes=self.takes,
            )
        return Message("{added} shape keys added, {kept} kept", added=self.added, kept=len(self.kept))

    @property
    def findings(self) -> list[Message]:
        """Warnings about how well the keys close the eyes and lips, and about intersections."""
        return findings(self.qualities)


def make_expression_keys(
    obj: bpy.types.Object | None, keys: KeySet = KEY_SETS["arkit"], takes: Sequence[Take] = ()
) -> MadeKeys:
    """Add a set of shape keys at once; parameters, result and errors are those of `making_expression_keys`."""
    return do_at_once(making_expression_keys(obj, keys, takes))


def making_expression_keys(obj: bpy.types.Object | None, keys: KeySet, takes: Sequence[Take] = ()) -> Work[MadeKeys]:
    """Add a set of shape keys to all meshes of a head that they move.

    Existing keys of these names are kept, unless they move no vertex of the head: some exporters add names without
    motion. Keys of ARKit are refined by the takes that have a face. Raises HeadError if the object is not a head, a
    mesh is linked from another file, or its shape keys are absolute.
    """
    obj = object_of(obj)
    mesh_of(obj)
    members = members_of(obj)
    moved = {member.obj for member in members}
    attached = [
        child for child in obj.children if child.type == "MESH" and PART_PROPERTY in child and child not in moved
    ]
    for part in (*(member.obj for member in members), *attached):
        require_own(mesh_of(part))
        if (found := mesh_of(part).shape_keys) is not None and not found.use_relative:
            raise HeadError("The shape keys of {name} are absolute. Enable Relative first.", name=part.name)
    rig = read_rig(obj)
    shown = [take for take in takes if take.found.any()] if set(keys.names) <= set(COEFFICIENT_INDEX) else []
    refining = _REFINING if shown else 0.0
    made = Task(lambda: expression_keys(rig, keys, progress, refine))

    def progress(share: float) -> None:
        made.done = refining + (_MAKING - refining) * share

    def refine(skin: HeadRig, motions: NDArray[np.float32]) -> NDArray[np.float32]:
        return refined_keys(skin, keys.names, motions, shown, refined) if shown else motions

    def refined(share: float) -> None:
        made.done = refining * share

    names, motions = yield made
    qualities = yield Task(lambda: key_qualities(rig, keys, motions), _MAKING)
    moving = _moving(moved, names, _STILL * rig.eye_distance)
    added: list[str] = []
    for member in members:
        if member.obj != obj and np.abs(motions[:, member.part]).max() < _STILL * rig.eye_distance:
            continue
        new = add_keys(member.obj, names, member.local_offsets(motions), moving)
        added = new if member.obj == obj else added
    by_parts = dict.fromkeys(names, 0.0)
    for child in attached:
        for name, moved_by in _add_to_part(child, keys, moving).items():
            by_parts[name] = max(by_parts[name], moved_by / rig.eye_distance)
    own = [replace(q, moved=max(q.moved, by_parts[q.name])) for q in qualities if q.name in added]
    return MadeKeys(len(added), tuple(name for name in names if name not in added), own, len(shown))


def _moving(meshes: Iterable[bpy.types.Object], names: Sequence[str], still: float) -> set[str]:
    """Names of the shape keys that move a vertex of some mesh by more than `still`, in its unit."""
    found = set()
    for keys in (keys_of(mesh) for mesh in meshes if mesh_of(mesh).shape_keys is not None):
        rest = _places(keys.reference_key)
        for name in names:
            key = keys.key_blocks.get(name)
            if key is not None and name not in found and np.abs(_places(key) - rest).max(initial=0.0) > still:
                found.add(name)
    return found


def _places(key: bpy.types.ShapeKey) -> NDArray[np.float32]:
    out = np.empty(3 * len(key.points), dtype=np.float32)
    key.points.foreach_get("co", out)
    return out


def add_keys(obj: bpy.types.Object, names: Sequence[str], offsets: NDArray[Any], moving: Container[str]) -> list[str]:
    """Add keys with displacements (K, V, 3) in the axes of the mesh, except for existing ones that are `moving`.

    Return the names of those that were added or filled.
    """
    if mesh_of(obj).shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)
    keys = keys_of(obj)
    rest = _places(keys.reference_key)
    written = [
        (name, row)
        for name, row in zip(names, offsets, strict=True)
        if name not in keys.key_blocks or (name not in moving and row.any())
    ]
    for name, row in written:
        key = keys.key_blocks.get(name)
        if key is None:
            key = obj.shape_key_add(name=name, from_mix=False)
            key.value = 0.0  # since Blender 5.0 the default is 1
        key.points.foreach_set("co", rest + row.reshape(-1))
    return [name for name, _ in written]


def _part_of(obj: bpy.types.Object) -> HeadPart | None:
    """The part that an object was made of; None if it was changed into something else."""
    rest = read_vertices(mesh_of(obj))
    parts = [part for file in (HEAD_FILE, WOMAN_FILE) for part in load_head(file).parts]
    alike = [part for part in parts if part.name == obj[PART_PROPERTY] and len(part.vertices) == len(rest)]
    return min(alike, key=lambda part: float(np.ptp(part.vertices - rest, axis=0).max()), default=None)


def _add_to_part(obj: bpy.types.Object, keys: KeySet, moving: Container[str]) -> dict[str, float]:
    """Add those keys of a set that move it to an eye, the teeth or the tongue of a built-in head.

    Return the largest displacement of a vertex in each key, in metres.
    """
    part = _part_of(obj)
    if part is None:
        return {}
    offsets = np.einsum("ku,uvc->kvc", keys.mixtures, part.units)
    if np.abs(offsets).max() > _RESTS:
        add_keys(obj, keys.names, np.ascontiguousarray(to_blender(offsets), dtype=np.float32), moving)
    return dict(zip(keys.names, np.linalg.norm(offsets, axis=2).max(axis=1).tolist(), strict=True))

"""Bakes to shape keys: new ones from a motion basis, or values of existing ones; which keys drivers move, and the shape
in which a character stands.

Characters are often one mesh with keys for each person or age, whose values stay. What replaces the shape, or is
compared with it, has to contain them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.bezier import BezierCurve
from ...core.bake.curves import fit_key_curves
from ...core.errors import HeadError
from ...core.heads.key_presets import ESSENTIAL, best_preset, curve_groups, known_expressions
from ..actions import Curve, remove_bake, remove_curves, write_curves
from ..characters import Member, head_of, members_of
from ..fcurves import CharacterAction, curves_in, drivers_of, is_layer
from ..frames import from_blender
from ..meshes import group_weights, key_names, key_offsets, key_points, keys_of, make_room, mesh_of, read_vertices
from ..muting import Silenced, keyed_paths, varying_paths
from ..names import BAKED_KEY_PREFIX, PART_PROPERTY

RESIDUAL = "Residual"
"""Name of the group of curves, and of the keys after their prefix, for what named keys cannot show."""
_KEY_BLOCKS = "key_blocks["
"""What the data path of a shape key contains, from its data-block, its mesh or its object."""


def family_keys(members: Sequence[Member]) -> set[bpy.types.Key]:
    """Return the data-blocks of the shape keys of a head."""
    return {keys for member in members if (keys := mesh_of(member.obj).shape_keys) is not None}


def following_paths(keys: bpy.types.Key, family: Collection[bpy.types.Key]) -> set[str]:
    """Return the data paths of shape keys of a mesh whose drivers make them follow keys of a head.

    Lashes, brows and teeth often have the keys of the head, driven by these, and correctives depend on other keys.
    `family` are the keys of all meshes of the head.
    """
    return {driver.data_path for driver in _playing(keys) if _reads(driver, family)}


def moved_paths(keys: bpy.types.Key, family: Collection[bpy.types.Key]) -> set[str]:
    """Return the data paths of shape keys of a mesh with drivers that follow something else that is animated, as bones.

    Parameters are as for `following_paths`.
    """
    return {
        driver.data_path
        for driver in _playing(keys)
        if not _reads(driver, family) and any(keyed_paths(target.id) for target in _targets(driver) if target.id)
    }


def _playing(keys: bpy.types.Key) -> list[bpy.types.FCurve]:
    return [driver for driver in drivers_of(keys) if not driver.mute]


def _reads(driver: bpy.types.FCurve, family: Collection[bpy.types.Key]) -> bool:
    return any(_KEY_BLOCKS in target.data_path and _keys_of(target.id) in family for target in _targets(driver))


def _targets(driver: bpy.types.FCurve) -> list[bpy.types.DriverTarget]:
    variables = () if driver.driver is None else driver.driver.variables
    return [target for variable in variables for target in variable.targets]


def _keys_of(block: bpy.types.ID | None) -> bpy.types.Key | None:
    """Return the shape keys to which a path leads from their own data-block, their mesh or its object."""
    if isinstance(block, bpy.types.Object):
        block = block.data
    return block if isinstance(block, bpy.types.Key) else getattr(block, "shape_keys", None)


def standing_vertices(obj: bpy.types.Object, without: Collection[str] = ()) -> NDArray[np.float32]:
    """Return the vertices of a mesh with the user's keys whose values do not change, (V, 3) in the head frame.

    The keys that are named in `without` do not count.
    """
    vertices, keys = read_vertices(mesh_of(obj)), mesh_of(obj).shape_keys
    if keys is None or not keys.use_relative:
        return vertices
    moving = varying_paths(keys) | moved_paths(keys, family_keys(members_of(head_of(obj))) | {keys})
    for name in key_names(obj):
        block = keys.key_blocks[name]
        if block.value and not block.mute and name not in without and value_path(name) not in moving:
            vertices = vertices + np.float32(block.value) * from_blender(scaled_offsets(obj, block))
    return np.asarray(vertices, dtype=np.float32)


@dataclass(frozen=True)
class MeshKeys:
    """Existing shape keys of a head, each on one or several of its meshes.

    Attributes
    ----------
    names : (K,) tuple of str
    offsets : (K, A, 3) float32
        Displacements of all meshes of the head at value 1, multiplied by the weights of the keys' vertex groups; head
        frame, the unit of the head.
    lower, upper : (K,) float64
        Range Min and Range Max of the keys.
    """

    names: tuple[str, ...]
    offsets: NDArray[np.float32]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each key, by name."""
        return {name: (low, high) for name, low, high in zip(self.names, self.lower, self.upper, strict=True)}

    def chosen(self, names: Sequence[str]) -> MeshKeys:
        """Return only the keys in `names`, in that order."""
        rows = [self.names.index(name) for name in names]
        return MeshKeys(tuple(names), self.offsets[rows], self.lower[rows], self.upper[rows])

    def within(self, ranges: Mapping[str, tuple[float, float]]) -> MeshKeys:
        """Return the keys with other ranges."""
        lower, upper = np.array([ranges[name] for name in self.names]).reshape(-1, 2).T
        return replace(self, lower=lower, upper=upper)

    def joined(self, other: MeshKeys) -> MeshKeys:
        """Return the keys of both."""
        return MeshKeys(
            names=self.names + other.names,
            offsets=np.concatenate([self.offsets, other.offsets]),
            lower=np.concatenate([self.lower, other.lower]),
            upper=np.concatenate([self.upper, other.upper]),
        )


def moving_key_names(members: Sequence[Member]) -> list[str]:
    """Return the names of the user's shape keys of a head that move a vertex: characters may have empty ones."""
    names: dict[str, None] = {}
    for obj in (member.obj for member in members):
        for name in key_names(obj):
            block = keys_of(obj).key_blocks[name]
            if not np.array_equal(key_points(block), key_points(block.relative_key)):
                names[name] = None
    return list(names)


def has_known_set(obj: bpy.types.Object) -> bool:
    """Return whether a character has a known set of keys for the complete face.

    A built-in head counts as having none, as its skin shows more than its keys.
    """
    return not _is_built_in(obj) and _knows(moving_key_names(members_of(obj)))


def has_own_expressions(obj: bpy.types.Object) -> bool:
    """Return whether a built-in head has shape keys for the complete face."""
    names = moving_key_names(members_of(obj)) if _is_built_in(obj) else []
    return _knows(names) or len(known_expressions(names)) > len(ESSENTIAL)


def _is_built_in(obj: bpy.types.Object) -> bool:
    return any(PART_PROPERTY in child for child in obj.children)


def _knows(names: Sequence[str]) -> bool:
    preset = best_preset(names)
    return preset is not None and preset.sources >= ESSENTIAL


def read_keys(members: Sequence[Member]) -> MeshKeys:
    """Read the user's shape keys of a head that are not muted; one that is muted on the head counts as muted on all.

    Keys of one name on several meshes are one. Keys whose drivers make them follow other keys of the head are left out,
    as these move them. Raises HeadError if no mesh has shape keys, or one has absolute ones.
    """
    blocks: dict[str, list[tuple[Member, bpy.types.ShapeKey]]] = {}
    head = members[0].obj
    muted = {name for name in key_names(head) if keys_of(head).key_blocks[name].mute}
    for member in members:
        for name in key_names(member.obj):
            block = keys_of(member.obj).key_blocks[name]
            if not block.mute and name not in muted:
                require_relative(member.obj)
                blocks.setdefault(name, []).append((member, block))
    family = family_keys(members)
    following = {keys: following_paths(keys, family) for keys in family}
    blocks = {
        name: found
        for name, found in blocks.items()
        if any(value_path(name) not in following[keys_of(member.obj)] for member, _ in found)
    }
    if not blocks:
        raise HeadError(
            "{name} has no shape keys. Bake to new shape keys, or add the built-in head with ARKit shape keys.",
            name=head.name,
        )
    offsets = np.zeros((len(blocks), members[-1].part.stop, 3), dtype=np.float32)
    for row, found in zip(offsets, blocks.values(), strict=True):
        for member, block in found:
            row[member.part] = member.head_offsets(scaled_offsets(member.obj, block))
            if not np.isfinite(row[member.part]).all():
                raise HeadError(
                    "The shape key {key} of {name} has coordinates that are not numbers. Mute or delete it.",
                    key=block.name,
                    name=member.obj.name,
                )
    first = [found[0][1] for found in blocks.values()]
    return MeshKeys(
        names=tuple(blocks),
        offsets=offsets,
        lower=np.array([block.slider_min for block in first]),
        upper=np.array([block.slider_max for block in first]),
    )


def require_relative(obj: bpy.types.Object) -> None:
    """Raise HeadError if the shape keys of `obj` are absolute and therefore have no values."""
    keys = mesh_of(obj).shape_keys
    if keys is not None and not keys.use_relative:
        raise HeadError("The shape keys of {name} are absolute. Enable Relative, or bake to a cache.", name=obj.name)


def value_path(name: str) -> str:
    """Return the data path of the value of the shape key `name`."""
    return f'key_blocks["{bpy.utils.escape_identifier(name)}"].value'


def add_keys(members: Sequence[Member], keys: MeshKeys) -> None:
    """Add shape keys to the meshes of a head."""
    for obj, own in ((member.obj, member.local_offsets(keys.offsets)) for member in members):
        if mesh_of(obj).shape_keys is None:
            obj.shape_key_add(name="Basis", from_mix=False)
        rest = key_points(keys_of(obj).reference_key)
        for name, mode, lower, upper in zip(keys.names, own, keys.lower, keys.upper, strict=True):
            key = obj.shape_key_add(name=name, from_mix=False)
            key.points.foreach_set("co", (rest + mode).reshape(-1))
            key.slider_min, key.slider_max = float(lower), float(upper)
            key.value = 0.0


@dataclass(frozen=True)
class KeyCurves:
    """Values of shape keys of a head over some frames.

    Attributes
    ----------
    names : tuple of str
        Names of K keys.
    values : (N, K) array
        Values in each frame.
    fitted : tuple of BezierCurve or None
        Their keyframes, if these are fewer than the frames.
    groups : mapping
        Names of the groups of curves, by key; for no other.
    """

    names: tuple[str, ...]
    values: NDArray[np.floating[Any]]
    fitted: tuple[BezierCurve | None, ...]
    groups: Mapping[str, str]

    @classmethod
    def of(
        cls, keys: MeshKeys, values: NDArray[np.floating[Any]], tolerance: float, residual: Collection[str] = ()
    ) -> KeyCurves:
        """Return the curves of keys, fitted as by `fitted_within`; those named in `residual` have their own group."""
        groups = curve_groups([name for name in keys.names if name not in residual])
        every = cls(keys.names, values, (None,) * len(keys.names), {**groups, **dict.fromkeys(residual, RESIDUAL)})
        return every.fitted_within(keys, tolerance)

    def fitted_within(self, keys: MeshKeys, tolerance: float) -> KeyCurves:
        """Fit the curves within a tolerance in the unit of the head; 0 keeps a keyframe in each frame."""
        fitted: Sequence[BezierCurve | None] = [None] * len(keys.names)
        if tolerance > 0.0:
            fitted = fit_key_curves(self.values, keys.offsets, tolerance, keys.lower, keys.upper)
        return replace(self, fitted=tuple(fitted))

    def to_write(self) -> dict[str, Curve]:
        """Return the curves by the names of their keys."""
        return {
            name: Curve(value_path(name), 0, values, fitted=fitted, group=self.groups[name])
            for name, values, fitted in zip(self.names, self.values.T, self.fitted, strict=True)
        }

    @property
    def keyframes(self) -> int:
        """Number of keyframes of all keys."""
        return sum(len(self.values) if curve is None else len(curve.rows) for curve in self.fitted)


def bake_values(
    members: Sequence[Member],
    keys: KeyCurves,
    frames: NDArray[np.floating[Any]],
    *,
    action: CharacterAction | None = None,
    nla: bool = False,
    keep: bool = False,
) -> list[Silenced]:
    """Animate shape keys of a head on each of its meshes that has them and does not make them follow others.

    Parameters
    ----------
    frames : (N,) array
        Frames of the values.
    action : CharacterAction, optional
        As for `write_curves`.
    nla : bool
        Whether to use an NLA track.
    keep : bool
        Whether other animation of the keys is added to, and drivers are left, instead of muting them.
    """
    curves = keys.to_write()
    silenced, family = [], family_keys(members)
    for obj in (member.obj for member in members):
        if (own_keys := mesh_of(obj).shape_keys) is not None:
            obj.show_only_shape_key = False
            following = following_paths(own_keys, family)
            own = [
                curve
                for name, curve in curves.items()
                if name in own_keys.key_blocks and curve.data_path not in following
            ]
            for curve in own:
                key = own_keys.path_resolve(curve.data_path.removesuffix(".value"))
                make_room(key, float(curve.values.max(initial=0.0)))
                make_room(key, float(curve.values.min(initial=0.0)))
            own += _beneath_corrections(own_keys, own, len(frames))
            name = f"{obj.name} Expression"
            silenced += write_curves(own_keys, name, frames, own, action=action, nla=nla, add=keep, leave_drivers=keep)
    return silenced


def _beneath_corrections(keys: bpy.types.Key, curves: Sequence[Curve], frames: int) -> list[Curve]:
    """Return curves at 0 for keys that are corrected but not baked: a correction of nothing is added to their default,
    which is 1 in Blender 5.0.
    """
    if not is_layer(keys.animation_data):
        return []
    baked, ends = {curve.data_path for curve in curves}, np.unique([0, frames - 1])
    still = BezierCurve(ends, np.zeros(len(ends)), np.zeros((len(ends), 2)))
    corrected = {fcurve.data_path for fcurve in curves_in(keys.animation_data)} - baked
    return [Curve(path, 0, np.zeros(frames), fitted=still) for path in sorted(corrected)]


def remove_baked_keys(obj: bpy.types.Object) -> None:
    """Remove the shape keys and curves of an earlier bake; existing keys that it animated return to 0."""
    keys = mesh_of(obj).shape_keys
    if keys is None:
        return
    for path in remove_bake(keys):
        for key in keys.key_blocks:
            if value_path(key.name) == path:
                key.value = 0.0
    remove_curves(keys, f'key_blocks["{BAKED_KEY_PREFIX}')
    for key in [key for key in keys.key_blocks if key.name.startswith(BAKED_KEY_PREFIX)]:
        obj.shape_key_remove(key)


def scaled_offsets(obj: bpy.types.Object, key: bpy.types.ShapeKey) -> NDArray[np.float32]:
    """Return (V, 3) displacements by a key at value 1 in Blender's axes, scaled by its vertex group if it has one."""
    offsets = key_offsets(key)
    if key.vertex_group in obj.vertex_groups:
        offsets *= group_weights(obj, key.vertex_group)[:, None]
    return offsets

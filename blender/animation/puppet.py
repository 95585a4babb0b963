"""A take onto a head: the one function behind the operator and the command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.arrays import FloatArray
from ...core.bake.arkit import arkit_coefficients
from ...core.bake.basis import fit_basis
from ...core.bake.fit import fit_keys, mix_errors
from ...core.bake.key_map import KeyMap, best_preset, expression_keys
from ...core.bake.point_cache import SUFFIX
from ...core.bake.settings import BakeSettings
from ...core.drive.motion import HeadMotion, drive_take
from ...core.errors import HeadError, OutputError
from ...core.heads.rig import HeadRig
from ...core.puppet.performance import Performance
from ...core.puppet.settings import PuppetSettings
from ...core.takes.neutral import Neutral
from ...core.takes.take import Take
from ..actions import check_curves
from ..meshes import mesh_of, read_rig
from .bake import Targets, bake_pose, check_bakeable, check_range, frames_of, remove_baked, set_range
from .bake_cache import bake_cache, export_alembic
from .bake_keys import MeshKeys, bake_new_keys, bake_values, key_names, read_keys, value_path
from .targets import PoseTarget

TOLERANCE = 0.009
_BY_DEFAULT = PuppetSettings()


@dataclass(frozen=True)
class PuppetReport:
    """What a bake did: `keys` shape keys, `worst_error` as a fraction of the outer-eye distance, and the motion."""

    keys: int
    worst_error: float
    neutral: Neutral
    motion: HeadMotion

    def told(self) -> str:
        """In words."""
        if not self.keys:
            return "every vertex exactly"
        return f"{self.keys} shape keys, worst vertex error {100 * self.worst_error:.2f} % of the eye distance"


def puppet_head(
    scene: bpy.types.Scene,
    obj: bpy.types.Object,
    take: Take,
    settings: PuppetSettings = _BY_DEFAULT,
    targets: Targets | None = None,
) -> PuppetReport:
    """Drive `obj` by `take` and bake the result to keys or a cache and curves, in step with the media's clock.

    Parameters
    ----------
    targets : mapping, optional
        What takes the head's pose instead of `obj`, "head", and the eyes' instead of its own, "eye_left" and
        "eye_right".

    Raises
    ------
    FacemimeError
        Where the mesh cannot be driven, the take holds no face, or what is asked for cannot take the bake. Nothing of
        the scene has changed then.
    """
    mesh_of(obj)
    bake, targets = settings.bake, targets or {"head": PoseTarget.of(obj)}
    rig = _checked_rig(obj, targets, bake)
    performance = Performance.of(take, settings)
    take, neutral = performance.take, performance.neutral
    motion = drive_take(performance.driver(rig), take)
    unit, frames = rig.eye_distance, frames_of(scene, motion.times)
    check_range(take, frames)
    if bake.keys == "mapped":
        plan = _mapped(obj, motion, frames, unit, bake, arkit_coefficients(take, neutral, settings.drive))
    else:
        plan = _PLANS[bake.keys](obj, motion, frames, unit, bake)
    remove_baked(obj, targets)
    plan.write()
    follow = {"rotation": settings.rotation, "translation": settings.translation}
    clean = (bake.clean, bake.clean * unit) if bake.clean > 0.0 else None
    bake_pose(obj, targets, motion, frames, **follow, clean=clean, nla=bake.nla)
    set_range(scene, frames_of(scene, take.times))
    if bake.keys == "alembic":
        export_alembic(scene, obj, bake.path.with_suffix(".abc"))
    return PuppetReport(plan.keys, plan.error / unit + (bake.clean if plan.keys else 0.0), neutral, motion)


def puppet_heads(
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    take: Take,
    settings: PuppetSettings = _BY_DEFAULT,
    targets: Targets | None = None,
) -> list[PuppetReport]:
    """Drive many heads by one take, each with its own landmarks, regions and pose.

    Each has a cache named after it, where one is asked for.

    Parameters
    ----------
    targets : mapping, optional
        Of the first one, as for `puppet_head`.

    Raises
    ------
    FacemimeError
        As `puppet_head`; where one of them cannot be driven or take a bake, none has changed.
    """
    check_heads(objects, settings.bake, targets)
    return [
        puppet_head(scene, obj, take, _with_path(settings, obj), None if number else targets)
        for number, obj in enumerate(objects)
    ]


def check_heads(objects: Sequence[bpy.types.Object], bake: BakeSettings, targets: Targets | None = None) -> None:
    """Raise HeadError where one of `objects` cannot be driven or take the bake; `targets` as for `puppet_heads`."""
    for number, obj in enumerate(objects):
        mesh_of(obj)
        _checked_rig(obj, {"head": PoseTarget.of(obj)} if number or targets is None else targets, bake)


def _checked_rig(obj: bpy.types.Object, targets: Targets, bake: BakeSettings) -> HeadRig:
    """The rig of a mesh that can be driven and take the bake; HeadError where it cannot."""
    check_bakeable(obj, targets, new_keys=bake.keys == "new", old_keys=bake.keys in ("named", "mapped"))
    return read_rig(obj)


@dataclass(frozen=True)
class _Plan:
    """What is to be written: so many `keys`, an `error` in the mesh's unit, and what writes them."""

    keys: int
    error: float
    write: Callable[[], None]


def _new(obj: bpy.types.Object, motion: HeadMotion, frames: FloatArray, unit: float, bake: BakeSettings) -> _Plan:
    basis = fit_basis(motion.vertices, TOLERANCE * unit, bake.max_keys)
    clean = bake.clean * unit
    return _Plan(
        len(basis.modes), basis.worst_error, lambda: bake_new_keys(obj, basis, frames, clean=clean, nla=bake.nla)
    )


def _named(obj: bpy.types.Object, motion: HeadMotion, frames: FloatArray, unit: float, bake: BakeSettings) -> _Plan:
    keys = read_keys(obj)
    keys = keys.chosen(expression_keys(keys.names))
    fit = fit_keys(motion.vertices, keys.offsets, keys.lower, keys.upper)
    values = dict(zip(keys.names, fit.weights.T, strict=True))
    return _values_plan(obj, keys, values, fit.worst_error, frames, unit, bake)


def _mapped(
    obj: bpy.types.Object,
    motion: HeadMotion,
    frames: FloatArray,
    unit: float,
    bake: BakeSettings,
    coefficients: FloatArray,
) -> _Plan:
    keys = read_keys(obj)
    values = table_for(obj, bake.table).apply(coefficients, keys.ranges)
    if not values:
        raise HeadError(f"The shape keys of {obj.name} that the table moves are muted. Unmute them, or bake to others.")
    keys = keys.chosen(list(values))
    error, _ = mix_errors(motion.vertices, keys.offsets, np.column_stack(list(values.values())))
    return _values_plan(obj, keys, values, error, frames, unit, bake)


def table_for(obj: bpy.types.Object, table: KeyMap | None = None) -> KeyMap:
    """`table`, or the best preset, with the names of the keys that `obj` has.

    Raises
    ------
    HeadError
        Where it moves none of them.
    """
    names = key_names(obj)
    if table is None and (preset := best_preset(names)) is not None:
        return preset
    if table is None or not (matched := table.matched(names)).rows:
        told = "No table that ships" if table is None else f"The table {table.name} does not"
        raise HeadError(
            f"{told} {'knows' if table is None else 'know'} the shape keys of {obj.name}. "
            "Give a table of your own, or bake to named or new keys."
        )
    return matched


def _values_plan(
    obj: bpy.types.Object,
    keys: MeshKeys,
    values: dict[str, FloatArray],
    error: float,
    frames: FloatArray,
    unit: float,
    bake: BakeSettings,
) -> _Plan:
    check_curves(obj.data.shape_keys, [value_path(name) for name in keys.names])
    clean = bake.clean * unit
    return _Plan(len(values), error, lambda: bake_values(obj, values, frames, keys.offsets, clean=clean, nla=bake.nla))


def _cache(obj: bpy.types.Object, motion: HeadMotion, frames: FloatArray, unit: float, bake: BakeSettings) -> _Plan:
    if bake.path is None:
        raise OutputError("A cache needs a file. Give it a path.")
    path = bake.path.with_suffix(SUFFIX)
    return _Plan(0, 0.0, lambda: bake_cache(obj, motion, frames, path))


_PLANS = {"new": _new, "named": _named, "cache": _cache, "alembic": _cache}


def _with_path(settings: PuppetSettings, obj: bpy.types.Object) -> PuppetSettings:
    if (path := settings.bake.path) is None:
        return settings
    named = path.with_name(f"{path.stem} {bpy.path.clean_name(obj.name)}{path.suffix}")
    return replace(settings, bake=replace(settings.bake, path=named))

"""Bake of a take to heads, for operators and the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import bpy
import numpy as np

from ...core.bake.arkit import arkit_coefficients
from ...core.bake.bake_settings import AUTOMATIC, CONTROLS, BakeSettings
from ...core.bake.fit import (
    MotionBasis,
    fit_basis,
    fit_positive_basis,
    fit_weights,
    left_over,
    mix_errors,
    mixed_motion,
)
from ...core.bake.own_keys import lid_factors, look_factors, reaching
from ...core.bake.point_cache import SUFFIX
from ...core.drive.driver import HeadMotion, drive_take
from ...core.drive.teaching import TaughtKeys
from ...core.errors import HeadError, Message, OutputError
from ...core.heads.key_map import KeyMap, exclusive_keys
from ...core.heads.key_presets import best_preset, expression_keys, with_others
from ...core.heads.rig import HeadRig
from ...core.numeric.arrays import FloatArray
from ...core.puppet.performer import Performance
from ...core.puppet.puppet_settings import PuppetSettings
from ...core.takes.take import Take
from ..characters import Member, members_of, objects_of, whole_face
from ..controls.checks import loose_parts
from ..fcurves import CharacterAction
from ..heads.look_keys import give_eyes_keys, look_keys_note
from ..heads.new_heads import add_missing_units, built_in_head_of
from ..meshes import driven_by_keys, key_names, mesh_of
from ..muting import Silenced
from ..names import BAKED_KEY_PREFIX
from ..rigs import read_rig
from ..timeline import Timing, frames_of
from .aside import resting_values
from .bake import (
    Targets,
    animated_owners,
    bake_pose,
    can_add_keys,
    check_bakeable,
    check_range,
    pose_targets_of,
    remove_baked,
)
from .bake_controls import control_owners, controls_plan
from .bake_keys import (
    RESIDUAL,
    KeyCurves,
    MeshKeys,
    add_keys,
    bake_values,
    has_known_set,
    has_own_expressions,
    moving_key_names,
    read_keys,
)
from .bake_report import Plan, PuppetReport, what_was_muted
from .conflicts import mute_disturbing, overruled, playing_under, unseen
from .exporting import bake_cache, export_alembic, with_name_of
from .refit import LastBake
from .refit_pose import ANGLE, LastPose
from .scene_range import fit_range, holding_take, outside_range, start_frame
from .strengths import scaled, scaled_pose
from .targets import own_targets, require_bone

TOLERANCE = 0.009
"""Error allowed for a basis of new shape keys, in eye distances."""
_MANY_KEYS = 10
"""Number of moving shape keys from which a character may have a set for its face: FACS' basic ones are more."""
_RESIDUAL_TOLERANCE = 0.02
"""The same for keys beside named ones. On the five shared clips named keys alone err by 12 to 25 %, with 13 to 24 more
by 2 % (50 on the liveliest); 1 % takes as many more as a basis without any."""
_DEFAULTS = PuppetSettings()


def puppet_head(
    scene: bpy.types.Scene,
    obj: bpy.types.Object,
    take: Take,
    settings: PuppetSettings = _DEFAULTS,
    targets: Targets | None = None,
) -> PuppetReport:
    """Drive a head with a take and bake the motion, in sync with the take's time.

    The targets are objects or bones that follow the pose: "head" instead of `obj`, "eye_left" and "eye_right" instead
    of its eyes. Raises FacemimeError if the mesh cannot be driven, the take contains no face, or the bake is not
    possible. The scene is not changed in that case.
    """
    mesh_of(obj)
    bake, targets = _chosen(obj, settings.bake), targets or own_targets(obj)
    rig = _checked_rig(obj, targets, bake)
    performance = Performance.of(take, settings)
    take, neutral = performance.take, performance.neutral
    eyes = give_eyes_keys(obj, preset_for(obj)) if bake.keys == "mapped" else []
    if eyes:
        rig = _checked_rig(obj, targets, bake)
    driver = performance.driver(rig)
    motion = drive_take(driver, take)
    start = start_frame(scene, bake.start)
    unit, frames, shown = rig.eye_distance, *(frames_of(scene, times, start) for times in (motion.times, take.times))
    check_range(take, frames)
    timing = Timing.of(scene, frames, bake)
    if settings.bake.keys == AUTOMATIC and bake.keys == "named":
        add_missing_units(obj)
    if bake.keys == "mapped":
        expressions = [driver.expression(take.result(int(frame))) for frame in np.flatnonzero(take.found)]
        solved = partial(arkit_coefficients, take, neutral, settings.drive)
        motion, plan = _mapped(obj, rig, motion, timing, unit, bake, (solved, expressions))
    else:
        plan = _PLANS[bake.keys](obj, motion, timing, unit, bake)
    remove_baked(obj, targets)
    action = CharacterAction(obj.name, animated_owners(obj, targets))
    LastBake.current = None
    silenced = plan.write(action)
    follow = {"rotation": settings.rotation, "translation": settings.translation}
    clean = (ANGLE * bake.clean, bake.clean * unit) if timing.is_whole and bake.clean > 0.0 else None
    how = {"nla": bake.nla, "keep": bake.keep_animation}
    posed = timing.motion(motion)
    strong = scaled_pose(obj, posed, timing.keyed)
    silenced += bake_pose(scene, obj, targets, strong, timing.keyed, **follow, clean=clean, action=action, **how)
    if (last := LastBake.current) is not None:
        kept = LastPose.of(scene, obj, targets, posed, timing.keyed, (settings.rotation, settings.translation))
        LastBake.current = replace(last, pose=kept)
    if not bake.keep_animation and not bake.writes_cache:
        silenced += mute_disturbing(obj, motion, drivers=bake.keys != CONTROLS)
    fit_range(scene, shown, bake.start, asked=bake.fit_range)
    if bake.keys == "alembic" and bake.path is not None:
        with holding_take(scene, shown):
            parts = list(dict.fromkeys([obj, *obj.children_recursive, *objects_of(obj)]))
            export_alembic(scene, parts, bake.path.with_suffix(".abc"))
    rigs = control_owners(obj) if bake.keys == CONTROLS else ()
    unseen_for = [*unseen([obj]), *overruled(pose_targets_of(obj, targets), **follow, rigs=rigs)]
    loose = loose_parts(obj) if bake.keys == CONTROLS else ""
    left_out = _unused_keys(obj) if settings.bake.keys == AUTOMATIC and bake.keys == "new" else _muted_keys(obj, bake)
    told = [what_was_muted(silenced), left_out, *unseen_for, loose, outside_range(scene, shown), look_keys_note(eyes)]
    others = () if bake.writes_cache else tuple(playing_under(obj))
    added = bake.clean if clean is not None and plan.keys else 0.0
    return PuppetReport(
        plan.keys,
        plan.error / unit + added,
        neutral,
        motion,
        plan.named_error / unit + added,
        plan.keyframes,
        plan.keys * len(timing.keyed),
        others,
        start,
        tuple(filter(None, told)),
        plan.controls,
    )


def _muted_keys(obj: bpy.types.Object, bake: BakeSettings) -> str:
    """Return a warning that names the mapping's muted shape keys, or "" if there are none."""
    keys = mesh_of(obj).shape_keys
    if bake.keys != "mapped" or keys is None:
        return ""
    blocks, table = keys.key_blocks, table_for(obj, bake.table)
    names = ", ".join(name for name in table.keys if name in blocks and blocks[name].mute)
    return Message("Muted shape keys were left out: {names}. Unmute them to show them.", names=names) if names else ""


def _unused_keys(obj: bpy.types.Object) -> str:
    """Return a note that new keys were added beside many of the user's own; "" if there are few."""
    count = len(moving_key_names(members_of(obj)))
    if count < _MANY_KEYS:
        return ""
    return Message(
        "The names of its own shape keys ({count}) are not known, so new ones were added. "
        "If they show expressions, bake to Existing Shape Keys (named).",
        count=count,
    )


def puppet_heads(
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    take: Take,
    settings: PuppetSettings = _DEFAULTS,
    targets: Targets | None = None,
) -> list[PuppetReport]:
    """Drive several heads with one take, each with its own landmarks, regions and pose.

    The file of a cache is named after each; targets are those of the first head. Raises FacemimeError as `puppet_head`
    does; if one head cannot be baked to, none is changed.
    """
    check_heads(objects, settings.bake, targets)
    return [
        puppet_head(scene, obj, take, _with_path(settings, obj), None if number else targets)
        for number, obj in enumerate(objects)
    ]


def check_heads(objects: Sequence[bpy.types.Object], bake: BakeSettings, targets: Targets | None = None) -> None:
    """Check that heads can be driven and baked to, with targets as for `puppet_heads`; raises HeadError if not."""
    for number, obj in enumerate(objects):
        mesh_of(obj)
        _checked_rig(obj, own_targets(obj) if number or targets is None else targets, _chosen(obj, bake))


def _chosen(obj: bpy.types.Object, bake: BakeSettings) -> BakeSettings:
    """Resolve "automatic" for `obj`, which depends on the keys it has."""
    if bake.keys != AUTOMATIC:
        return bake
    if driven_by_keys(obj) or has_known_set(obj):
        return replace(bake, keys="mapped")
    given = can_add_keys(obj) and not key_names(obj) and built_in_head_of(obj) is not None
    return replace(bake, keys="named" if given or has_own_expressions(obj) else "new", table=None)


def _checked_rig(obj: bpy.types.Object, targets: Targets, bake: BakeSettings) -> HeadRig:
    """Return the rig of a head; raises HeadError if it cannot be driven or baked to."""
    if driven_by_keys(obj) and bake.keys != "mapped":
        raise HeadError(
            "{name} is bound by its shape keys alone. Bake to existing shape keys by a mapping, or find its face.",
            name=obj.name,
        )
    require_bone(obj, targets)
    check_bakeable(obj, targets, new_keys=bake.keys == "new", old_keys=bake.uses_existing_keys)
    return read_rig(obj)


def _new(obj: bpy.types.Object, motion: HeadMotion, timing: Timing, unit: float, bake: BakeSettings) -> Plan:
    basis = _fit(motion.vertices, TOLERANCE * unit, bake)
    keys = _added_keys(basis, "", bake)
    return _values_plan(obj, keys, basis.weights, timing, unit, bake, basis.worst_error, added=keys)


def _fit(motion: FloatArray, tolerance: float, bake: BakeSettings) -> MotionBasis:
    return (fit_positive_basis if bake.positive else fit_basis)(motion, tolerance, bake.max_keys)


def _added_keys(basis: MotionBasis, kind: str, bake: BakeSettings) -> MeshKeys:
    """Return the keys that a bake adds for a basis, which are numbered."""
    names = tuple(f"{BAKED_KEY_PREFIX}{kind}{number + 1:02d}" for number in range(len(basis.modes)))
    ends = np.ones(len(names))
    return MeshKeys(names, basis.modes, 0.0 * ends if bake.positive else -ends, ends)


def _named(obj: bpy.types.Object, motion: HeadMotion, timing: Timing, unit: float, bake: BakeSettings) -> Plan:
    keys = read_keys(members_of(obj))
    keys = keys.chosen(expression_keys(keys.names))
    named = fit_weights(motion.vertices, keys.offsets, keys.lower, keys.upper, exclusive_keys(keys.names))
    if not (bake.residual and can_add_keys(obj)):
        error, _ = mix_errors(motion.vertices, keys.offsets, named)
        return _values_plan(obj, keys, named, timing, unit, bake, error)
    left, error = left_over(motion.vertices, keys.offsets, named)
    basis = _fit(left, _RESIDUAL_TOLERANCE * unit, bake)
    if not len(basis.modes):
        return _values_plan(obj, keys, named, timing, unit, bake, error)
    added = _added_keys(basis, f"{RESIDUAL} ", bake)
    weights = np.column_stack([named, basis.weights])
    return _values_plan(
        obj,
        keys.joined(added),
        weights,
        timing,
        unit,
        bake,
        basis.worst_error,
        added=added,
        named_error=error,
    )


def _mapped(
    obj: bpy.types.Object,
    rig: HeadRig,
    motion: HeadMotion,
    timing: Timing,
    unit: float,
    bake: BakeSettings,
    performed: tuple[Callable[[FloatArray, FloatArray], FloatArray], Sequence[FloatArray]],
) -> tuple[HeadMotion, Plan]:
    """Plan a bake by a mapping of what was `performed`: the coefficients (N, 52), given the factors of the eyes'
    directions and of blinks, and N expressions, which are corrected as was taught. The motion of a head that has no
    other is that of its keys.
    """
    members, taught = members_of(obj), TaughtKeys(rig.style)
    keys, (solved, expressions) = read_keys(members), performed
    table = table_for(obj, bake.table)
    offsets = dict(zip(keys.names, keys.offsets, strict=True))
    looks, lids = look_factors(rig, table, offsets), lid_factors(*whole_face(obj), table, offsets)
    keys = keys.within(reaching(keys.ranges, table, lids))
    values = table.apply(solved(looks, lids), keys.ranges)
    values = taught.corrected(values, expressions, keys.ranges, resting_values(members, taught.names))
    if not values:
        raise HeadError(
            "All shape keys of {name} in the key mapping are muted. Unmute them, or bake to something else.",
            name=obj.name,
        )
    keys = keys.chosen(list(values))
    weights = np.column_stack(list(values.values()))
    if driven_by_keys(obj):
        motion, error = replace(motion, vertices=mixed_motion(keys.offsets, weights)), float("nan")
    else:
        error, _ = mix_errors(motion.vertices, keys.offsets, weights)
    return motion, _values_plan(obj, keys, weights, timing, unit, bake, error)


def preset_for(obj: bpy.types.Object) -> KeyMap | None:
    """Return the preset that fits the shape keys of a head best, if any, with the names of its keys.

    Other programs look for all keys of a set, so those that move nothing here are set as well.
    """
    members = members_of(obj)
    moving = moving_key_names(members)
    return None if (preset := best_preset(moving)) is None else with_others(preset, moving, _key_names(members))


def table_for(obj: bpy.types.Object, table: KeyMap | None = None) -> KeyMap:
    """Match a key mapping, by default the preset that fits best, with the names of the keys as a head has them.

    Raises HeadError if it matches none of them.
    """
    if table is None and (preset := preset_for(obj)) is not None:
        return preset
    if table is None:
        raise HeadError(
            "No key mapping preset matches the shape keys of {name}. "
            "Use your own mapping, or bake to new or existing shape keys without a mapping.",
            name=obj.name,
        )
    if not (matched := table.matched(_key_names(members_of(obj)))).rows:
        raise HeadError(
            "The key mapping {mapping} matches none of the shape keys of {name}. "
            "Use another mapping, or bake to new or existing shape keys without a mapping.",
            mapping=table.name,
            name=obj.name,
        )
    return matched


def _key_names(members: Sequence[Member]) -> list[str]:
    """Names of the shape keys of a head, each once."""
    return list(dict.fromkeys(name for member in members for name in key_names(member.obj)))


def _values_plan(
    obj: bpy.types.Object,
    keys: MeshKeys,
    weights: FloatArray,
    timing: Timing,
    unit: float,
    bake: BakeSettings,
    error: float,
    *,
    added: MeshKeys | None = None,
    named_error: float = float("nan"),
) -> Plan:
    """Plan a bake of weights (N, K) of keys, of which those in `added` do not exist yet."""
    residual = () if added is None or added is keys else added.names
    tolerance = bake.clean * unit if timing.is_whole else 0.0
    values = timing.curves(weights)
    curves = KeyCurves.of(keys, scaled(obj, keys, values, timing.keyed, residual), tolerance, residual)

    def write(action: CharacterAction) -> list[Silenced]:
        members = members_of(obj)
        if added is not None:
            add_keys(members, added)
        fits_again = timing.is_whole and not bake.keep_animation
        LastBake.current = LastBake(obj.name, keys, values, curves, timing.keyed, unit) if fits_again else None
        return bake_values(members, curves, timing.keyed, action=action, nla=bake.nla, keep=bake.keep_animation)

    return Plan(len(keys.names), error, write, named_error, curves.keyframes)


def _cache(obj: bpy.types.Object, motion: HeadMotion, timing: Timing, unit: float, bake: BakeSettings) -> Plan:
    if bake.path is None:
        raise OutputError("The cache has no file name. Give it a path.")
    path = bake.path.with_suffix(SUFFIX)

    def write(_: CharacterAction) -> list[Silenced]:
        bake_cache(members_of(obj), motion, timing.frames, path)
        return []

    return Plan(0, 0.0, write)


_PLANS = {"new": _new, "named": _named, CONTROLS: controls_plan, "cache": _cache, "alembic": _cache}


def _with_path(settings: PuppetSettings, obj: bpy.types.Object) -> PuppetSettings:
    if (path := settings.bake.path) is None:
        return settings
    return replace(settings, bake=replace(settings.bake, path=with_name_of(path, obj)))

"""Bakes of the pose of head, eyes, teeth and tongue, also in addition to the user's animation; checks before a bake,
and removal of earlier ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.drive.actions import TONGUE
from ...core.drive.driver import HeadMotion
from ...core.errors import HeadError, SourceError
from ...core.numeric.arrays import FloatArray
from ...core.takes.take import Take
from ..actions import Curve, check_curves, remove_bake, write_curves
from ..characters import members_of, own_rotation
from ..fcurves import CharacterAction, make_actions_own
from ..meshes import keys_of, mesh_of
from ..muting import Silenced, animated_paths, keyed_paths, mute_others, mute_paths, strips_of
from ..names import PART_PROPERTY, TONGUE_KEY
from ..own_pose import own_mode, path_of, prefix_of, rotation_channel
from .bake_controls import control_owners, rest_controls
from .bake_keys import remove_baked_keys, require_relative, value_path
from .carried import carried_targets, carriers_of
from .exporting import remove_cache
from .targets import Placement, PoseTarget, continuous_quaternions

_CHANNELS = ("rotation_euler", "rotation_quaternion", "rotation_axis_angle")
_PLACING = (*_CHANNELS, "location")
"""Data paths of the channels that move an object."""


def placements(
    scene: bpy.types.Scene, targets: Sequence[PoseTarget], frames: NDArray[np.floating[Any]], *, keep: bool
) -> list[Placement]:
    """Return where the user's animation places some targets in frames (N,), which may be fractional.

    `keep` is whether the poses of bones are added to their animation, instead of replacing it. The current frame of the
    scene is restored.
    """
    turned = [target.obj for target in targets if not target.bone and animated_paths(target.obj, _CHANNELS)]
    added = [target for target in targets if (keep or not target.bone) and _is_added_by_angle(target)]
    if not turned and not added:
        return [Placement()] * len(targets)
    rotations: list[list[NDArray[np.float64]]] = [[] for _ in turned]
    angles: list[list[tuple[float, ...]]] = [[] for _ in added]
    current = scene.frame_current, scene.frame_subframe
    try:
        for frame in frames:
            whole = int(np.floor(frame))
            scene.frame_set(whole, subframe=float(frame - whole))
            for obj, found in zip(turned, rotations, strict=True):
                found.append(np.array(own_rotation(obj)))
            for target, values in zip(added, angles, strict=True):
                values.append(tuple(getattr(target.owner, f"{prefix_of(target.owner)}rotation_euler")))
    finally:
        scene.frame_set(current[0], subframe=current[1])
    return [
        Placement(
            np.array(rotations[turned.index(target.obj)]) if not target.bone and target.obj in turned else None,
            np.array(angles[added.index(target)]) if target in added else None,
        )
        for target in targets
    ]


def _is_added_by_angle(target: PoseTarget) -> bool:
    """Return whether animated Euler angles, to which Blender adds a bake angle by angle, rotate a target."""
    path = f"{path_of(target.owner)}rotation_euler"
    return rotation_channel(target.owner) == "rotation_euler" and path in keyed_paths(target.obj)


def _keep_axis_angles_moving(scene: bpy.types.Scene, obj: bpy.types.Object, frames: NDArray[np.floating[Any]]) -> None:
    """Animate the quaternion of a posed object as its user animates its axis and angle.

    Blender has no delta rotation by axis and angle, so that such an object is posed as one with a quaternion. The
    user's curves stay, and move the object again when the bake is removed.
    """
    if own_mode(obj) != "AXIS_ANGLE":
        return
    every = np.arange(*_span(scene, obj, frames), dtype=np.float64)
    (placed,) = placements(scene, [PoseTarget(obj)], every, keep=False)
    if placed.rotations is not None:
        values = continuous_quaternions([Matrix(one.tolist()).to_quaternion() for one in placed.rotations])
        curves = [Curve("rotation_quaternion", i, column) for i, column in enumerate(values.T)]
        write_curves(obj, f"{obj.name} Pose", every, curves)


def _span(scene: bpy.types.Scene, obj: bpy.types.Object, frames: FloatArray) -> tuple[int, int]:
    """Return the first frame, and the one after the last, of the scene, a bake and the animation of an object."""
    data = obj.animation_data
    ends = [scene.frame_start, scene.frame_end, frames[0], frames[-1]]
    if data is not None and data.action is not None:
        ends += data.action.frame_range[:]
    ends += [end for strip in strips_of(obj) for end in (strip.frame_start, strip.frame_end)]
    return int(np.floor(min(ends))), int(np.ceil(max(ends))) + 1


JAW_PARTS = frozenset({"teeth_lower", "tongue"})
EYE_PARTS = ("eye_right", "eye_left")
"""In the order of `HeadFrame.gaze`."""
Targets = Mapping[str, PoseTarget]
_TONGUE_ERROR = 0.01
"""Error of the tongue's key that fewer keyframes may cause."""
_LAST_FRAME = 1_048_574
"""Last frame of Blender's timeline."""


def check_bakeable(obj: bpy.types.Object, targets: Targets, *, new_keys: bool, old_keys: bool) -> None:
    """Check that a head, the targets of its pose, and its new or existing shape keys can be baked to.

    Nothing is changed. Raises HeadError if the head or one of the targets cannot be animated.
    """
    for owner in {target.obj for target in _all_targets(obj, targets)}:
        if owner.library is not None:
            raise HeadError(
                "{name} is linked from another file and cannot be animated here. Make a library override of it "
                "(Object > Library Override > Make), or make it local.",
                name=owner.name,
            )
    for member in members_of(obj):
        _check_keys(member.obj, new=new_keys, old=old_keys)
    for block in animated_owners(obj, targets):
        check_curves(block)


def can_add_keys(obj: bpy.types.Object) -> bool:
    """Return whether shape keys can be added to all meshes of a head."""
    try:
        for member in members_of(obj):
            _check_keys(member.obj, new=True, old=False)
    except HeadError:
        return False
    return True


def _check_keys(obj: bpy.types.Object, *, new: bool, old: bool) -> None:
    mesh = mesh_of(obj)
    if new and (mesh.library is not None or mesh.override_library is not None):
        raise HeadError(
            "The mesh of {name} is linked from another file, so shape keys cannot be added. "
            "Bake to a cache or to existing shape keys, or make it local.",
            name=obj.name,
        )
    if new:
        require_relative(obj)
    if old:
        require_relative(obj)
    if old and mesh.shape_keys is not None and mesh.shape_keys.library is not None:
        raise HeadError(
            "The shape keys of {name} are linked from another file and cannot be animated here. "
            "Bake to a cache, or make them local.",
            name=obj.name,
        )


def check_range(take: Take, frames: NDArray[np.floating[Any]]) -> None:
    """Check that a take fits into Blender's timeline in increasing frames; raises SourceError if it exceeds the end."""
    if max(-frames[0], frames[-1]) > _LAST_FRAME:
        raise SourceError(
            "The take extends from {start:.2f} s to {end:.2f} s, beyond Blender's last frame. "
            "Check that the times are in seconds. To shift a take: facemime mend TAKE --shift SECONDS -o OUT",
            start=take.times[0],
            end=take.times[-1],
        )


def bake_pose(
    scene: bpy.types.Scene,
    obj: bpy.types.Object,
    targets: Targets,
    motion: HeadMotion,
    frames: NDArray[np.floating[Any]],
    *,
    rotation: bool = True,
    translation: bool = False,
    clean: tuple[float, float] | None = None,
    action: CharacterAction | None = None,
    nla: bool = False,
    keep: bool = False,
) -> list[Silenced]:
    """Animate the pose of head and eyes, and of the lower teeth and the tongue, which are children of the head.

    Parameters
    ----------
    targets : mapping
        "head", and optionally "eye_left" and "eye_right", which replace the eyes of `obj`.
    rotation, translation : bool
        Whether the rotation and the location of the head are animated.
    clean : (float, float), optional
        Error that fewer keyframes may cause, if the frames follow each other: radians, and the mesh's unit.
    action : CharacterAction, optional
        As for `write_curves`.
    nla : bool
        Whether to use an NLA track.
    keep : bool
        Whether other animation of bones is added to, and drivers are left, instead of muting them, as is that of
        parents that move only some of the meshes, such as those of eyes. That of objects' delta transforms is always
        added to: it is where the user placed them.
    """
    silenced = []
    if not keep and (rotation or translation):
        for carrier in carriers_of(obj, targets["head"]):
            silenced += [*mute_others(carrier, _PLACING), *mute_paths(carrier, _PLACING, curves=False)]
    carried = carried_targets(obj, targets["head"])
    moved = posed_parts(obj, targets)
    placed = placements(scene, [target for _, target in moved], frames, keep=keep)
    curves: dict[bpy.types.Object, list[Curve]] = {}
    for (part, target), where in zip(moved, placed, strict=True):
        found = part_curves(part, target, motion, clean, where, rotation=rotation, translation=translation)
        curves.setdefault(target.obj, []).extend(found)
    for owner, owned in curves.items():
        name = f"{owner.name} {'Pose' if any(owner == target.obj for target in carried) else 'Motion'}"
        add = keep or owner.type != "ARMATURE"
        silenced += write_curves(owner, name, frames, owned, action=action, nla=nla, add=add, leave_drivers=keep)
        _keep_axis_angles_moving(scene, owner, frames)
    for child in filter(has_tongue, obj.children):
        stuck_out = motion.actions[:, TONGUE]
        curve = Curve(value_path(TONGUE_KEY), 0, stuck_out, _TONGUE_ERROR if clean else None, group="Mouth")
        name = f"{child.name} Expression"
        how = {"nla": nla, "add": keep, "leave_drivers": keep}
        silenced += write_curves(keys_of(child), name, frames, [curve], action=action, **how)
    return silenced


def part_curves(
    part: str,
    target: PoseTarget,
    motion: HeadMotion,
    clean: tuple[float, float] | None,
    where: Placement,
    *,
    rotation: bool,
    translation: bool,
) -> list[Curve]:
    """Return the curves of a part of a head, or of its "Pose"; parameters are as for `bake_pose`."""
    angle, length = clean or (None, None)
    if part == "Pose":
        moves = motion.translation if translation else None
        curves = target.curves(motion.rotation if rotation else None, moves, angle, length, where)
    else:
        turns = motion.jaw if part in JAW_PARTS else motion.gaze[:, EYE_PARTS.index(part)]
        curves = target.curves(turns, None, angle, length, where)
    group = "Jaw" if part in JAW_PARTS else "Eyes" if part in EYE_PARTS else part
    # Blender groups the curves of a bone by its name.
    return [replace(curve, group=target.bone or group) for curve in curves]


def animated_owners(obj: bpy.types.Object, targets: Targets) -> list[bpy.types.ID]:
    """Return all data-blocks that a bake or a session of a head may animate. Parameters are as for `check_bakeable`."""
    keys = [mesh_of(member.obj).shape_keys for member in members_of(obj)]
    keys += [mesh_of(child).shape_keys for child in filter(has_tongue, obj.children)]
    owners = [*(target.obj for target in _all_targets(obj, targets)), *control_owners(obj), *filter(None, keys)]
    return list(dict.fromkeys([*owners, *_carriers(obj, targets)]))


def remove_baked(obj: bpy.types.Object, targets: Targets) -> None:
    """Remove what an earlier bake added to `obj` and `targets`: shape keys, cache, curves and pose.

    An action that another character plays too is left to it. Parameters are as for `check_bakeable`.
    """
    make_actions_own(animated_owners(obj, targets))
    for member in members_of(obj):
        remove_baked_keys(member.obj)
        remove_cache(member.obj)
    for child in filter(has_tongue, obj.children):
        remove_baked_keys(child)
    places = _all_targets(obj, targets)
    for target in places:
        target.begin()  # a bake of an earlier version remembers no pose of the user
    for owner in {*(target.obj for target in places), *control_owners(obj), *_carriers(obj, targets)}:
        rest_controls(obj, owner, remove_bake(owner))
    for target in places:
        target.rest()
    bpy.context.view_layer.update()


def _carriers(obj: bpy.types.Object, targets: Targets) -> list[bpy.types.Object]:
    """Return the objects whose own motion a bake mutes. Parameters are as for `check_bakeable`."""
    found = [
        carrier for target in (PoseTarget(obj), targets.get("head")) if target for carrier in carriers_of(obj, target)
    ]
    return list(dict.fromkeys(found))


def pose_targets_of(obj: bpy.types.Object, targets: Targets) -> list[PoseTarget]:
    """Return everything that a bake of `obj` poses. Parameters are as for `check_bakeable`."""
    return [target for _, target in posed_parts(obj, targets)]


def _all_targets(obj: bpy.types.Object, targets: Targets) -> list[PoseTarget]:
    """Return everything that a bake of `obj` may pose, including `obj` itself, which an earlier bake may have posed."""
    return [PoseTarget(obj), *pose_targets_of(obj, targets)]


def posed_parts(obj: bpy.types.Object, targets: Targets) -> list[tuple[str, PoseTarget]]:
    """Return what a bake of `obj` poses, with its part, or "Pose". Parameters are as for `check_bakeable`."""
    carried = carried_targets(obj, targets["head"])
    return [*(("Pose", target) for target in carried), *_part_targets(obj, targets)]


def _part_targets(obj: bpy.types.Object, targets: Targets) -> Iterator[tuple[str, PoseTarget]]:
    """Yield the parts that rotate with the jaw and the gaze: eyes in `targets`, and otherwise children of `obj`."""
    for child in obj.children:
        part = str(child.get(PART_PROPERTY, ""))
        if part in JAW_PARTS or (part in EYE_PARTS and part not in targets):
            yield part, PoseTarget(child)
    yield from ((eye, targets[eye]) for eye in EYE_PARTS if eye in targets)


def has_tongue(part: bpy.types.Object) -> bool:
    """Return whether an object is a tongue with a shape key that sticks it out."""
    return (
        part.get(PART_PROPERTY) == "tongue"
        and part.type == "MESH"
        and mesh_of(part).shape_keys is not None
        and TONGUE_KEY in keys_of(part).key_blocks
    )


def show_tongue(part: bpy.types.Object, amount: float) -> None:
    """Stick a tongue out by a share from 0 to 1; other parts of a head are not changed."""
    if has_tongue(part):
        keys_of(part).key_blocks[TONGUE_KEY].value = amount

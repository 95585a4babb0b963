"""Where the user's animation places objects and bones in each frame, to which a pose is added."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.numeric.arrays import FloatArray
from ..actions import Curve, write_curves
from ..characters import own_rotation
from ..muting import animated_paths, keyed_paths, strips_of
from ..own_pose import own_mode, path_of, prefix_of, rotation_channel
from .targets import Placement, PoseTarget, continuous_quaternions

_CHANNELS = ("rotation_euler", "rotation_quaternion", "rotation_axis_angle")


def placements(
    scene: bpy.types.Scene, targets: Sequence[PoseTarget], frames: NDArray[np.floating[Any]], *, keep: bool
) -> list[Placement]:
    """Return where the user's animation places some targets in some frames.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its current frame is restored.
    targets : sequence of PoseTarget
    frames : (N,) array
        Frames, which may be fractional.
    keep : bool
        Whether the poses of bones are added to their animation, instead of replacing it.
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


def keep_axis_angles_moving(scene: bpy.types.Scene, obj: bpy.types.Object, frames: NDArray[np.floating[Any]]) -> None:
    """Animate the quaternion of a posed object as its user animates its axis and angle.

    Blender has no delta rotation by axis and angle, so that such an object is posed as one with a quaternion. The
    user's curves stay, and move the object again when the bake is removed.

    Parameters
    ----------
    frames : (N,) array
        Frames of the bake.
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

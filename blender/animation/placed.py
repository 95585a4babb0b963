"""Rotations of an object that its user animates, to whose axes a pose is added in each frame."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.arrays import FloatArray
from ..actions import Curve, write_curves
from ..characters import own_rotation
from ..muting import animated_paths, strips_of
from ..own_pose import own_mode
from .targets import continuous_quaternions

_CHANNELS = ("rotation_euler", "rotation_quaternion", "rotation_axis_angle")


def placed_rotations(
    scene: bpy.types.Scene, obj: bpy.types.Object, frames: NDArray[np.floating]
) -> NDArray[np.float64] | None:
    """Return the (N, 3, 3) rotations that the user gave an object in some frames; None if they do not change.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its current frame is restored.
    obj : bpy.types.Object
    frames : (N,) array
        Frames, which may be fractional.
    """
    if not animated_paths(obj, _CHANNELS):
        return None
    current = scene.frame_current, scene.frame_subframe
    placed = []
    try:
        for frame in frames:
            whole = int(np.floor(frame))
            scene.frame_set(whole, subframe=float(frame - whole))
            placed.append(np.array(own_rotation(obj)))
    finally:
        scene.frame_set(current[0], subframe=current[1])
    return np.array(placed)


def keep_axis_angles_moving(scene: bpy.types.Scene, obj: bpy.types.Object, frames: NDArray[np.floating]) -> None:
    """Animate the quaternion of a posed object as its user animates its axis and angle.

    Blender has no delta rotation by axis and angle, so that such an object is posed as one with a quaternion. The
    user's curves stay, and move the object again when the bake is removed.

    Parameters
    ----------
    scene : bpy.types.Scene
    obj : bpy.types.Object
    frames : (N,) array
        Frames of the bake.
    """
    if own_mode(obj) != "AXIS_ANGLE":
        return
    every = np.arange(*_span(scene, obj, frames), dtype=np.float64)
    if (placed := placed_rotations(scene, obj, every)) is not None:
        values = continuous_quaternions([Matrix(one.tolist()).to_quaternion() for one in placed])
        curves = [Curve("rotation_quaternion", i, column) for i, column in enumerate(values.T)]
        write_curves(obj, f"{obj.name} Pose", every, curves)


def _span(scene: bpy.types.Scene, obj: bpy.types.Object, frames: FloatArray) -> tuple[int, int]:
    """Return the first frame, and the one after the last, of the scene, a bake and the animation of an object."""
    data = obj.animation_data
    ends = [scene.frame_start, scene.frame_end, frames[0], frames[-1]]
    if data is not None and data.action is not None:
        ends += tuple(data.action.frame_range)
    ends += [end for strip in strips_of(obj) for end in (strip.frame_start, strip.frame_end)]
    return int(np.floor(min(ends))), int(np.ceil(max(ends))) + 1

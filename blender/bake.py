"""A driven take as Blender animation: a few shape keys with curves, and curves for head, eyes, teeth and tongue."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Euler, Matrix
from numpy.typing import NDArray

from ..core.deform.basis import MotionBasis
from ..core.motion import HeadMotion
from .actions import Curve, remove_curves, write_curves
from .frames import rotation_to_blender, to_blender
from .names import PART_PROPERTY

BAKED_KEY_PREFIX = "Facemime "

JAW_PARTS = frozenset({"teeth_lower", "tongue"})
EYE_PARTS = frozenset({"eye_left", "eye_right"})


def frames_of(scene: bpy.types.Scene, times: NDArray[np.floating], start: float = 1.0) -> NDArray[np.floating]:
    """The scene's frames, fractional where need be, at media `times` in seconds: in step at any scene rate."""
    return start + times * (scene.render.fps / scene.render.fps_base)


def bake_shape(obj: bpy.types.Object, basis: MotionBasis, frames: NDArray[np.floating]) -> None:
    """Replace the baked shape keys of `obj` by those of `basis` and animate them; other keys and curves stay."""
    remove_baked(obj)
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)
    keys = obj.data.shape_keys
    rest = np.empty(3 * len(obj.data.vertices), dtype=np.float32)
    keys.reference_key.points.foreach_get("co", rest)
    curves = []
    for i, mode in enumerate(basis.modes):
        key = obj.shape_key_add(name=f"{BAKED_KEY_PREFIX}{i + 1:02d}", from_mix=False)
        key.points.foreach_set("co", (rest.reshape(-1, 3) + to_blender(mode)).astype(np.float32).reshape(-1))
        key.slider_min, key.slider_max = -1.0, 1.0
        key.value = 0.0
        curves.append(Curve(f'key_blocks["{key.name}"].value', 0, basis.weights[:, i]))
    write_curves(keys, f"{obj.name} Expression", frames, curves)


def remove_baked(obj: bpy.types.Object) -> None:
    """Remove the shape keys, and their curves, that an earlier bake made."""
    keys = obj.data.shape_keys
    if keys is None:
        return
    remove_curves(keys, f'key_blocks["{BAKED_KEY_PREFIX}')
    for key in [key for key in keys.key_blocks if key.name.startswith(BAKED_KEY_PREFIX)]:
        obj.shape_key_remove(key)


def bake_pose(
    obj: bpy.types.Object,
    motion: HeadMotion,
    frames: NDArray[np.floating],
    *,
    rotation: bool = True,
    translation: bool = False,
) -> None:
    """Animate the delta transform of `obj`, a head or an empty, so that where it was placed remains free to change."""
    clear_pose(obj)
    local = obj.matrix_world.to_3x3()
    curves = []
    if rotation:
        turn = np.array(local.normalized())
        curves += _rotation_curves(obj, turn @ rotation_to_blender(motion.rotation) @ turn.T)
    if translation:
        moved = to_blender(motion.translation) @ np.array(local).T
        curves += [Curve("delta_location", i, moved[:, i]) for i in range(3)]
    write_curves(obj, f"{obj.name} Pose", frames, curves)


def clear_pose(obj: bpy.types.Object) -> None:
    """Take back the pose that an earlier bake gave `obj`."""
    for path in ("delta_rotation", "delta_location"):
        remove_curves(obj, path)
    obj.delta_rotation_euler = obj.delta_location = (0.0, 0.0, 0.0)
    obj.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    bpy.context.view_layer.update()


def bake_parts(obj: bpy.types.Object, motion: HeadMotion, frames: NDArray[np.floating]) -> None:
    """Animate eyeballs by the gaze, lower teeth and tongue by the jaw, where `obj` has them as children."""
    jaw, gaze = (rotation_to_blender(r) for r in (motion.jaw, motion.gaze))
    for child in obj.children:
        part = child.get(PART_PROPERTY)
        if part in JAW_PARTS or part in EYE_PARTS:
            turns = jaw if part in JAW_PARTS else gaze
            write_curves(child, f"{child.name} Motion", frames, _rotation_curves(child, turns))


def set_range(scene: bpy.types.Scene, frames: NDArray[np.floating]) -> None:
    """Let the scene play the whole of `frames`."""
    scene.frame_start = int(np.floor(frames[0] + 1e-3))
    scene.frame_end = max(scene.frame_start, int(np.ceil(frames[-1] - 1e-3)))


def _rotation_curves(obj: bpy.types.Object, rotations: NDArray[np.floating]) -> list[Curve]:
    """Curves of the delta rotation that `obj` reads in its rotation mode, without jumps between equal attitudes."""
    if obj.rotation_mode == "AXIS_ANGLE":
        obj.rotation_mode = "XYZ"
    matrices = [Matrix(rotation.tolist()) for rotation in rotations]
    if obj.rotation_mode == "QUATERNION":
        path, values = "delta_rotation_quaternion", np.array([matrix.to_quaternion() for matrix in matrices])
        flips = np.cumprod(np.where((values[1:] * values[:-1]).sum(axis=1) < 0, -1.0, 1.0))
        values[1:] *= flips[:, None]
    else:
        path, values, previous = "delta_rotation_euler", np.empty((len(matrices), 3)), Euler((0.0, 0.0, 0.0))
        for row, matrix in zip(values, matrices, strict=True):
            previous = matrix.to_euler(obj.rotation_mode, previous)
            row[:] = previous
    return [Curve(path, i, column) for i, column in enumerate(values.T)]

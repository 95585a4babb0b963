"""Whether the pose that a session shows was made part of the rest shape, as Blender's Apply does it meanwhile."""

from __future__ import annotations

import bpy
import numpy as np

from ..meshes import rest_bones
from ..own_pose import Posable, prefix_of, rotation_channel
from .targets import PoseTarget

_POSED = 1e-3
"""Angle in radians, or distance in the unit of the scene, above which channels count as posed."""
_SAMPLED = 8
"""Vertices that tell whether a mesh was transformed."""
_FRAMES = 32
"""Frames from one reading of the shape at rest to the next, about a second. With more, a mesh that was edited is
mistaken for one to which the pose was applied when its pose is cleared; with fewer, each frame takes longer."""


class AppliedPose:
    """Watches the pose of an object or a bone: `note` after each frame is shown, and `happened` before the next one."""

    def __init__(self, target: PoseTarget) -> None:
        self._target = target
        self._posed, self._frames = False, 0
        self._rest: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Name of the object or bone."""
        return self._target.owner.name

    def note(self) -> None:
        """Remember whether there is a pose, and at times the shape at rest, as this is called in each frame."""
        if not self._target.exists:
            return
        owner = self._target.owner
        self._posed = not _at_rest(owner)
        if self._frames % _FRAMES == 0:
            self._rest = _rest_shape(owner)
        self._frames += 1

    def happened(self) -> bool:
        """Return, once, whether the pose has gone since, and the shape at rest has changed."""
        if not self._posed or not self._target.exists or not _at_rest(owner := self._target.owner):
            return False
        rest, before = _rest_shape(owner), self._rest
        self._posed, self._frames = False, 0
        return len(rest) == len(before) and not np.allclose(rest, before, atol=1e-6)


def _at_rest(owner: Posable) -> bool:
    """Return whether the channels are as Blender's Apply and Clear leave them."""
    prefix, channel = prefix_of(owner), rotation_channel(owner)
    values = getattr(owner, f"{prefix}{channel}", (0.0,))  # an object has no delta rotation by axis and angle
    parts = values[1:] if channel == "rotation_quaternion" else values[:1] if "angle" in channel else values[:]
    least = _POSED / 2.0 if channel == "rotation_quaternion" else _POSED
    return all(abs(part) <= least for part in parts) and getattr(owner, f"{prefix}location").length <= _POSED


def _rest_shape(owner: Posable) -> tuple[float, ...]:
    """Return some coordinates of the shape at rest: of the vertices of a mesh, or of a bone."""
    if isinstance(owner, bpy.types.PoseBone):
        armature = owner.id_data
        assert isinstance(armature, bpy.types.Object)
        return tuple(value for row in rest_bones(armature)[owner.name].matrix_local[:] for value in row[:])
    if not isinstance(owner.data, bpy.types.Mesh):
        return ()
    vertices = owner.data.vertices
    step = max(1, len(vertices) // _SAMPLED)
    return tuple(value for number in range(0, len(vertices), step) for value in vertices[number].co[:])

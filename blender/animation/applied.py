"""Whether the pose that a session shows was made part of the rest shape, as Blender's Apply does it meanwhile."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.numeric.arrays import FloatArray
from ..meshes import rest_bones
from ..own_pose import Posable, own_pose, pose_of
from .targets import PoseTarget

_POSED = 1e-3
"""Least angle in radians, or distance in the unit of the scene, of a pose that is told from rest."""
_SAMPLED = 8
"""Vertices that tell whether a mesh was transformed."""


class AppliedPose:
    """Watches the pose of an object or a bone: `note` after each frame is shown, and `happened` before the next one."""

    def __init__(self, target: PoseTarget) -> None:
        self._target = target
        self._posed, self._rest = False, np.empty(0)

    @property
    def name(self) -> str:
        """Name of the object or bone."""
        return self._target.owner.name

    def note(self) -> None:
        """Remember the pose, and the shape at rest."""
        if self._target.exists:
            owner = self._target.owner
            own, now = own_pose(owner), pose_of(owner)
            turned = own.rotation.to_quaternion().rotation_difference(now.rotation.to_quaternion()).angle
            self._posed = turned > _POSED or (own.location - now.location).length > _POSED
            self._rest = _rest_shape(owner)

    def happened(self) -> bool:
        """Return, once, whether the pose has gone since, and the shape at rest has changed."""
        if not self._posed or not self._target.exists:
            return False
        owner = self._target.owner
        now = pose_of(owner)
        if now.rotation.to_quaternion().angle > _POSED or now.location.length > _POSED:
            return False
        rest = _rest_shape(owner)
        self._posed = False
        return len(rest) == len(self._rest) and not np.allclose(rest, self._rest, atol=1e-6)


def _rest_shape(owner: Posable) -> FloatArray:
    """Return some coordinates of the shape at rest: of the vertices of a mesh, or of a bone."""
    if isinstance(owner, bpy.types.PoseBone):
        armature = owner.id_data
        assert isinstance(armature, bpy.types.Object)
        return np.array(rest_bones(armature)[owner.name].matrix_local).ravel()
    if not isinstance(owner.data, bpy.types.Mesh):
        return np.empty(0)
    vertices = owner.data.vertices
    chosen = np.linspace(0, len(vertices) - 1, min(_SAMPLED, len(vertices)), dtype=int).tolist()
    return np.array([vertices[number].co for number in chosen]).ravel()

"""Targets of a pose, live and baked: an object, by its delta transform, or a bone of an armature.

The delta transform leaves the location and rotation of the object to the artist. What the artist has put there, or in
the channels of a bone, is kept: the performance is added to it (`blender.own_pose`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, NamedTuple

import bpy
import numpy as np
from mathutils import Euler, Matrix, Quaternion, Vector
from numpy.typing import NDArray

from ...core.drive.posing import eye_strength
from ...core.errors import HeadError
from ...core.face.landmarks import EYE_CORNERS
from ...core.face.rotation import limit_rotation
from ...core.numeric.arrays import IntArray
from ..actions import Curve
from ..carriers import turning
from ..characters import (
    own_rotation,
    parent_matrix,
    parent_rotation,
    placed_scale,
    read_bones,
    rest_matrix,
    rest_rotation,
    stored_bones,
)
from ..eye_bones import Aim, aim_of
from ..frames import rotation_to_blender, to_blender
from ..meshes import exists, mesh_of, posed_bones, read_places, read_vertices, rest_bones
from ..names import PIVOT_PROPERTY
from ..own_pose import (
    begin_live,
    hold_own,
    keep_pose,
    own_mode,
    own_pose,
    path_of,
    prefix_of,
    release_own,
    rotation_channel,
    write_rotation,
)

FloatArray = NDArray[np.floating[Any]]

_REACH = 0.5
"""Distance of the skin from the neck, relative to the tolerance of lengths divided by that of angles (`ANGLE`)."""


class Placement(NamedTuple):
    """Where the user's animation places a target in N frames; None where it does not.

    Attributes
    ----------
    rotations : (N, 3, 3) array or None
        Of an object, without its delta transform.
    angles : (N, 3) array or None
        Euler angles of the channels of the pose, radians; Blender adds those of a bake to each of them.
    """

    rotations: FloatArray | None = None
    angles: FloatArray | None = None


_STILL = Placement()


@dataclass(frozen=True)
class PoseTarget:
    """An object, or the bone of an armature that `bone` names; "" for the object itself.

    Attributes
    ----------
    head : bpy.types.Object, optional
        The head in whose axes the pose is given; the object itself by default.
    pivot : (float, float, float), optional
        Point about which an object turns, in the axes of the head; its own origin by default. A bone turns about its
        head.
    strength : float
        Factor of the angles of rotations.
    looking : tuple of str
        Bones that look at this one. It is moved so that they turn, about the middle of their heads, instead of being
        rotated itself.
    """

    obj: bpy.types.Object
    bone: str = ""
    head: bpy.types.Object | None = None
    pivot: tuple[float, float, float] | None = None
    strength: float = 1.0
    looking: tuple[str, ...] = ()

    @classmethod
    def of(cls, obj: bpy.types.Object, bone: str = "", head: bpy.types.Object | None = None) -> PoseTarget:
        """Return the target for an object, or for a bone, which an armature requires; others ignore it.

        Raises HeadError if an armature does not have that bone.
        """
        if obj.type == "ARMATURE" and not bone:
            raise HeadError(
                "No bone of the armature {name} is selected. Choose the bone that follows the pose.", name=obj.name
            )
        if obj.type == "ARMATURE" and bone not in posed_bones(obj):
            raise HeadError(
                "The armature {name} has no bone {bone}. Choose one of its bones.", name=obj.name, bone=bone
            )
        return cls(obj, bone if obj.type == "ARMATURE" else "", head)

    @property
    def exists(self) -> bool:
        """Whether the object and its bone still exist, and the head."""
        if not exists(self.obj) or (self.head is not None and not exists(self.head)):
            return False
        if not self.bone:
            return True
        return self.obj.pose is not None and all(name in self.obj.pose.bones for name in (self.bone, *self.looking))

    @property
    def owner(self) -> bpy.types.Object | bpy.types.PoseBone:
        """The object or pose bone that is rotated."""
        return posed_bones(self.obj)[self.bone] if self.bone else self.obj

    def turned(self, rotation: FloatArray, placed: FloatArray | None = None) -> FloatArray:
        """Convert (..., 3, 3) rotations from the head frame to the target's channels, without the user's own pose.

        `placed` are the rotations of an animated object by its user; by default its current one.
        """
        axes = self._axes(placed)
        if self.strength != 1.0:
            every = [limit_rotation(one, self.strength, pi) for one in np.reshape(rotation, (-1, 3, 3))]
            rotation = np.reshape(every, np.shape(rotation))
        return np.asarray(axes @ rotation_to_blender(rotation) @ np.swapaxes(axes, -1, -2))

    def moved(self, translation: FloatArray, placed: FloatArray | None = None) -> FloatArray:
        """Convert (..., 3) translations from the head frame, in the unit of the head, as `turned` does rotations."""
        axes = self._axes(placed)
        if self.bone:
            axes = np.array(own_pose(self.owner).rotation) @ axes
        return np.asarray((axes @ (to_blender(translation) * self._scale())[..., None])[..., 0])

    def begin(self) -> None:
        """Prepare for being posed: what an earlier session left ends, and the user's own pose is remembered."""
        begin_live(self.owner)

    def apply(self, rotation: FloatArray | None, translation: FloatArray | None) -> None:
        """Set a rotation (3, 3) and a translation (3,) in the head frame and its unit; None leaves it unchanged."""
        owner = self.owner
        hold_own(owner)
        if (
            isinstance(owner, bpy.types.Object) and own_mode(owner) == "AXIS_ANGLE"
        ):  # its animation goes on in channels that are not shown
            owner.rotation_quaternion = own_rotation(owner).to_quaternion()
        if rotation is not None and not self.looking:
            write_rotation(owner, Matrix(self._added(self.turned(rotation)).tolist()))
        if (location := self._location(rotation, translation)) is not None:
            setattr(owner, f"{prefix_of(owner)}location", location.tolist())

    @property
    def channels(self) -> list[str]:
        """Data paths of the rotation and the location."""
        channels = [
            "rotation_quaternion",
            "rotation_euler",
            "location",
            *(["rotation_axis_angle"] if self.bone else []),
        ]
        return [f"{path_of(self.owner)}{channel}" for channel in channels]

    def curves(
        self,
        rotations: FloatArray | None,
        translations: FloatArray | None,
        angle: float | None = None,
        length: float | None = None,
        placed: Placement = _STILL,
    ) -> list[Curve]:
        """Return the curves of N rotations and translations, as for `apply`, and remember the user's own pose.

        The tolerances of `Curve` are an angle in radians, and a length in the unit of the head. `placed` is for the
        same frames.
        """
        if rotations is None and translations is None:
            return []
        hold_own(self.owner)
        if angle and length and not self.bone and rotations is not None:
            angle = self._finer(angle, length)
        curves = []
        if self.looking:
            length = None if angle is None else angle * float(np.linalg.norm(self._about()))
        elif rotations is not None:
            turns = self._added(self.turned(rotations, placed.rotations))
            curves = self._rotation_curves(turns, angle, placed.angles)
        if (locations := self._location(rotations, translations, placed.rotations)) is not None:
            if length is not None and not self.looking:
                length *= float(self._scale().min())
            curves += self._curves("location", locations, length)
        return curves

    def _finer(self, angle: float, length: float) -> float:
        """Return the tolerance of angles with which an object that is far from the point about which it turns, as a
        figure with its origin at its feet is, moves the head within the same error.
        """
        if self.pivot is None:
            return angle
        arm, reach = float(np.linalg.norm(self._about() / self._scale())), _REACH * length / angle
        return angle * reach / (reach + arm)

    def _added(self, turns: FloatArray) -> FloatArray:
        """Return (..., 3, 3) rotations of the channels: `turns` about the axes of what the user's own pose turns."""
        own = np.array(own_pose(self.owner).rotation)
        return np.asarray(own @ turns if self.bone else turns @ own)

    def _rotation_curves(
        self, rotations: FloatArray, tolerance: float | None, added_to: FloatArray | None
    ) -> list[Curve]:
        """Return curves of (N, 3, 3) rotations of the channels, without jumps between equivalent angles; what has to be
        added to (N, 3) angles to rotate further by that much if there are such.
        """
        owner = self.owner
        channel, matrices = rotation_channel(owner), [Matrix(rotation.tolist()) for rotation in rotations]
        if channel == "rotation_euler":
            own = own_pose(owner).rotation.to_euler(owner.rotation_mode)
            placed = (
                [own] * len(matrices) if added_to is None else [Euler(one, owner.rotation_mode) for one in added_to]
            )
            values, offset = np.empty((len(matrices), 3)), Vector()
            for row, matrix, at in zip(values, matrices, placed, strict=True):
                turned = matrix if added_to is None else at.to_matrix() @ matrix
                near = Euler((Vector(at[:]) + offset)[:], owner.rotation_mode)
                row[:] = turned.to_euler(owner.rotation_mode, near)
                offset = Vector(row) - Vector(at[:])
            return self._curves(channel, values if added_to is None else values - added_to, tolerance)
        values = continuous_quaternions([matrix.to_quaternion() for matrix in matrices])
        if channel == "rotation_quaternion" and tolerance is not None:
            tolerance /= 2.0  # a quaternion changes by half of the angle
        return self._curves(channel, values if channel == "rotation_quaternion" else _axis_angles(values), tolerance)

    def rest(self) -> None:
        """Give back the user's own pose."""
        release_own(self.owner)

    def keep(self) -> None:
        """Leave the pose as `apply` set it."""
        keep_pose(self.owner)

    def _location(
        self, rotation: FloatArray | None, translation: FloatArray | None, placed: FloatArray | None = None
    ) -> FloatArray | None:
        """Return (..., 3) values of the location's channels; None if they are not changed."""
        location = None if translation is None else self.moved(translation, placed)
        if rotation is not None and (self.looking or (not self.bone and self.pivot is not None)):
            about = self._about()
            around = about - self.turned(rotation, placed) @ about
            location = around if location is None else location + around
        return None if location is None else location + np.array(own_pose(self.owner).location)

    def _about(self) -> FloatArray:
        """Return (3,) from the location to the point about which it turns, in the space of the parent or of a bone."""
        if self.looking:
            bones = rest_bones(self.obj)
            middle = np.mean([np.array(bones[name].head_local) for name in self.looking], axis=0)
            away = self._bone_axes().T @ (middle - np.array(bones[self.bone].head_local))
            return np.asarray(away - np.array(own_pose(self.owner).location))
        in_world = rest_matrix(self.head or self.obj) @ Vector(self.pivot or (0.0, 0.0, 0.0))
        placed = self.obj.location + own_pose(self.obj).location
        return np.array(parent_matrix(self.obj).inverted_safe() @ in_world - placed)

    def _axes(self, placed: FloatArray | None = None) -> FloatArray:
        """Return (..., 3, 3) from the head's axes in Blender to those of the channels, with negative scales."""
        head = self.head or self.obj
        mirrored = np.where(np.array(placed_scale(head)) < 0.0, -1.0, 1.0)
        if self.bone:
            return np.asarray((rest_rotation(self.obj) @ self._bone_axes()).T @ rest_rotation(head) * mirrored)
        if head == self.obj:
            own = np.array(own_rotation(self.obj)) if placed is None else placed
            return np.asarray(np.array(own_pose(self.obj).rotation) @ own * mirrored)
        return np.asarray(parent_rotation(self.obj).T @ rest_rotation(head) * mirrored)

    def _bone_axes(self) -> FloatArray:
        """Return (3, 3) from the axes of the channels of the bone to those of its armature."""
        bone = rest_bones(self.obj)[self.bone]
        return (
            np.eye(3)
            if self.looking and not bone.use_local_location
            else np.array(bone.matrix_local.to_3x3().normalized())
        )

    def _scale(self) -> FloatArray:
        """Return (3,) the length of the head's units along its axes, in units of the target's channels."""
        head = self.head or self.obj
        if self.bone:
            space = rest_matrix(self.obj)
        elif head == self.obj:
            return np.asarray(np.abs(np.array(placed_scale(head))))
        else:
            space = parent_matrix(self.obj)
        return np.full(3, rest_matrix(head).median_scale / max(space.median_scale, 1e-12))

    def _curves(self, channel: str, values: FloatArray, tolerance: float | None) -> list[Curve]:
        path = f"{path_of(self.owner)}{channel}"
        return [Curve(path, i, column, tolerance) for i, column in enumerate(values.T)]


def continuous_quaternions(quaternions: Sequence[Quaternion]) -> FloatArray:
    """Return (N, 4) quaternions of the same rotations, each on the side of the one before."""
    values = np.array(quaternions)
    flips = np.cumprod(np.where((values[1:] * values[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    values[1:] *= flips[:, None]
    return values


def _axis_angles(quaternions: FloatArray) -> FloatArray:
    """Return (N, 4) angles and axes of continuous quaternions, each axis on the side of the one before."""
    values, last = np.empty_like(quaternions), Vector((0.0, 1.0, 0.0))
    for row, quaternion in zip(values, quaternions, strict=True):
        axis, angle = Quaternion(quaternion.tolist()).to_axis_angle()
        side = -1.0 if axis.dot(last) < 0.0 else 1.0
        last = side * axis
        row[:] = (side * angle, *last[:])
    return values


def own_targets(head: bpy.types.Object) -> dict[str, PoseTarget]:
    """Return the default targets of a head's pose: the bones that were found when it was bound, or the head.

    These are "head", and "eye_left" and "eye_right" if bones rotate the eyes: the controls at which they look, if they
    have such. If both look at the same one, it is "eye_left".
    """
    armature, bones = read_bones(head)
    if armature is None or not bones.head:
        pivot = head.get(PIVOT_PROPERTY)
        targets = {"head": PoseTarget(head, head=head, pivot=None if pivot is None else tuple(pivot))}
    else:
        targets = {"head": PoseTarget(*turning(armature, bones.head), head)}
    for eye, corners in (("eye_left", EYE_CORNERS[2:]), ("eye_right", EYE_CORNERS[:2])):
        if armature is not None and (bone := getattr(bones, eye)):
            target = PoseTarget(armature, bone, head)
            target = replace(target, strength=_eye_strength(head, target, corners))
            aim = aim_of(armature, bone, bones.head)
            targets[eye] = target if aim is None else _moving(target, aim)
    if len(targets) == 3 and targets["eye_left"].owner == targets["eye_right"].owner:
        own, other = targets["eye_left"], targets.pop("eye_right")
        if own.pivot is not None and other.pivot is not None:
            middle = Vector(own.pivot).lerp(other.pivot, 0.5)
            own = replace(own, pivot=(middle.x, middle.y, middle.z))
        targets["eye_left"] = replace(own, looking=(*own.looking, *other.looking))
    return targets


def require_bone(head: bpy.types.Object, targets: Mapping[str, PoseTarget]) -> None:
    """Raise HeadError if the pose would turn the head itself only because the bone that turned it is missing."""
    armature, bones = read_bones(head)
    lost = stored_bones(head).get("head", "")
    turned = targets.get("head")
    if armature is not None and lost and not bones.head and turned is not None and turned.obj == head:
        raise HeadError(
            "The bone {bone} of {armature}, which turns the head, is missing. Choose another one, or None, in "
            "Head > Character.",
            bone=lost,
            armature=armature.name,
        )


def _moving(eye: PoseTarget, aim: Aim) -> PoseTarget:
    """Return the target that moves what an eye looks at, so that the eye turns."""
    if aim.bone:
        return replace(eye, bone=aim.bone, looking=(eye.bone,))
    assert eye.head is not None
    middle = rest_matrix(eye.obj) @ rest_bones(eye.obj)[eye.bone].head_local
    pivot = rest_matrix(eye.head).inverted_safe() @ middle
    return replace(eye, obj=aim.obj, bone="", pivot=(pivot.x, pivot.y, pivot.z))


def _eye_strength(head: bpy.types.Object, target: PoseTarget, corners: IntArray) -> float:
    """Return the factor of the rotations of a bone that keeps the iris between the lids."""
    to_world = rest_matrix(head)
    places = to_blender(read_vertices(mesh_of(head))[read_places(head)[corners]])
    pivot = rest_matrix(target.obj) @ rest_bones(target.obj)[target.bone].head_local
    return eye_strength(np.array(pivot), np.array([to_world @ Vector(place) for place in places.tolist()]))

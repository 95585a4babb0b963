"""Targets of a pose, live and baked: an object, by its delta transform, or a bone of an armature.

The delta transform leaves the location and rotation of the object to the artist.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Euler, Matrix
from numpy.typing import NDArray

from ...core.errors import HeadError
from ..actions import Curve
from ..frames import rotation_to_blender, to_blender
from ..meshes import exists

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class PoseTarget:
    """An object, or a bone of an armature.

    Attributes
    ----------
    obj : bpy.types.Object
    bone : str
        Name of the bone; "" for the object itself.
    """

    obj: bpy.types.Object
    bone: str = ""

    @classmethod
    def of(cls, obj: bpy.types.Object, bone: str = "") -> PoseTarget:
        """Return the target for an object.

        Parameters
        ----------
        obj : bpy.types.Object
        bone : str
            Required for an armature, ignored for other objects.

        Raises
        ------
        HeadError
            If an armature does not have that bone.
        """
        if obj.type == "ARMATURE" and not bone:
            raise HeadError(f"No bone of the armature {obj.name} is selected. Choose the bone that takes the pose.")
        if obj.type == "ARMATURE" and bone not in obj.pose.bones:
            raise HeadError(f"The armature {obj.name} has no bone {bone}. Choose one of its bones.")
        return cls(obj, bone if obj.type == "ARMATURE" else "")

    @property
    def exists(self) -> bool:
        """Whether the object and its bone still exist."""
        return exists(self.obj) and (not self.bone or (self.obj.pose is not None and self.bone in self.obj.pose.bones))

    @property
    def owner(self) -> bpy.types.Object | bpy.types.PoseBone:
        """The object or pose bone that is rotated."""
        return self.obj.pose.bones[self.bone] if self.bone else self.obj

    @property
    def prefix(self) -> str:
        """Prefix of the attributes for rotation and location."""
        return "" if self.bone else "delta_"

    @property
    def path(self) -> str:
        """Prefix of these attributes in an RNA path of the object."""
        return f'pose.bones["{bpy.utils.escape_identifier(self.bone)}"].' if self.bone else ""

    def turned(self, rotation: FloatArray) -> FloatArray:
        """Convert (..., 3, 3) rotations from the head frame to the target's channels."""
        axes = self._axes()
        return np.asarray(axes @ rotation_to_blender(rotation) @ axes.T)

    def moved(self, translation: FloatArray) -> FloatArray:
        """Convert (..., 3) translations from the head frame, in the unit of the head, to the target's channels."""
        scale = 1.0 if self.bone else np.abs(self.obj.scale)
        return np.asarray((to_blender(translation) * scale) @ self._axes().T)

    def apply(self, rotation: FloatArray | None, translation: FloatArray | None) -> None:
        """Set the pose.

        Parameters
        ----------
        rotation : (3, 3) array or None
            Head frame; None leaves the rotation unchanged.
        translation : (3,) array or None
            Head frame, the unit of the head; None leaves the location unchanged.
        """
        if rotation is not None:
            self._rotate(Matrix(self.turned(rotation).tolist()))
        if translation is not None:
            setattr(self.owner, f"{self.prefix}location", self.moved(translation).tolist())

    @property
    def data_paths(self) -> list[str]:
        """Data paths of all channels that a bake may animate."""
        channels = ("rotation_quaternion", "rotation_euler", "location")
        return [f"{self.path}{self.prefix}{channel}" for channel in channels]

    def rotation_curves(self, rotations: FloatArray, tolerance: float | None = None) -> list[Curve]:
        """Return curves of rotations, without jumps between equivalent angles.

        Parameters
        ----------
        rotations : (N, 3, 3) array
            Head frame.
        tolerance : float, optional
            As for `Curve`, radians.
        """
        owner = self.owner
        if owner.rotation_mode == "AXIS_ANGLE":
            owner.rotation_mode = "XYZ"
        matrices = [Matrix(rotation.tolist()) for rotation in self.turned(rotations)]
        if owner.rotation_mode == "QUATERNION":
            channel, values = "rotation_quaternion", np.array([matrix.to_quaternion() for matrix in matrices])
            flips = np.cumprod(np.where((values[1:] * values[:-1]).sum(axis=1) < 0, -1.0, 1.0))
            values[1:] *= flips[:, None]
        else:
            channel, values, previous = "rotation_euler", np.empty((len(matrices), 3)), Euler((0.0, 0.0, 0.0))
            for row, matrix in zip(values, matrices, strict=True):
                previous = matrix.to_euler(owner.rotation_mode, previous)
                row[:] = previous
        return self._curves(channel, values, tolerance)

    def translation_curves(self, translations: FloatArray, tolerance: float | None = None) -> list[Curve]:
        """Return curves of translations.

        Parameters
        ----------
        translations : (N, 3) array
            Head frame, the unit of the head.
        tolerance : float, optional
            As for `Curve`.
        """
        return self._curves("location", self.moved(translations), tolerance)

    def rest(self) -> None:
        """Reset the pose that `apply` set."""
        self._rotate(Matrix.Identity(3))
        setattr(self.owner, f"{self.prefix}location", (0.0, 0.0, 0.0))

    def _axes(self) -> FloatArray:
        """Return (3, 3) from the head's axes in Blender to those of the target's channels, with negative scales."""
        if self.bone:
            return np.array(self.obj.data.bones[self.bone].matrix_local.to_3x3()).T
        mirrored = np.where(np.array(self.obj.scale) < 0.0, -1.0, 1.0)
        return np.array(own_rotation(self.obj)) * mirrored

    def _curves(self, channel: str, values: FloatArray, tolerance: float | None) -> list[Curve]:
        path = f"{self.path}{self.prefix}{channel}"
        return [Curve(path, i, column, tolerance) for i, column in enumerate(values.T)]

    def _rotate(self, matrix: Matrix) -> None:
        owner, prefix = self.owner, self.prefix
        if owner.rotation_mode == "AXIS_ANGLE":
            owner.rotation_mode = "XYZ"
        if owner.rotation_mode == "QUATERNION":
            setattr(owner, f"{prefix}rotation_quaternion", matrix.to_quaternion())
        else:
            before = getattr(owner, f"{prefix}rotation_euler")
            setattr(owner, f"{prefix}rotation_euler", matrix.to_euler(owner.rotation_mode, before))


def own_rotation(obj: bpy.types.Object) -> Matrix:
    """Return the (3, 3) rotation of `obj` relative to its parent, without its delta rotation."""
    if obj.rotation_mode == "QUATERNION":
        return obj.rotation_quaternion.normalized().to_matrix()
    if obj.rotation_mode == "AXIS_ANGLE":
        angle, *axis = obj.rotation_axis_angle
        return Matrix.Rotation(angle, 3, axis)
    return obj.rotation_euler.to_matrix()

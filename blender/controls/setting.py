"""Values of controls: written as changes from rest, and restored bit for bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Quaternion, Vector
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import PROPERTY, ROTATION, RigChannel
from ..meshes import posed_bones
from ..own_pose import ROTATIONS, matrix_of, rotation_channel

Holder = bpy.types.Object | bpy.types.PoseBone
_Group = tuple[str, str, str, str]
"""Owner, bone, kind and name of a property: the channels that are set together."""


class ControlValues:
    """The channels of a rig, with the values that they had at the start.

    Only names are kept, and what tells objects apart when they are renamed, so that an undo may come between two calls.
    Raises HeadError if a control is missing.
    """

    def __init__(self, channels: Sequence[RigChannel]) -> None:
        self.channels = tuple(channels)
        groups: dict[_Group, list[int]] = {}
        for number, channel in enumerate(self.channels):
            groups.setdefault((channel.owner, channel.bone, channel.kind, channel.name), []).append(number)
        self._groups = {group: np.array(numbers, dtype=np.intp) for group, numbers in groups.items()}
        self._axes = np.array([channel.index for channel in self.channels], dtype=np.intp)
        self._at_rest = np.array([channel.rest for channel in self.channels])
        self._uids: dict[str, int] = {}
        for owner in dict.fromkeys(owner for owner, *_ in self._groups):
            self._uids[owner] = object_with(owner).session_uid
        self.remember()

    def remember(self) -> None:
        """Take the values that the channels have now as those that they had at the start."""
        self._own = {group: self._read(group) for group in self._groups}
        self._written = np.full(len(self.channels), np.nan)

    def write(self, values: FloatArray) -> None:
        """Set the channels to changes from rest, (C,)."""
        changed = values != self._written
        for group, numbers in self._groups.items():
            if changed[numbers].any():
                holder = holder_in(self._require(group[0]), group[1])
                _write(holder, group, self._own[group], self._axes[numbers], (self._at_rest + values)[numbers])
        self._written = np.array(values, dtype=np.float64)

    def forget(self) -> None:
        """Set all channels the next time, as the user may have changed some."""
        self._written[:] = np.nan

    def read(self) -> FloatArray:
        """Return the changes of the channels from rest as they are now, (C,)."""
        found = np.empty(len(self.channels))
        for group, numbers in self._groups.items():
            found[numbers] = self._vector(group)[self._axes[numbers]] - self._at_rest[numbers]
        return found

    @property
    def owners(self) -> dict[str, bpy.types.Object]:
        """The objects that have channels, as far as they exist, by the names that they had at the start."""
        found = {owner: self._find(owner) for owner in self._uids}
        return {owner: obj for owner, obj in found.items() if obj is not None}

    def own_of(self, owner: bpy.types.Object) -> list[list[Any]]:
        """Return the values that the channels of an object had: bone, kind, name, and the value."""
        return [
            [bone, kind, name, own]
            for (obj, bone, kind, name), own in self._own.items()
            if self._uids[obj] == owner.session_uid
        ]

    def _find(self, owner: str) -> bpy.types.Object | None:
        """Return the object that had the name `owner` at the start; None if it was deleted."""
        return object_known_as(self._uids[owner], owner)

    def _require(self, owner: str) -> bpy.types.Object:
        if (obj := self._find(owner)) is None:
            raise missing(owner)
        return obj

    def _read(self, group: _Group) -> Any:
        return _read(holder_in(self._require(group[0]), group[1]), group[2], group[3])

    def _vector(self, group: _Group) -> FloatArray:
        """Return a location, a scale, a rotation vector, or a property, (3,)."""
        value = self._read(group)
        if group[2] != ROTATION:
            return np.broadcast_to(np.asarray(value, dtype=np.float64), 3)
        holder = holder_in(self._require(group[0]), group[1])
        if has_locked_angles(holder):
            return np.where(_locked(holder), 0.0, np.asarray(value, dtype=np.float64))
        axis, angle = matrix_of(holder.rotation_mode, value).to_quaternion().to_axis_angle()
        return np.array(axis) * (angle - 2.0 * np.pi if angle > np.pi else angle)

    def restore(self) -> None:
        """Give every channel the value that it had, to the last bit; controls that were deleted are left out."""
        for (owner, bone, kind, name), own in self._own.items():
            obj = self._find(owner)
            if obj is None or not _has(obj, bone):
                continue
            holder = holder_in(obj, bone)
            if kind == PROPERTY:
                holder[name] = own
            else:
                setattr(holder, _attribute(holder, kind), own)
            holder.id_data.update_tag()
        self._written[:] = np.nan
        bpy.context.view_layer.update()


@contextmanager
def held(channels: Sequence[RigChannel]) -> Iterator[ControlValues]:
    """Set channels for a while; afterwards they have the values that they had."""
    values = ControlValues(channels)
    try:
        yield values
    finally:
        values.restore()


def holder_of(owner: str, bone: str) -> Holder:
    """Return the bone or object that has a channel; raises HeadError if it is missing."""
    if (obj := bpy.data.objects.get(owner)) is None:
        raise missing(bone or owner)
    return holder_in(obj, bone)


def holder_in(obj: bpy.types.Object, bone: str) -> Holder:
    """Return the bone of an object that has a channel, or the object; raises HeadError if it is missing."""
    if not _has(obj, bone):
        raise missing(bone)
    return posed_bones(obj)[bone] if bone else obj


def object_known_as(uid: int, name: str) -> bpy.types.Object | None:
    """Return the object with a `session_uid`, which had a name before; None if it was deleted."""
    obj = bpy.data.objects.get(name)
    if obj is not None and obj.session_uid == uid:
        return obj
    return next((obj for obj in bpy.data.objects if obj.session_uid == uid), None)


def object_with(name: str) -> bpy.types.Object:
    """Return an object with channels; raises HeadError if it is missing."""
    if (obj := bpy.data.objects.get(name)) is None:
        raise missing(name)
    return obj


def missing(control: str) -> HeadError:
    """Return the error of a control that is missing."""
    return HeadError("The control {name} is missing. Learn the controls again.", name=control)


def _has(obj: bpy.types.Object, bone: str) -> bool:
    return not bone or (obj.type == "ARMATURE" and bone in posed_bones(obj))


def _attribute(holder: Holder, kind: str) -> str:
    return rotation_channel(holder) if kind == ROTATION else kind


def _read(holder: Holder, kind: str, name: str) -> Any:
    if kind == PROPERTY:
        if not isinstance(holder.get(name), float):
            raise missing(name)
        return holder[name]
    return tuple(getattr(holder, _attribute(holder, kind)))


def _write(holder: Holder, group: _Group, own: Any, axes: NDArray[np.intp], values: FloatArray) -> None:
    """Set the channels of a group; axes without a channel keep their location and scale, and are not turned."""
    _owner, _bone, kind, name = group
    if kind == PROPERTY:
        holder[name] = float(values[0])
        holder.id_data.update_tag()
        return
    vector = np.array((0.0, 0.0, 0.0) if kind == ROTATION else own)
    vector[axes] = values
    value = turned(holder, vector, own) if kind == ROTATION else vector.tolist()
    setattr(holder, _attribute(holder, kind), value)


def has_locked_angles(holder: Holder) -> bool:
    """Return whether some Euler angles of a control are locked: a rotation vector would change these, too."""
    return holder.rotation_mode not in ROTATIONS and any(holder.lock_rotation)


def _locked(holder: Holder) -> NDArray[np.bool_]:
    return np.array(holder.lock_rotation[:], dtype=bool)


def turned(
    holder: Holder, vector: FloatArray, own: Sequence[float], before: Sequence[float] | None = None
) -> tuple[float, ...]:
    """Return the value of the rotation of a control that turns it by a rotation vector (3,), near the one before.

    With locked Euler angles, which keep the value that they have in `own`, the vector has the other angles.
    """
    if has_locked_angles(holder):
        return tuple(np.where(_locked(holder), np.asarray(own), vector).tolist())
    return rotated(holder.rotation_mode, vector, before)


def rotated(mode: str, vector: FloatArray, before: Sequence[float] | None = None) -> tuple[float, ...]:
    """Return the value of a rotation in a mode that turns by a rotation vector (3,), radians, near the one before."""
    angle = float(np.linalg.norm(vector))
    axis = Vector((vector / angle).tolist()) if angle > 1e-12 else Vector((0.0, 1.0, 0.0))
    turn = Quaternion(axis, angle)
    if mode == "AXIS_ANGLE":
        side = -1.0 if before is not None and axis.dot(Vector(before[1:])) < 0.0 else 1.0
        return (side * angle, *(side * axis)[:])
    if mode == "QUATERNION":
        side = -1.0 if before is not None and turn.dot(Quaternion(before)) < 0.0 else 1.0
        return (side * turn.w, side * turn.x, side * turn.y, side * turn.z)
    return turn.to_euler(mode, Euler((0.0, 0.0, 0.0) if before is None else before, mode))[:]

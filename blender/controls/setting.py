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
from ..own_pose import matrix_of, rotation_channel

Holder = bpy.types.Object | bpy.types.PoseBone
_Group = tuple[str, str, str, str]
"""Owner, bone, kind and name of a property: the channels that are set together."""


class ControlValues:
    """The channels of a rig, with the values that they had at the start.

    Only names are kept, so that an undo may come between two calls. Raises HeadError if a control is missing.
    """

    def __init__(self, channels: Sequence[RigChannel]) -> None:
        self.channels = tuple(channels)
        groups: dict[_Group, list[int]] = {}
        for number, channel in enumerate(self.channels):
            groups.setdefault((channel.owner, channel.bone, channel.kind, channel.name), []).append(number)
        self._groups = {group: np.array(numbers, dtype=np.intp) for group, numbers in groups.items()}
        self._axes = np.array([channel.index for channel in self.channels], dtype=np.intp)
        self._at_rest = np.array([channel.rest for channel in self.channels])
        self._own = {group: _read(*group) for group in self._groups}
        self._uids = {owner: bpy.data.objects[owner].session_uid for owner, *_ in self._groups}
        self._written = np.full(len(self.channels), np.nan)

    def write(self, values: FloatArray) -> None:
        """Set the channels to changes from rest, (C,)."""
        changed = values != self._written
        for group, numbers in self._groups.items():
            if changed[numbers].any():
                _write(group, self._own[group], self._axes[numbers], (self._at_rest + values)[numbers])
        self._written = np.array(values, dtype=np.float64)

    @property
    def owners(self) -> list[bpy.types.Object]:
        """The objects that have the channels, as far as they exist; they may have been renamed."""
        there = {obj.session_uid: obj for obj in bpy.data.objects}
        return [there[uid] for uid in self._uids.values() if uid in there]

    def forget(self) -> None:
        """Set all channels the next time, as the user may have changed some."""
        self._written[:] = np.nan

    def read(self) -> FloatArray:
        """Return the changes of the channels from rest as they are now, (C,)."""
        found = np.empty(len(self.channels))
        for group, numbers in self._groups.items():
            found[numbers] = _vector(*group)[self._axes[numbers]] - self._at_rest[numbers]
        return found

    def own_of(self, owner: str) -> list[list[Any]]:
        """Return the values that the channels of an object had: bone, kind, name, and the value."""
        return [[bone, kind, name, own] for (obj, bone, kind, name), own in self._own.items() if obj == owner]

    def restore(self) -> None:
        """Give every channel the value that it had, to the last bit; controls that were deleted are left out."""
        for (owner, bone, kind, name), own in self._own.items():
            obj = bpy.data.objects.get(owner)
            if obj is None or obj.session_uid != self._uids[owner] or not _has(obj, bone):
                continue
            holder = holder_of(owner, bone)
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
    obj = bpy.data.objects.get(owner)
    if obj is None or not _has(obj, bone):
        raise HeadError("The control {name} is missing. Learn the controls again.", name=bone or owner)
    return posed_bones(obj)[bone] if bone else obj


def _has(obj: bpy.types.Object, bone: str) -> bool:
    return not bone or (obj.type == "ARMATURE" and bone in posed_bones(obj))


def _attribute(holder: Holder, kind: str) -> str:
    return rotation_channel(holder) if kind == ROTATION else kind


def _read(owner: str, bone: str, kind: str, name: str) -> Any:
    holder = holder_of(owner, bone)
    if kind == PROPERTY:
        if not isinstance(holder.get(name), float):
            raise HeadError("The control {name} is missing. Learn the controls again.", name=name)
        return holder[name]
    return tuple(getattr(holder, _attribute(holder, kind)))


def _vector(owner: str, bone: str, kind: str, name: str) -> FloatArray:
    """Return a location, a scale, a rotation vector, or a property, (3,)."""
    value = _read(owner, bone, kind, name)
    if kind != ROTATION:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), 3)
    mode = holder_of(owner, bone).rotation_mode
    axis, angle = matrix_of(mode, value).to_quaternion().to_axis_angle()
    return np.array(axis) * (angle - 2.0 * np.pi if angle > np.pi else angle)


def _write(group: _Group, own: Any, axes: NDArray[np.intp], values: FloatArray) -> None:
    """Set the channels of a group; axes without a channel keep their location and scale, and are not turned."""
    owner, bone, kind, name = group
    holder = holder_of(owner, bone)
    if kind == PROPERTY:
        holder[name] = float(values[0])
        holder.id_data.update_tag()
        return
    vector = np.array((0.0, 0.0, 0.0) if kind == ROTATION else own)
    vector[axes] = values
    value = rotated(holder.rotation_mode, vector) if kind == ROTATION else vector.tolist()
    setattr(holder, _attribute(holder, kind), value)


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

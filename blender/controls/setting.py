"""Values of controls: written as changes from rest, and restored bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Quaternion, Vector

from ...core.errors import HeadError
from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import LOCATION, PROPERTY, RigChannel
from ..meshes import posed_bones

Holder = bpy.types.Object | bpy.types.PoseBone


class ControlValues:
    """The channels of a rig, with the values that they had at the start.

    Only names are kept, so that an undo may come between two calls. Raises HeadError if a control is missing.
    """

    def __init__(self, channels: Sequence[RigChannel]) -> None:
        self.channels = tuple(channels)
        self._groups: dict[tuple[str, str, str], list[int]] = {}
        for number, channel in enumerate(self.channels):
            kind = f"{channel.kind}:{channel.name}" if channel.kind == PROPERTY else channel.kind
            self._groups.setdefault((channel.owner, channel.bone, kind), []).append(number)
        self._rest = {group: self._read(*group) for group in self._groups}

    def _read(self, owner: str, bone: str, kind: str) -> Any:
        holder = holder_of(owner, bone)
        if kind == LOCATION:
            return tuple(holder.location)
        if kind.startswith(PROPERTY):
            return holder[kind.partition(":")[2]]
        return holder.rotation_mode, tuple(_rotation(holder))

    def write(self, values: FloatArray) -> None:
        """Set the channels to changes from rest, (C,)."""
        for (owner, bone, kind), numbers in self._groups.items():
            holder, rest = holder_of(owner, bone), self._rest[owner, bone, kind]
            changes = np.zeros(3)
            for number in numbers:
                changes[self.channels[number].index if kind[:8] != PROPERTY else 0] = values[number]
            if kind == LOCATION:
                holder.location = Vector(rest) + Vector(changes)
            elif kind.startswith(PROPERTY):
                holder[kind.partition(":")[2]] = rest + float(changes[0])
                holder.id_data.update_tag()
            else:
                turn(holder, *rest, Vector(changes))

    def restore(self) -> None:
        """Give every channel the value that it had, to the last bit."""
        for (owner, bone, kind), rest in self._rest.items():
            holder = holder_of(owner, bone)
            if kind == LOCATION:
                holder.location = rest
            elif kind.startswith(PROPERTY):
                holder[kind.partition(":")[2]] = rest
            else:
                setattr(holder, _channel_of(rest[0]), rest[1])
        bpy.context.view_layer.update()


def holder_of(owner: str, bone: str) -> Holder:
    """Return the bone or object that has a channel; raises HeadError if there is none."""
    obj = bpy.data.objects.get(owner)
    if obj is None or (bone and (obj.type != "ARMATURE" or bone not in posed_bones(obj))):
        raise HeadError("The control {name} is missing. Use Learn Controls again.", name=bone or owner)
    return posed_bones(obj)[bone] if bone else obj


def _channel_of(mode: str) -> str:
    return {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}.get(mode, "rotation_euler")


def _rotation(holder: Holder) -> Any:
    return getattr(holder, _channel_of(holder.rotation_mode))


def turn(holder: Holder, mode: str, rest: Sequence[float], vector: Vector) -> None:
    """Turn a control from its rotation at rest by a rotation vector in its own axes, in its own rotation mode."""
    angle = vector.length
    own = Quaternion(vector / angle, angle) if angle > 1e-12 else Quaternion()
    if mode == "QUATERNION":
        holder.rotation_quaternion = Quaternion(rest) @ own
    elif mode == "AXIS_ANGLE":
        axis, amount = (Quaternion(Vector(rest[1:]), rest[0]) @ own).to_axis_angle()
        holder.rotation_axis_angle = (amount, *axis)
    else:
        before = Euler(rest, mode)
        holder.rotation_euler = (before.to_quaternion() @ own).to_euler(mode, before)

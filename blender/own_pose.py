"""The pose that the user gave an object or a bone: a performance is added to it, and it returns when that ends.

Objects are posed by their delta transform, and bones by their own channels. While a session or a bake poses them, the
user's values are in a custom property, as the channels hold the sum.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import bpy
from mathutils import Euler, Matrix, Quaternion, Vector

from .actions import baked_paths
from .fcurves import drivers_of
from .muting import curve_paths
from .names import OWN_POSE_PROPERTY

Posable = bpy.types.Object | bpy.types.PoseBone
ROTATIONS = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
"""Channels by rotation mode; all other modes are orders of Euler angles."""
_LIVE = "live"
"""Mark of a pose that a session sets, rather than a bake: the name that the object or bone had at its start."""
_DELTAS = "deltas"
"""Values of an object's delta rotations before a session, which poses another one if the user changes the mode."""
_SAME = 1e-5
"""Largest difference between two values of a channel that are equal: Blender stores single precision."""


class OwnPose(NamedTuple):
    """Location, and rotation as a (3, 3) matrix, in the space of the channels."""

    location: Vector
    rotation: Matrix


def prefix_of(owner: Posable) -> str:
    """Return the prefix of the attributes that hold the pose of an object or a bone."""
    return "delta_" if isinstance(owner, bpy.types.Object) else ""


def path_of(owner: Posable) -> str:
    """Return the prefix of these attributes in a data path."""
    bone = "" if isinstance(owner, bpy.types.Object) else f'pose.bones["{bpy.utils.escape_identifier(owner.name)}"].'
    return f"{bone}{prefix_of(owner)}"


def rotation_channel(owner: Posable) -> str:
    """Return the rotation channel that Blender reads in the rotation mode of `owner`, without the prefix."""
    return ROTATIONS.get(owner.rotation_mode, "rotation_euler")


def own_pose(owner: Posable) -> OwnPose:
    """Return the user's own pose, whether or not a performance is added to it."""
    stored = _stored(owner) or _unposed(owner)
    return OwnPose(Vector(stored["location"]), matrix_of(stored["mode"], stored["rotation"]))


def pose_of(owner: Posable) -> OwnPose:
    """Return the pose that the channels hold now, whoever has set them."""
    values = _channels(owner)
    return OwnPose(Vector(values["location"]), matrix_of(owner.rotation_mode, values["rotation"]))


def own_mode(owner: Posable) -> str:
    """Return the rotation mode that the user chose, even while a pose needs another."""
    stored = _stored(owner)
    return str(owner.rotation_mode if stored is None else stored.get("before", owner.rotation_mode))


def hold_own(owner: Posable, *, animated: bool = False) -> None:
    """Remember the user's own pose before `owner` is posed; does nothing if it is remembered.

    If `animated` is set, the pose includes what the user's animation gives it now; what is written is otherwise added
    to that. Objects have no delta rotation by axis and angle, so that their mode becomes QUATERNION for the time.
    """
    if OWN_POSE_PROPERTY in owner:
        return
    stored = _unposed(owner, animated=animated)
    if isinstance(owner, bpy.types.Object) and owner.rotation_mode == "AXIS_ANGLE":
        stored |= {"before": "AXIS_ANGLE", "quaternion": owner.rotation_quaternion[:]}
        owner.rotation_mode = "QUATERNION"
    owner[OWN_POSE_PROPERTY] = stored


def begin_live(owner: Posable) -> None:
    """End what an earlier session left, and remember the user's own pose until the session that begins has ended."""
    release_own(owner)
    hold_own(owner, animated=isinstance(owner, bpy.types.Object))
    stored = {**(_stored(owner) or {}), _LIVE: owner.name}
    if isinstance(owner, bpy.types.Object):
        stored[_DELTAS] = {
            "rotation_euler": owner.delta_rotation_euler[:],
            "rotation_quaternion": owner.delta_rotation_quaternion[:],
        }
    owner[OWN_POSE_PROPERTY] = stored


def live_as(owner: Posable) -> str | None:
    """Return the name of an object or a bone when the session that poses it began; None if no session does."""
    stored = _stored(owner) or {}
    return str(stored[_LIVE]) if _LIVE in stored else None


def note_name(owner: Posable) -> None:
    """Let `live_as` return the present name of an object or a bone, which was renamed in a session."""
    owner[OWN_POSE_PROPERTY] = {**(_stored(owner) or {}), _LIVE: owner.name}


def move_own(owner: Posable, values: Mapping[tuple[str, int], float]) -> None:
    """Put `owner` into the pose that the user's animation gives it in the current frame, and remember that.

    Values are by data path and array index; other channels stay.
    """
    if not values or (stored := _stored(owner)) is None:
        return
    channel = rotation_channel(owner)
    if stored["mode"] != owner.rotation_mode:
        still = [0.0] * 3 if channel == "rotation_euler" else [1.0, 0.0, 0.0, 0.0]
        stored |= {"mode": owner.rotation_mode, "rotation": still}
    for name, path in (("location", "location"), ("rotation", channel)):
        stored[name] = [values.get((f"{path_of(owner)}{path}", i), own) for i, own in enumerate(stored[name])]
    owner[OWN_POSE_PROPERTY] = stored
    _write(owner, stored)


def release_live(but: Collection[bpy.types.ID] = ()) -> None:
    """Give all objects and bones that a session posed the user's own pose back, except those of some objects."""
    for obj in bpy.data.objects:
        if obj.library is None and obj not in but:
            for owner in (obj, *(obj.pose.bones if obj.pose is not None else ())):
                if _LIVE in (_stored(owner) or ()):
                    release_own(owner)


def keep_pose(owner: Posable) -> None:
    """Note that a session leaves its pose, to which the next one is not added unless the user changes it."""
    if (stored := _stored(owner)) is not None:
        _restore_hidden(owner, stored)
        stored.pop(_LIVE, None)
        owner[OWN_POSE_PROPERTY] = {**stored, "kept": [*_channels(owner)["location"], *_channels(owner)["rotation"]]}


def release_own(owner: Posable) -> None:
    """Give `owner` the user's own pose back; it remains remembered while a bake still poses `owner`."""
    stored = _stored(owner)
    if stored is None:
        return
    if not _was_changed(owner, stored):
        _write(owner, stored)
    _restore_hidden(owner, stored)
    if _is_baked(owner):
        stored.pop(_LIVE, None)
        owner[OWN_POSE_PROPERTY] = stored
        return
    del owner[OWN_POSE_PROPERTY]
    if (mode := stored.get("before")) is not None and owner.rotation_mode == "QUATERNION":
        values = tuple(owner.rotation_axis_angle)  # a change of the mode converts them
        owner.rotation_mode = mode
        owner.rotation_axis_angle, owner.rotation_quaternion = values, stored["quaternion"]


def _restore_hidden(owner: Posable, stored: dict[str, Any]) -> None:
    """Restore the delta rotations of an object that its mode hides, which a session has posed in an earlier mode."""
    deltas = stored.pop(_DELTAS, {})
    for channel in ("rotation_euler", "rotation_quaternion"):
        if channel in deltas and channel != rotation_channel(owner):
            setattr(owner, f"delta_{channel}", deltas[channel])


def _write(owner: Posable, stored: dict[str, Any]) -> None:
    prefix, channel = prefix_of(owner), rotation_channel(owner)
    setattr(owner, f"{prefix}location", stored["location"])
    if channel == ROTATIONS.get(stored["mode"], "rotation_euler") and owner.rotation_mode == stored["mode"]:
        setattr(owner, f"{prefix}{channel}", stored["rotation"])
    else:
        write_rotation(owner, matrix_of(stored["mode"], stored["rotation"]))


def write_rotation(owner: Posable, rotation: Matrix) -> None:
    """Set the rotation of the pose, in the space of the channels, in the mode of `owner`."""
    prefix, channel = prefix_of(owner), rotation_channel(owner)
    if channel == "rotation_quaternion":
        values: Any = rotation.to_quaternion()
    elif channel == "rotation_axis_angle":
        axis, angle = rotation.to_quaternion().to_axis_angle()
        values = (angle, *axis[:])
    else:
        values = rotation.to_euler(owner.rotation_mode, getattr(owner, f"{prefix}{channel}"))
    if hasattr(owner, f"{prefix}{channel}"):
        setattr(owner, f"{prefix}{channel}", values)


def _stored(owner: Posable) -> dict[str, Any] | None:
    stored = owner.get(OWN_POSE_PROPERTY)
    return stored.to_dict() if hasattr(stored, "to_dict") else None


def _unposed(owner: Posable, *, animated: bool = False) -> dict[str, Any]:
    """Return the user's values of an owner for which none are stored: those it has, unless a bake put them there, or
    animation that is not `animated`.
    """
    moved = curve_paths(owner.id_data)
    if not isinstance(owner, bpy.types.Object):
        moved |= {
            driver.data_path for driver in drivers_of(owner.id_data)
        }  # of a bone they are motion, not a placement
    own, (location, *rotations) = {"mode": owner.rotation_mode, **_channels(owner)}, _paths(owner)
    if _is_baked(owner) or (location in moved and not animated):
        own["location"] = [0.0] * 3
    if _is_baked(owner) or not (animated or moved.isdisjoint(rotations)):
        own |= {"mode": "QUATERNION", "rotation": [1.0, 0.0, 0.0, 0.0]}
    return own


def _channels(owner: Posable) -> dict[str, Any]:
    """Return the values of the channels; an object has no delta rotation by axis and angle."""
    prefix, none = prefix_of(owner), (0.0, 0.0, 1.0, 0.0)
    rotation = getattr(owner, f"{prefix}{rotation_channel(owner)}", none)
    return {"location": list(getattr(owner, f"{prefix}location")), "rotation": list(rotation)}


def matrix_of(mode: str, values: Any) -> Matrix:
    """Return the (3, 3) rotation that the values of the channel of a rotation mode stand for."""
    if mode == "QUATERNION":
        return Quaternion(values).normalized().to_matrix()
    if mode == "AXIS_ANGLE":
        angle, *axis = values
        return Matrix.Rotation(angle, 3, axis)
    return Euler(values, mode).to_matrix()


def _is_baked(owner: Posable) -> bool:
    """Return whether a bake animates the pose."""
    return not baked_paths(owner.id_data).isdisjoint(_paths(owner))


def _paths(owner: Posable) -> list[str]:
    """Return the data paths of the channels in all rotation modes."""
    return [f"{path_of(owner)}{channel}" for channel in ("location", "rotation_euler", *ROTATIONS.values())]


def _was_changed(owner: Posable, stored: dict[str, Any]) -> bool:
    """Return whether the user has changed a pose that a session left."""
    if "kept" not in stored or _is_baked(owner):
        return False
    now = [*_channels(owner)["location"], *_channels(owner)["rotation"]]
    return len(now) != len(stored["kept"]) or any(abs(a - b) > _SAME for a, b in zip(now, stored["kept"], strict=True))

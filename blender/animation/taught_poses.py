"""Bones and other controls that a user has posed while a head shows a take by its skin or its shape keys."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.rigs.rig_map import PROPERTY, RigChannel
from ..controls.finding import channels_of, path_of
from ..controls.setting import ControlValues, holder_of, object_known_as
from ..controls.view import seen_vertices
from ..muting import varying_paths
from .targets import PoseTarget

_EDITED = 1e-4
"""Smallest change of a channel that counts, in eye distances, radians, or the unit of a property."""
_ALIKE = 0.02
"""Largest distance, in eye distances, between the mesh and its modifiers' result without the user's pose: if it is
larger, the modifiers would not show an offset of the mesh as the offset that was posed."""


class OwnPoses:
    """The channels of the rig of a head that nothing animates, with the values that they had at the start."""

    def __init__(self, head: bpy.types.Object, channels: Sequence[RigChannel]) -> None:
        self._head, self._uid = head.name, head.session_uid
        self._values = ControlValues(channels)
        self._before = self._values.read()
        self._least = _EDITED * np.array([channel.unit for channel in channels])

    @classmethod
    def of(cls, head: bpy.types.Object, targets: Iterable[PoseTarget]) -> OwnPoses:
        """Read the rig of a head, whose pose moves some targets; a linked one has no channels."""
        posed = {(target.obj.name, target.bone) for target in targets}
        try:
            found = [channel for channel in channels_of(head) if (channel.owner, channel.bone) not in posed]
        except HeadError:
            found = []
        varying = {name: varying_paths(bpy.data.objects[name]) for name in {channel.owner for channel in found}}
        return cls(head, [channel for channel in found if _path(channel) not in varying[channel.owner]])

    def changed(self, but: Iterable[RigChannel] = ()) -> list[str]:
        """Return the names of the controls that the user has posed since, except some channels."""
        left = {channel.place for channel in but}
        far = np.flatnonzero(np.abs(self._values.read() - self._before) > self._least).tolist()
        found = [self._values.channels[number] for number in far]
        return list(dict.fromkeys(one.control for one in found if one.place not in left))

    def added(self, shape: NDArray[np.float32], unit: float) -> NDArray[np.float32]:
        """Add to a shape (A, 3) what the user's pose moves of it, and take the pose back.

        Raises HeadError, and leaves the pose, if the shape itself could not show the same: `unit` is the outer-eye
        distance.
        """
        if not (names := self.changed()):
            return shape
        head = object_known_as(self._uid, self._head)
        assert head is not None, "a head that is taught exists"
        pose, posed = self._values.read(), seen_vertices(head)
        self._values.restore()
        without = seen_vertices(head)
        if posed is not None and without is not None:
            offsets = posed - without
            moved = np.abs(offsets).max(axis=1) > _EDITED * unit
            if np.linalg.norm(without - shape, axis=1)[moved].max(initial=0.0) <= _ALIKE * unit:
                return np.asarray(shape + np.where(moved[:, None], offsets, 0.0), dtype=np.float32)
        self._values.write(pose)
        bpy.context.view_layer.update()
        raise HeadError(
            "Modifiers of {name} change the shape that the take shows, so that the pose of {names} cannot be taught. "
            "Disable these modifiers in the viewport, or use Learn Controls and choose Controls as Driven By.",
            name=head.name,
            names=", ".join(names),
        )


def _path(channel: RigChannel) -> str:
    if channel.kind == PROPERTY:
        return path_of(channel)
    return path_of(channel, holder_of(channel.owner, channel.bone).rotation_mode)

"""Controls of a character's own rig during a session: their values, which are restored at its end.

The values before are kept in a custom property of the object that has the controls, and restored from there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Collection
from statistics import median
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadFrame
from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import LOCATION, PROPERTY, SCALE, RigMap
from ...core.rigs.solver import RigSolver
from ..controls.finding import path_of
from ..controls.setting import ControlValues, holder_in, object_known_as
from ..controls.view import look_at
from ..meshes import mesh_of, posed_bones, read_vertices
from ..names import CONTROLS_PROPERTY
from ..own_pose import rotation_channel

CONTROLS = "CONTROLS"


_PATIENCE = 0.01
"""Seconds that an evaluation of the rig may take for the correction of each frame."""
_EDITED = 1e-4
"""Smallest change of a channel that counts, in eye distances, radians, or the unit of a property."""
_MOVED = 0.05
"""Mean distance of the vertices of an evaluated mesh from those of the mesh at rest, in eye distances, above which
modifiers have changed their order. Subdivision of the built-in head moves them by 0.009."""
_FIRST = 5
"""Evaluations whose median decides."""


class LiveControls:
    """Controls of a head that display a performance, corrected once by evaluating the rig if that is fast.

    Raises HeadError if a control is missing.
    """

    def __init__(self, head: bpy.types.Object, found: RigMap) -> None:
        self.found = found
        self._head, self._uid = head.name, head.session_uid
        self._solver, self._correcting = RigSolver(found), RigSolver(found)
        self._corrects, self._seconds = True, list[float]()
        self._zero: FloatArray | None = None
        self._rest = read_vertices(mesh_of(head))[found.sample].astype(np.float64)
        self._values = ControlValues(found.channels)
        self._solved = self._shown = np.zeros(len(found.channels))
        self._low, self._high = (np.array([getattr(one, end) for one in found.channels]) for end in ("low", "high"))
        self._least = _EDITED * np.array([channel.unit for channel in found.channels])

    @property
    def owners(self) -> list[bpy.types.Object]:
        """The objects that have the controls, as far as they exist."""
        return list(self._values.owners.values())

    def paths(self, owner: bpy.types.ID) -> list[str]:
        """Return the data paths of the controls of an object."""
        paths, owners = [], self._values.owners
        for channel in self.found.channels:
            if (obj := owners.get(channel.owner)) == owner and obj is not None:
                mode = "" if channel.kind == PROPERTY else holder_in(obj, channel.bone).rotation_mode
                paths.append(path_of(channel, mode))
        return list(dict.fromkeys(paths))

    @property
    def sizes(self) -> list[int]:
        """Lengths of the arrays that `solve` returns."""
        return [len(self.found.channel), 3 * len(self.found.sample), len(self.found.channels)]

    def solve(self, frame: HeadFrame) -> list[NDArray[np.float64]]:
        """Return the variables of the map that show a frame, (K,), the wanted motion, (3 S,), and taught changes of the
        channels, (C,).

        May be called in a thread.
        """
        wanted = frame.vertices[self.found.sample] - self._rest
        taught = [frame.controls.get(channel.key, 0.0) for channel in self.found.channels]
        return [self._solver.variables(wanted), wanted.ravel(), np.array(taught)]

    def attach(self) -> None:
        """Remember the values of the controls."""
        self._values.remember()
        for owner in self.owners:
            if CONTROLS_PROPERTY not in owner:
                owner[CONTROLS_PROPERTY] = json.dumps(self._values.own_of(owner))

    def renew(self) -> None:
        """Set all controls in the next frame, as the user may have posed some."""
        self._values.forget()

    def write(self, variables: FloatArray, wanted: FloatArray, taught: FloatArray) -> None:
        """Set the controls to what `solve` has returned; raises HeadError if one was deleted."""
        if self._corrects and self._zero is None:
            self._zero = self._look(np.zeros(len(variables)))
            if self._zero is not None:
                off = np.linalg.norm(self._zero - self._rest, axis=1).mean()
                self._corrects &= bool(off < _MOVED * self.found.unit)
        moved = self._look(variables)
        if moved is not None and self._zero is not None:
            variables = self._correcting.again(wanted.reshape(-1, 3), variables, moved - self._zero)
        self._solved = self._shown = self.found.values(variables)
        if taught.any():
            self._shown = np.where(taught, np.clip(self._solved + taught, self._low, self._high), self._solved)
        self._values.write(self._shown)

    def taught(self) -> dict[str, float]:
        """Return the changes of channels, by `RigChannel.key`, with which a frame looks as the user posed it.

        Nothing if it looks as it is shown.
        """
        now = self._values.read()
        edited = np.abs(now - self._shown) > self._least
        if not edited.any():
            return {}
        changes = np.where(edited, now, self._shown) - self._solved
        far = np.flatnonzero(np.abs(changes) > self._least)
        return {self.found.channels[number].key: float(changes[number]) for number in far}

    def _look(self, variables: FloatArray) -> FloatArray | None:
        """Set the controls, and evaluate the rig: sampled vertices (S, 3), or None if there is to be no correction."""
        head = object_known_as(self._uid, self._head)
        if not self._corrects or head is None or bpy.app.is_job_running("RENDER"):
            return None
        self._values.write(self.found.values(variables))
        start = time.perf_counter()
        points = look_at(head, self.found.sample)
        if len(self._seconds) < _FIRST:
            self._seconds.append(time.perf_counter() - start)
            slow = len(self._seconds) == _FIRST and median(self._seconds) > _PATIENCE
            self._corrects = not slow and points is not None
        return points

    def detach(self, *, keep: bool) -> None:
        """Restore the values, or leave them as they are if `keep`."""
        for owner in self.owners:
            if keep:
                owner.pop(CONTROLS_PROPERTY, None)
            clear_controls(owner)


def clear_controls(owner: bpy.types.Object) -> None:
    """Restore the values that controls had before a session, even one that ended in a crash."""
    try:
        kept = json.loads(str(owner.get(CONTROLS_PROPERTY, "[]")))
    except ValueError:
        kept = []
    for item in kept if isinstance(kept, list) else []:
        _restore(owner, item)
    owner.pop(CONTROLS_PROPERTY, None)
    owner.update_tag()


def _restore(owner: bpy.types.Object, item: Any) -> None:
    """Restore a control from [bone, kind, name, value], which users and add-ons may have edited."""
    try:
        bone, kind, name, value = item
        if bone and (owner.pose is None or bone not in posed_bones(owner)):
            return
        holder = posed_bones(owner)[bone] if bone else owner
        if kind == PROPERTY:
            if name in holder:
                holder[name] = float(value)
        else:
            setattr(holder, kind if kind in (LOCATION, SCALE) else rotation_channel(holder), value)
    except (TypeError, ValueError):
        return


def clear_all_controls(but: Collection[bpy.types.ID] = ()) -> None:
    """Restore the controls of all objects, except some, that sessions have left as they set them."""
    for owner in bpy.data.objects:
        if CONTROLS_PROPERTY in owner and owner.library is None and owner not in but:
            clear_controls(owner)

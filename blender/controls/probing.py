"""Learning what the controls of a rig do to a face, by moving each a little and looking at the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.face.landmarks import CHIN
from ...core.heads.rig import HeadRig
from ...core.numeric.arrays import FloatArray, IntArray
from ...core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, Probe, RigChannel, RigMap, map_of
from ..characters import members_of
from ..frames import from_blender
from ..names import PART_PROPERTY
from ..rigs import read_rig
from .finding import channels_of
from .setting import ControlValues

_OTHERS = 300
"""Vertices of the face that are looked at beside the landmarks."""
_FIRST = {LOCATION: 0.05, ROTATION: np.radians(6.0)}
"""First step of a channel without limits, in eye distances and radians."""
_WANTED = (0.04, 0.16)
"""Largest motion of the face by which a channel is judged, in eye distances; steps are changed to reach it."""
_MIDDLE = 0.1
"""Motion that is aimed at."""
_TRIES = 3
"""Largest number of steps that are tried."""
_INSIDE = 0.5
"""Share of the range of a property to which it is moved: at its ends drivers may divide by zero."""
_STILL = 1e-4
"""Motion of the face below which a control does nothing, in eye distances."""
_HEAD = 0.01
"""Median motion of the skull above which a control moves the head, in eye distances."""
_EYES = 0.01
"""Motion of an eyeball above which a control moves the gaze, in eye distances."""
_JAW = 0.6
"""Motion of the chin, relative to the largest of the face, above which a rotation turns the jaw."""
_SHAPES = {"ARMATURE", "LATTICE", "MESH_DEFORM", "SURFACE_DEFORM", "HOOK", "SHRINKWRAP", "CORRECTIVE_SMOOTH", "SMOOTH"}
"""Modifiers that move vertices, which stay enabled; others may change their number."""


class FaceView:
    """A face as its rig shows it: positions of sampled vertices, of the skull, and of the eyeballs.

    Other modifiers and objects are disabled until `close`. Raises HeadError if the mesh has another number of vertices
    even so.
    """

    def __init__(self, head: bpy.types.Object, rig: HeadRig) -> None:
        self._head, self.unit = head.name, rig.eye_distance
        self.sample = sampled_vertices(rig)
        self._skull = _skull(rig)
        self._count = len(rig.vertices)
        self._disabled = [
            (obj.name, modifier.name)
            for obj in [member.obj for member in members_of(head)]
            for modifier in obj.modifiers
            if modifier.show_viewport and modifier.type not in _SHAPES
        ]
        self._show(False)

    def close(self) -> None:
        """Enable what was disabled."""
        self._show(True)
        bpy.context.view_layer.update()

    def _show(self, shown: bool) -> None:
        for name, modifier in self._disabled:
            if (obj := bpy.data.objects.get(name)) is not None and modifier in obj.modifiers:
                obj.modifiers[modifier].show_viewport = shown

    @property
    def head(self) -> bpy.types.Object:
        """The head."""
        return bpy.data.objects[self._head]

    def look(self) -> Seen:
        """Evaluate the rig, and return what is seen."""
        bpy.context.view_layer.update()
        graph = bpy.context.evaluated_depsgraph_get()
        mesh = self.head.evaluated_get(graph).data
        assert isinstance(mesh, bpy.types.Mesh)
        if len(mesh.vertices) != self._count:
            raise HeadError(
                "The modifiers of {name} change its number of vertices. Disable them in the viewport, and try again.",
                name=self._head,
            )
        flat = np.empty(3 * self._count, dtype=np.float32)
        mesh.attributes["position"].data.foreach_get("vector", flat)
        points = from_blender(flat.reshape(-1, 3)).astype(np.float64)
        eyes = [
            np.array(child.evaluated_get(graph).matrix_world)[:3].ravel()
            for child in self.head.children_recursive + _eye_objects(self.head)
            if str(child.get(PART_PROPERTY, "")).startswith("eye")
        ]
        return Seen(points[self.sample], points[self._skull], np.array(eyes).reshape(-1, 12))


@dataclass(frozen=True)
class Seen:
    """Positions in the head frame and the unit of the mesh: sampled vertices (S, 3), skull (N, 3); the matrices of
    eyeballs in the world, (E, 12).
    """

    face: FloatArray
    skull: FloatArray
    eyes: FloatArray


def _eye_objects(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the eyeballs of a head that are not its children."""
    inside = set(head.children_recursive)
    return [obj for obj in bpy.data.objects if obj not in inside and str(obj.get(PART_PROPERTY, "")).startswith("eye")]


def sampled_vertices(rig: HeadRig) -> IntArray:
    """Return the landmarks and other vertices of the face, spread evenly over its indices, (S,)."""
    face = np.setdiff1d(np.flatnonzero(rig.region_weights.sum(axis=0) > 0.0), rig.landmarks)
    chosen = face[np.unique(np.linspace(0, len(face) - 1, min(_OTHERS, len(face))).astype(np.intp))]
    return np.concatenate([rig.landmarks, chosen]).astype(np.intp)


def _skull(rig: HeadRig) -> IntArray:
    """Return vertices of the upper back of the head, (N,), which no expression moves."""
    eyes = rig.vertices[rig.landmarks[36:48]].mean(axis=0)
    away = (rig.vertices - eyes) / rig.eye_distance
    still = rig.region_weights.sum(axis=0) <= 0.02
    return np.flatnonzero(still & (away[:, 1] < 0.0))


@dataclass
class Learning:
    """Learning the controls of a head, step by step; `close` in any case, which restores every channel.

    Attributes
    ----------
    done, total : int
        Channels that were moved, and that there are.
    """

    head: bpy.types.Object
    done: int = 0
    total: int = 0
    _probes: list[list[Probe]] = field(default_factory=list)

    def __post_init__(self) -> None:
        rig = read_rig(self.head)
        self._view = FaceView(self.head, rig)
        self._channels = channels_of(self.head)
        self._values = ControlValues(self._channels)
        self.total = len(self._channels)

    def close(self) -> None:
        """Restore the rig."""
        self._values.restore()
        self._view.close()

    def steps(self) -> Iterator[None]:
        """Move one channel after the other."""
        self._values.write(np.zeros(self.total))
        self._rest = self._view.look()
        for number, channel in enumerate(self._channels):
            self._probes.append(self._probe(number, channel))
            self.done += 1
            yield

    def result(self) -> RigMap:
        """Return what was learnt; HeadError if no control moves the face."""
        found = map_of(self._channels[: self.done], self._probes, self._view.sample, self._view.unit)
        if not found.channels:
            raise HeadError(
                "No control of {name} moves its face. Unhide the face's controls, and try again.", name=self.head.name
            )
        return found

    def _probe(self, number: int, channel: RigChannel) -> list[Probe]:
        found = []
        for sign, limit in ((1.0, channel.high), (-1.0, -channel.low)):
            if limit <= 0.0:
                continue
            probe = self._moved(number, channel, sign, limit)
            if probe is None:
                return []
            found.append(probe)
        return found

    def _moved(self, number: int, channel: RigChannel, sign: float, limit: float) -> Probe | None:
        """Move a channel in one direction; None if it moves nothing here, or head or eyes as well."""
        unit, values = self._view.unit, np.zeros(self.total)
        bounded = np.isfinite(limit)
        step = _FIRST.get(channel.kind, 0.1) * (unit if channel.kind == LOCATION else 1.0)
        step = limit * (_INSIDE if channel.kind == PROPERTY else 1.0) if bounded else step
        size = _MIDDLE
        for _ in range(1 if bounded else _TRIES):
            step *= float(np.clip(_MIDDLE / size, 0.1, 10.0))
            values[number] = sign * step
            self._values.write(values)
            seen = self._view.look()
            moved = seen.face - self._rest.face
            size = float(np.linalg.norm(moved, axis=1).max()) / unit
            if size < _STILL or self._is_elsewhere(seen) or _WANTED[0] <= size <= _WANTED[1]:
                break
        values[number] = 0.0
        self._values.write(values)
        if size < _STILL or self._is_elsewhere(seen) or not np.isfinite(moved).all():
            return None
        if channel.kind == ROTATION and not _turns_jaw(moved):
            return None
        return Probe(float(sign * step), moved)

    def _is_elsewhere(self, seen: Seen) -> bool:
        """Return whether the head or an eye has moved, rather than the face alone."""
        skull = np.linalg.norm(seen.skull - self._rest.skull, axis=1)
        eyes = np.abs(seen.eyes - self._rest.eyes)
        return bool((len(skull) and np.median(skull) > _HEAD * self._view.unit) or eyes.max(initial=0.0) > _EYES)


def _turns_jaw(moved: NDArray[np.float64]) -> bool:
    """Return whether the chin moves nearly as much as anything else."""
    size = np.linalg.norm(moved, axis=1)
    return bool(size[CHIN].mean() > _JAW * size.max())


def learn_controls(head: bpy.types.Object) -> RigMap:
    """Learn the controls of a head at once; raises HeadError as `Learning`."""
    learning = Learning(head)
    try:
        for _ in learning.steps():
            pass
        return learning.result()
    finally:
        learning.close()

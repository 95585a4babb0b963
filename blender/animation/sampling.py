"""Takes from animation: a head is sampled frame by frame, whatever moves its vertices, or read from a known set of
shape keys.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.arkit import arkit_coefficients
from ...core.errors import HeadError, Message
from ...core.face.landmarks import EYE_CORNERS, N_LANDMARKS
from ...core.face.names import COEFFICIENTS
from ...core.heads.built_in import LOOKS
from ...core.heads.key_map import KeyMap
from ...core.heads.key_presets import best_preset, known_expressions, with_others
from ...core.heads.regions import LOWER
from ...core.heads.rig import Part, neck_of
from ...core.numeric.arrays import FloatArray
from ...core.takes.measured import FacePoints, PointTracker, describe_animation
from ...core.takes.moving_mesh import anchors_of
from ...core.takes.neutral import calibrate
from ...core.takes.take import Take, TakeRecorder
from ..characters import objects_of, read_kinds, rest_matrix
from ..contexts import evaluated_depsgraph
from ..frames import HEAD_TO_BLENDER, from_blender, to_blender
from ..meshes import exists, eye_vertices, key_names, keys_of, mesh_of, read_landmarks, read_regions, read_vertices
from ..names import PART_PROPERTY
from ..timeline import frame_range, rate_of
from ..view_layers import revealed
from .bake_keys import standing_vertices

_STILL = 1e-4
"""Largest value of keys that count as not animated: less than a step of a take's coefficients matters."""
_MOST = 1.001
"""Value above which a key is exaggerated: single precision exceeds 1 by less."""


_LOOKS = {COEFFICIENTS[column] for column in LOOKS}


class _AnimatedKeys:
    """Reads the values of the keys of a head, and of the other meshes of its face, while its animation is sampled."""

    def __init__(self, head: bpy.types.Object) -> None:
        self._objects = [obj for obj in (head, *objects_of(head)) if key_names(obj)]
        self._table = _table([key_names(obj) for obj in self._objects])
        self._names = () if self._table is None else self._table.keys
        self._rows: list[list[float]] = []

    @property
    def moved(self) -> bool:
        """Whether a key has had a value other than 0."""
        return bool(self._rows) and bool(np.abs(self._rows).max(initial=0.0) > _STILL)

    def read(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Read the values in the current frame; of a key on several meshes, the one furthest from 0."""
        if self._names:
            values = [_values(obj.evaluated_get(depsgraph)) for obj in self._objects]
            self._rows.append([max((of.get(name, 0.0) for of in values), key=abs) for name in self._names])

    def state(self, take: Take) -> None:
        """Let a take of the frames that were read state their coefficients, unless no key moved.

        Directions of the eyes that no key determines are those of the gaze.
        """
        seen = take.found
        if self._table is None or not self.moved or not seen.any():
            return
        values = np.array(self._rows)[seen]
        if limited := [name for name, column in zip(self._names, values.T, strict=True) if column.max() > _MOST]:
            names = ", ".join(limited)
            note = Message("Coefficients are at most 1, to which these keys were limited: {names}.", names=names)
            take.info["notes"] = [*take.info.get("notes", []), note]
        solved = arkit_coefficients(take, calibrate(take))
        if not np.isfinite(take.gaze[seen]).all():
            solved[:, LOOKS] = 0.0
        stated = self._table.invert(dict(zip(self._names, values.T, strict=True)), solved)
        if not self._looks(values):
            stated[:, LOOKS] = solved[:, LOOKS]
        take.coefficients[seen] = stated

    def _looks(self, values: FloatArray) -> bool:
        """Whether keys move the eyes."""
        rows = () if self._table is None else self._table.rows
        moved = [name for name, column in zip(self._names, values.T, strict=True) if np.abs(column).max() > _STILL]
        return any(row.source in _LOOKS and row.key in moved for row in rows)


def _table(names: list[list[str]]) -> KeyMap | None:
    """Mapping of the known set of the first mesh that has one, for the keys of all meshes."""
    for own in names:
        if (preset := best_preset(own)) is not None:
            return with_others(preset, own, dict.fromkeys(name for of in names for name in of))
    return None


def _values(final: bpy.types.Object) -> dict[str, float]:
    """Values of the keys of an evaluated mesh; those of muted ones are 0."""
    return {key.name: 0.0 if key.mute else float(key.value) for key in keys_of(final).key_blocks}


_CONSTRUCTIVE = {
    *("ARRAY", "BEVEL", "BOOLEAN", "BUILD", "DECIMATE", "EDGE_SPLIT", "MASK", "MIRROR", "MULTIRES", "REMESH"),
    *("SCREW", "SKIN", "SOLIDIFY", "SUBSURF", "TRIANGULATE", "WELD", "WIREFRAME"),
}
"""Types of modifiers that change the number of vertices but move no landmark."""
_LEAST_MOTION = 1e-4
"""Minimum motion of a landmark in some frame, in eye distances."""
_EYES = {Part.EYE_RIGHT: "eye_right", Part.EYE_LEFT: "eye_left"}


class Sampling:
    """Samples the motion of a head as a take; each step of iterating over it samples a frame.

    The current frame of the scene is restored when the iteration ends or its iterator is closed. The face is at rest in
    the mesh of the head, whose object is in its place in the first frame. `source` says where the animation comes from,
    for the description of the take. Raises HeadError if the head has no landmarks or regions.
    """

    def __init__(self, scene: bpy.types.Scene, head: bpy.types.Object, source: str) -> None:
        self._scene, self._head, self.frames = scene, head, frame_range(scene)
        self._rate = rate_of(scene)
        self._recorder = TakeRecorder(describe_animation(source, self._rate))
        self._face, self._keys = _Face(head), _AnimatedKeys(head)
        self._tracker: PointTracker | None = None
        self._moves = False

    def __iter__(self) -> Generator[int, None, None]:
        """Sample a frame at each step, and yield how many are done.

        Raises HeadError if the head was removed, or its modifiers change the number of vertices.
        """
        scene = self._scene
        current = scene.frame_current, scene.frame_subframe
        try:
            hidden = [obj for obj in self._face.objects if not obj.visible_get()]
            with revealed(hidden), _only_deformed(self._face.objects):
                for frame in self.frames:
                    scene.frame_set(frame)
                    self._sample((frame - self.frames[0]) / self._rate)
                    yield len(self._recorder)
        finally:
            scene.frame_set(current[0], subframe=current[1])

    def take(self) -> Take:
        """Return the take of the frames so far, which starts at 0 s; raises HeadError if the head does not move."""
        if self._tracker is None or not (self._moves or self._keys.moved):
            first, last = self.frames[0], self.frames[-1]
            raise HeadError(
                "{name} does not move from frame {first} to {last}. Animate it, or change the frame range.",
                name=self._head.name,
                first=first,
                last=last,
            )
        take = self._tracker.finish(self._recorder)
        self._keys.state(take)
        return take

    def _sample(self, time: float) -> None:
        if not exists(self._head):
            raise HeadError("The head was removed while it was sampled. Undo that, and sample it again.")
        tracker = self._tracker
        if tracker is None:
            tracker = self._tracker = PointTracker(self._face.rest(), self._face.pivot, self._face.trust)
        points = self._face.current()
        self._keys.read(evaluated_depsgraph(bpy.context))
        self._moves |= bool(np.abs(points.landmarks - tracker.rest.landmarks).max() > _LEAST_MOTION * tracker.unit)
        self._recorder.append(time, tracker.track(points))


class _Face:
    """The vertices of a face that determine its expression, pose and gaze."""

    def __init__(self, head: bpy.types.Object) -> None:
        vertices, landmarks = read_vertices(mesh_of(head)).astype(np.float64), read_landmarks(head)
        points = vertices[landmarks]
        self.pivot = neck_of(points)
        anchors = anchors_of(vertices, landmarks, read_kinds(mesh_of(head)) == Part.SKIN)
        self._skin = np.concatenate([landmarks, anchors])
        self.trust = 1.0 - read_regions(head)[LOWER, self._skin[N_LANDMARKS:]].astype(np.float64)
        self._head = head
        self._eyes = [_eye(head, part, points) for part in _EYES]
        self._from_scene = np.eye(3, 4)

    @property
    def objects(self) -> list[bpy.types.Object]:
        """The objects whose vertices are read."""
        return [self._head, *(obj for eye in self._eyes for obj, _ in eye if obj != self._head)]

    def rest(self) -> FacePoints:
        """Return the positions at rest: those of the objects now, without poses."""
        self._from_scene = HEAD_TO_BLENDER.T @ np.array(rest_matrix(self._head).inverted_safe())[:3]
        # With the keys of the identity; those of an expression are motion.
        keys = known_expressions
        return self._points(lambda o: (standing_vertices(o, keys(key_names(o))), np.array(rest_matrix(o))))

    def current(self) -> FacePoints:
        """Return the positions in the current frame; raises HeadError if a mesh then has another number of vertices."""
        depsgraph = evaluated_depsgraph(bpy.context)
        return self._points(lambda obj: _evaluated(obj, depsgraph))

    def _points(self, read: Callable[[bpy.types.Object], tuple[FloatArray, FloatArray]]) -> FacePoints:
        known = {obj: read(obj) for obj in self.objects}

        def places(obj: bpy.types.Object, chosen: NDArray[np.integer[Any]]) -> FloatArray:
            vertices, matrix = known[obj]
            world = to_blender(vertices[chosen]) @ matrix[:3, :3].T + matrix[:3, 3]
            return np.asarray(world @ self._from_scene[:, :3].T + self._from_scene[:, 3])

        skin = places(self._head, self._skin)
        right, left = (
            np.concatenate([np.empty((0, 3)), *(places(obj, chosen) for obj, chosen in eye)]) for eye in self._eyes
        )
        return FacePoints(skin[:N_LANDMARKS], skin[N_LANDMARKS:], (right, left))


def _eye(head: bpy.types.Object, part: Part, points: FloatArray) -> list[tuple[bpy.types.Object, NDArray[np.intp]]]:
    """Return the meshes that contain an eye of a head, and its vertices in them."""
    children = [child for child in head.children if child.get(PART_PROPERTY) == _EYES[part] and child.type == "MESH"]
    found = [(child, np.arange(len(mesh_of(child).vertices))) for child in children]
    for obj in (head, *objects_of(head)):
        if len(own := np.flatnonzero(read_kinds(mesh_of(obj)) == part)):
            found.append((obj, own))
    cut = eye_vertices(head)
    across = points[EYE_CORNERS[3]] - points[EYE_CORNERS[0]]
    side = (read_vertices(mesh_of(head))[cut] - points[EYE_CORNERS].mean(axis=0)) @ across
    own = cut[side > 0.0 if part == Part.EYE_LEFT else side <= 0.0]
    return [*found, (head, own)] if len(own) else found


def _evaluated(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[FloatArray, FloatArray]:
    """Return the vertices of an object after its modifiers, head frame, and its (4, 4) transform."""
    final = obj.evaluated_get(depsgraph)
    if len(mesh_of(final).vertices) != len(mesh_of(obj).vertices):
        raise HeadError("Modifiers of {name} change the number of its vertices. Hide or apply them.", name=obj.name)
    flat = np.empty(3 * len(mesh_of(final).vertices), dtype=np.float32)
    mesh_of(final).vertices.foreach_get("co", flat)
    return from_blender(flat.reshape(-1, 3)).astype(np.float64), np.array(final.matrix_world)


@contextmanager
def _only_deformed(objects: list[bpy.types.Object]) -> Iterator[None]:
    """Hide the modifiers of some objects that change the number of vertices."""
    shown = [
        (obj, modifier.name)
        for obj in objects
        for modifier in obj.modifiers
        if modifier.type in _CONSTRUCTIVE and modifier.show_viewport
    ]
    _show(shown, False)
    try:
        yield
    finally:
        _show(shown, True)


def _show(modifiers: list[tuple[bpy.types.Object, str]], shown: bool) -> None:
    for obj, name in modifiers:
        if exists(obj) and (modifier := obj.modifiers.get(name)) is not None:
            modifier.show_viewport = shown

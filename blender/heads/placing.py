"""Places of landmarks in a viewport, where landmarks and marked points are placed by hand; the binding of a character
as it was, so that one that was just found can be taken back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import bpy
import numpy as np
from bpy_extras import view3d_utils
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.face.landmarks import from_ibug
from ...core.heads.bind import MARKS, MIN_MARKS
from ...core.heads.rig import Part
from ...core.numeric import linalg
from ..characters import read_kinds, write_kinds
from ..meshes import (
    driven_by_keys,
    is_head,
    mesh_of,
    object_of,
    read_landmarks,
    read_regions,
    read_weights,
    write_landmarks,
    write_regions,
)
from ..names import MARKS_PROPERTY, NECK_PROPERTY, REGION_GROUPS
from ..viewports import Viewport
from .binding import (
    VertexTakenError,
    move_landmark,
    propose_head_regions,
    proposed_weights,
    read_marks,
    turn_mesh,
    write_marks,
)
from .family import known_keys
from .look_keys import eyes_with_look_keys, give_eyes_keys
from .neck import remove_neck

NEAR = 24.0
"""Maximum distance of a click from a landmark, pixels at a resolution scale of 1."""
_EASY_FIRST = (36, 45, 48, 54, 30, 8, 39, 42)
"""iBUG numbers of `MARKS`, in the order in which users are asked for them: four that lie far apart come first."""
_BEFORE = 10.0
"""Distance before the middle of an orthographic view at which a ray starts, relative to that of the view."""
_OURS = "facemime_"


class Places(NamedTuple):
    """Positions of points in a viewport.

    Attributes
    ----------
    pixels : (N, 2) float
        Pixels from the lower left corner of the region.
    facing : (N,) bool
        Whether the skin there is in front of the viewer and faces it.
    """

    pixels: NDArray[np.float64]
    facing: NDArray[np.bool_]


def landmark_places(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, view: NDArray[np.float64], size: tuple[int, int]
) -> Places:
    """Project the landmarks of a head, as it is displayed with its modifiers and transform.

    `view` (4, 4) is from world to clip space, the `perspective_matrix` of the region, whose width and height are in
    pixels. Raises HeadError if the head has no landmarks, or a modifier removes vertices.
    """
    landmarks = read_landmarks(obj)
    evaluated = obj.evaluated_get(depsgraph)
    vertices = mesh_of(evaluated).vertices
    if len(vertices) < len(mesh_of(obj).vertices):
        raise HeadError("A modifier of {name} removes vertices. Disable it to show the landmarks.", name=obj.name)
    seen = [vertices[i] for i in landmarks.tolist()]
    world = np.array(evaluated.matrix_world)
    places = np.array([vertex.co for vertex in seen]) @ world[:3, :3].T + world[:3, 3]
    normals = np.array([vertex.normal for vertex in seen]) @ np.asarray(linalg.inv(world[:3, :3]))
    return project(places, normals, view, size)


def project(
    places: NDArray[np.float64], normals: NDArray[np.float64], view: NDArray[np.float64], size: tuple[int, int]
) -> Places:
    """Project points and normals (N, 3) in world space into a viewport, as `landmark_places` does."""
    clip = np.hstack([places, np.ones((len(places), 1))]) @ view.T
    before = clip[:, 3] > 1e-9
    flat = clip[:, :2] / np.where(before, clip[:, 3], 1.0)[:, None]
    ahead = np.hstack([places + 1e-3 * normals, np.ones((len(places), 1))]) @ view.T
    nearer = ahead[:, 2] * clip[:, 3] < clip[:, 2] * ahead[:, 3]
    return Places((flat + 1.0) / 2.0 * np.array(size), before & nearer)


def nearest_landmark(places: Places, pixel: tuple[float, float], reach: float = NEAR) -> int:
    """Return the landmark nearest to a pixel among those that face the viewer; -1 if none is within `reach` pixels.

    The pixel is from the lower left corner of the region.
    """
    away = np.linalg.norm(places.pixels - np.array(pixel), axis=1)
    away[~places.facing] = np.inf
    nearest = int(away.argmin())
    return nearest if away[nearest] <= reach else -1


class Placing:
    """The landmarks of a head while they are moved, or points of a face while they are marked.

    Parameters
    ----------
    asked : sequence of int
        iBUG numbers of the points to mark, in order; none if landmarks are to be moved.
    take_back : callable, optional
        Takes back the binding that the placing checks, if it is discarded.

    Attributes
    ----------
    current : Placing or None
        The one in progress.
    held : int
        Landmark that follows the mouse; -1 if none does.
    """

    current: Placing | None = None

    def __init__(
        self, obj: bpy.types.Object, asked: Sequence[int] = (), take_back: Callable[[], None] | None = None
    ) -> None:
        self.name, self.asked, self.held = obj.name, tuple(asked), -1
        self._take_back = take_back
        self.discarded = False
        self.step = 0
        self._marks = read_marks(mesh_of(obj))
        self._landmarks = read_landmarks(obj) if is_head(obj) else None
        self._count = len(mesh_of(obj).vertices)

    @property
    def obj(self) -> bpy.types.Object | None:
        """The object, or None if it has been deleted or changed in the meantime."""
        obj = bpy.data.objects.get(self.name)
        return obj if obj is not None and obj.type == "MESH" and len(mesh_of(obj).vertices) == self._count else None

    @property
    def next_mark(self) -> int | None:
        """The point to mark next, by iBUG number; None if all are marked."""
        return self.asked[self.step] if self.step < len(self.asked) else None

    @property
    def enough(self) -> bool:
        """Whether there are as many marks as the search needs."""
        return len(read_marks(mesh_of(self.obj))) >= MIN_MARKS

    def mark(self, vertex: int) -> None:
        """Mark the next point."""
        write_marks(mesh_of(self.obj), read_marks(mesh_of(self.obj)) | {self.asked[self.step]: vertex})
        self.step += 1

    def unmark(self) -> None:
        """Clear the last mark."""
        if self.step:
            self.step -= 1
            marks = read_marks(mesh_of(self.obj))
            marks.pop(self.asked[self.step], None)
            write_marks(mesh_of(self.obj), marks)

    def drag(self, vertex: int) -> None:
        """Bind the held landmark to a vertex, unless another landmark is there."""
        try:
            move_landmark(object_of(self.obj), self.held, vertex)
        except VertexTakenError:
            return

    @property
    def changed(self) -> bool:
        """Whether the end of the placing is an undo step of its own."""
        return not self.discarded or self._take_back is not None

    def accept(self) -> None:
        """Keep the landmarks. Regions derived from the former ones are updated; painted regions are kept."""
        obj = self.obj
        if obj is None or self._landmarks is None or not is_head(obj):
            return
        if not np.array_equal(read_landmarks(obj), self._landmarks) and np.allclose(
            read_regions(obj), proposed_weights(obj, self._landmarks), atol=1e-4
        ):
            propose_head_regions(obj)

    def discard(self) -> None:
        """Restore landmarks and marks, or take the whole binding back."""
        self.discarded = True
        if self._take_back is not None:
            self._take_back()
            return
        if (obj := self.obj) is None:
            return
        write_marks(mesh_of(obj), self._marks)
        if self._landmarks is not None:
            write_landmarks(mesh_of(obj), self._landmarks)


def marks_to_ask(wanted: Sequence[int] = ()) -> tuple[int, ...]:
    """Return the iBUG numbers of points to ask for: those `wanted` if there are any, and otherwise all `MARKS`."""
    return tuple(number for number in _EASY_FIRST if number in (wanted or MARKS))


def place_of_mark(obj: bpy.types.Object, number: int) -> int | None:
    """Return the vertex at which a point is expected: where the search has put it; None if there was no search."""
    return int(read_landmarks(obj)[from_ibug([number])[0]]) if is_head(obj) else None


def skin_under(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, seen: Viewport, pixel: tuple[float, float]
) -> int | None:
    """Find the vertex of a head's skin at a pixel, through whatever other object is in front; None beside the head.

    The pixel is from the lower left corner of the region. Takes about 1 ms for 100,000 vertices.
    """
    evaluated = obj.evaluated_get(depsgraph)
    to_object = evaluated.matrix_world.inverted_safe()
    begin = view3d_utils.region_2d_to_origin_3d(seen.region, seen.view, pixel)
    ahead = view3d_utils.region_2d_to_vector_3d(seen.region, seen.view, pixel)
    if not seen.view.is_perspective:  # Blender starts such a ray in the middle of the view
        begin -= _BEFORE * seen.view.view_distance * ahead
    hit, place, *_ = evaluated.ray_cast(to_object @ begin, to_object.to_3x3() @ ahead)
    if not hit or len(mesh_of(evaluated).vertices) < len(mesh_of(obj).vertices):
        return None
    return _nearest(obj, evaluated, place)


def _nearest(obj: bpy.types.Object, evaluated: bpy.types.Object, place: Vector) -> int:
    flat = np.empty(3 * len(mesh_of(evaluated).vertices), np.float32)
    mesh_of(evaluated).vertices.foreach_get("co", flat)
    squared = ((flat.reshape(-1, 3)[: len(mesh_of(obj).vertices)] - np.array(place, dtype=np.float32)) ** 2).sum(axis=1)
    kinds = read_kinds(mesh_of(obj))
    if (kinds == Part.SKIN).any():
        squared[kinds != Part.SKIN] = np.inf
    return int(squared.argmin())


@dataclass(frozen=True, eq=False)
class _Bound:
    """What was stored with an object, and where it was."""

    name: str
    matrix: Matrix
    own: dict[str, Any]
    of_mesh: dict[str, Any]
    kinds: NDArray[np.int8]
    weights: NDArray[np.float32] | None
    hidden: tuple[bool, bool]
    """In the viewport, and in renders."""


class FormerBinding:
    """The landmarks, regions and parts of all meshes of a scene, and what was hidden and selected."""

    def __init__(self, context: bpy.types.Context) -> None:
        context.view_layer.update()
        self._meshes = [
            _bound(obj) for obj in context.scene.objects if obj.type == "MESH" and mesh_of(obj).library is None
        ]
        self._necks = {obj.name for obj in context.scene.objects if NECK_PROPERTY in obj}
        self._selected = [obj.name for obj in context.selected_objects]
        self._active = "" if context.active_object is None else context.active_object.name

    def restore(self, context: bpy.types.Context) -> None:
        """Restore the binding and the selection; marks that the user made since are kept."""
        for neck in [obj for obj in context.scene.objects if NECK_PROPERTY in obj and obj.name not in self._necks]:
            remove_neck(neck)
        for former in self._meshes:
            obj = context.scene.objects.get(former.name)
            if obj is not None and obj.type == "MESH" and len(mesh_of(obj).vertices) == len(former.kinds):
                _restore(obj, former)
        for obj in [obj for obj in context.scene.objects if driven_by_keys(obj) and eyes_with_look_keys(obj)]:
            give_eyes_keys(obj, known_keys(obj))
        for obj in context.view_layer.objects:
            obj.select_set(obj.name in self._selected)
        context.view_layer.objects.active = context.view_layer.objects.get(self._active)


def _bound(obj: bpy.types.Object) -> _Bound:
    regions = all(name in obj.vertex_groups for name in REGION_GROUPS)
    weights = read_weights(obj, slice(None)) if regions else None
    kinds, hidden = read_kinds(mesh_of(obj)), (obj.hide_get(), obj.hide_render)
    return _Bound(obj.name, obj.matrix_world.copy(), _ours(obj), _ours(mesh_of(obj)), kinds, weights, hidden)


def _ours(owner: bpy.types.ID) -> dict[str, Any]:
    found = {}
    for key, value in owner.items():
        if key.startswith(_OURS) and key != MARKS_PROPERTY:
            plain = value.to_dict() if hasattr(value, "to_dict") else value
            found[key] = plain.to_list() if hasattr(plain, "to_list") else plain
    return found


def _restore(obj: bpy.types.Object, former: _Bound) -> None:
    for owner, stored in ((obj, former.own), (mesh_of(obj), former.of_mesh)):
        for key in _ours(owner):
            del owner[key]
        for key, value in stored.items():
            owner[key] = value
    write_kinds(mesh_of(obj), former.kinds)
    in_viewport, obj.hide_render = former.hidden
    if obj.name in bpy.context.view_layer.objects:
        obj.hide_set(in_viewport)
    turn = np.array((former.matrix.inverted_safe() @ obj.matrix_world).to_quaternion().to_matrix())
    if not np.allclose(turn, np.eye(3), atol=1e-5):
        turn_mesh(obj, turn)
    if former.weights is not None:
        write_regions(obj, former.weights)
        return
    for name in REGION_GROUPS:
        if (group := obj.vertex_groups.get(name)) is not None:
            obj.vertex_groups.remove(group)

"""A mesh of the user's own becomes a head: landmarks bound, regions proposed, both kept with the mesh."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.heads.binding import Binding, bind_landmarks
from ...core.heads.checks import Finding, check_head
from ...core.heads.proposal import propose_regions
from ..frames import HEAD_TO_BLENDER
from ..meshes import (
    eye_vertices,
    mesh_of,
    read_faces,
    read_landmarks,
    read_regions,
    read_vertices,
    stored_integers,
    write_landmarks,
    write_regions,
)
from ..names import COUNT_PROPERTY, LANDMARKS_PROPERTY, MARKS_PROPERTY, REGION_GROUPS, SELECTION_PROPERTY

_STRAIN = 0.04
"""Eye distances by which a template is bent at most to fit a human head."""
_UPRIGHT = np.cos(np.radians(20.0))
"""A mesh that looks away from -Y by more than that is turned; less is how the head is held."""


def bind_head(obj: bpy.types.Object | None) -> Binding:
    """Find the landmarks of `obj` from the user's marks, or from none, and propose its regions.

    Without marks the face is looked for along the axes of the scene, first towards -Y and upright: importers turn the
    object and leave the vertices lying. Then it is looked for along the object's own axes: it may stand turned by any
    angle. Where the vertices are not upright, they are turned, and the object's transform back, so that nothing moves
    in the scene.

    Raises
    ------
    HeadError
        Where no face is found, or a mesh that several objects share would have to be turned.
    """
    mesh = mesh_of(obj)
    marks = read_marks(mesh)
    seen = HEAD_TO_BLENDER.T @ np.array(obj.matrix_world.to_quaternion().to_matrix()) @ HEAD_TO_BLENDER
    skin, faces = _skin(obj)
    number = {vertex: place for place, vertex in enumerate(skin.tolist())}
    marks = {landmark: number[vertex] for landmark, vertex in marks.items() if vertex in number}
    axes = [seen] if marks or np.allclose(seen, np.eye(3), atol=1e-3) else [seen, np.eye(3)]
    binding, along = _bound(read_vertices(mesh)[skin], faces, marks, axes)
    upright = along if _is_small(binding.rotation) else binding.rotation @ along
    if not _is_small(upright):
        _turn(obj, HEAD_TO_BLENDER @ upright @ HEAD_TO_BLENDER.T)
    write_landmarks(mesh, skin[binding.landmarks])
    if SELECTION_PROPERTY in mesh:
        del mesh[SELECTION_PROPERTY]
    propose_head_regions(obj)
    return binding


def propose_head_regions(obj: bpy.types.Object) -> None:
    """Fill the region groups of `obj`, whose landmarks are bound, with the proposed weights."""
    landmarks = read_landmarks(obj)
    write_regions(obj, propose_regions(read_vertices(obj.data), read_faces(obj.data), landmarks))


def check_object(obj: bpy.types.Object | None) -> list[Finding]:
    """What would keep `obj` from being driven well; HeadError where landmarks or regions are not there at all."""
    mesh = mesh_of(obj)
    return check_head(read_vertices(mesh), read_faces(mesh), read_landmarks(obj), read_regions(obj))


def what_is_missing(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """What the mesh `obj` lacks to be driven, in the order of mending: a sentence and the operator that mends it.

    A look at names alone, cheap enough for a panel's every drawing; `check_object` looks at the mesh itself.
    """
    mesh = obj.data
    if LANDMARKS_PROPERTY not in mesh:
        return [("This mesh has no landmarks yet", "facemime.bind_landmarks")]
    if (bound_at := stored_integers(mesh, COUNT_PROPERTY)) is not None and not np.array_equal(
        bound_at, len(mesh.vertices)
    ):
        return [("The mesh was edited since its landmarks were bound", "facemime.bind_landmarks")]
    if any(name not in obj.vertex_groups for name in REGION_GROUPS):
        return [("The face's regions are missing", "facemime.propose_regions")]
    return []


def read_marks(mesh: bpy.types.Mesh) -> dict[int, int]:
    """The user's marks: iBUG number to vertex."""
    flat = stored_integers(mesh, MARKS_PROPERTY)
    if flat is None or flat.ndim != 1 or len(flat) % 2:
        return {}
    return dict(flat.reshape(-1, 2).tolist())


def write_mark(mesh: bpy.types.Mesh, number: int, vertex: int) -> None:
    """Keep that landmark `number` (iBUG) lies at `vertex`."""
    marks = read_marks(mesh) | {number: vertex}
    mesh[MARKS_PROPERTY] = [value for pair in marks.items() for value in pair]


def clear_marks(mesh: bpy.types.Mesh) -> None:
    """Forget all marks."""
    if MARKS_PROPERTY in mesh:
        del mesh[MARKS_PROPERTY]


def picked_vertex(obj: bpy.types.Object) -> int:
    """The one vertex that is selected in Edit mode; HeadError where it is not one."""
    obj.update_from_editmode()
    selected = np.empty(len(obj.data.vertices), dtype=bool)
    obj.data.vertices.foreach_get("select", selected)
    if selected.sum() != 1:
        raise HeadError(f"Select one vertex in Edit mode; {int(selected.sum())} are selected.")
    return int(np.flatnonzero(selected)[0])


def move_landmark(obj: bpy.types.Object, landmark: int, vertex: int) -> None:
    """Bind `landmark` (position in the 66) of `obj` to `vertex`; HeadError where another one lies there."""
    landmarks = read_landmarks(obj)
    taken = np.flatnonzero(landmarks == vertex)
    if len(taken) and taken[0] != landmark:
        raise HeadError("Another landmark lies on that vertex. Pick a vertex of its own.")
    landmarks[landmark] = vertex
    write_landmarks(obj.data, landmarks)


def _bound(
    vertices: NDArray[np.floating], faces: NDArray[np.intp], marks: dict[int, int], axes: list[NDArray[np.floating]]
) -> tuple[Binding, NDArray[np.floating]]:
    """The landmarks, and along which of `axes`, rotations (3, 3), they were looked for: the first along which there is
    a face, else those along which the template was bent least.

    Raises
    ------
    HeadError
        Where no face is found along any of them.
    """
    found: list[tuple[Binding, NDArray[np.floating]]] = []
    failure: HeadError | None = None
    for rotation in axes:
        try:
            binding = bind_landmarks(vertices @ rotation.T, faces, marks)
        except HeadError as error:
            failure = error
            continue
        found.append((binding, rotation))
        if binding.strain <= _STRAIN:
            break
    if not found:
        assert failure is not None
        raise failure
    return min(found, key=lambda pair: pair[0].strain)


def _skin(obj: bpy.types.Object) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The vertices (N,) of `obj` but for eyes that were cut out, whose border would pass for the lids', and the faces
    (F, K) among them, in numbers of these.
    """
    count = len(obj.data.vertices)
    skin = np.setdiff1d(np.arange(count), eye_vertices(obj))
    number = np.full(count + 1, -1)
    number[skin] = np.arange(len(skin))
    faces = read_faces(obj.data)
    whole = ((number[faces] >= 0) | (faces < 0)).all(axis=1)
    return skin, number[faces[whole]]


def _is_small(rotation: NDArray[np.floating]) -> bool:
    return float(np.trace(rotation) - 1.0) / 2.0 >= _UPRIGHT


def _turn(obj: bpy.types.Object, rotation: NDArray[np.floating]) -> None:
    if obj.data.users > 1:
        raise HeadError(f"The mesh of {obj.name} must be turned to face -Y, but others use it. Make it single-user.")
    turn = Matrix(rotation.tolist()).to_4x4()
    obj.data.transform(turn, shape_keys=True)
    obj.matrix_world = obj.matrix_world @ turn.inverted()
    for child in obj.children:
        child.matrix_parent_inverse = turn @ child.matrix_parent_inverse

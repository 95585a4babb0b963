"""Preparation of a mesh as a head: landmarks are bound and regions proposed, and both are stored with the mesh."""

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

_HUMAN_STRAIN = 0.04
"""Largest bending of the template that fits a human head, in eye distances."""
_UPRIGHT = np.cos(np.radians(20.0))
"""Cosine of the angle to -Y above which a mesh is rotated; a smaller one is the pose of the head."""


def bind_head(obj: bpy.types.Object | None) -> Binding:
    """Find the landmarks of `obj`, with or without marked points, and propose its regions.

    Without marks the face is searched along the axes of the scene, first upright towards -Y, as importers rotate the
    object rather than its vertices. Then it is searched along the object's own axes, as the object may be rotated by
    any angle. If the vertices are not upright, they are rotated, and the object is rotated back, so that nothing moves
    in the scene.

    Raises
    ------
    HeadError
        If no face is found, or a mesh that several objects share would have to be rotated.
    """
    mesh = mesh_of(obj)
    marks = read_marks(mesh)
    scene_axes = HEAD_TO_BLENDER.T @ np.array(obj.matrix_world.to_quaternion().to_matrix()) @ HEAD_TO_BLENDER
    skin, faces = _skin(obj)
    number = {vertex: place for place, vertex in enumerate(skin.tolist())}
    marks = {landmark: number[vertex] for landmark, vertex in marks.items() if vertex in number}
    aligned = np.allclose(scene_axes, np.eye(3), atol=1e-3)
    axes = [scene_axes] if marks or aligned else [scene_axes, np.eye(3)]
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
    """Replace the weights of the regions of `obj` by a proposal from its landmarks."""
    landmarks = read_landmarks(obj)
    write_regions(obj, propose_regions(read_vertices(obj.data), read_faces(obj.data), landmarks))


def check_object(obj: bpy.types.Object | None) -> list[Finding]:
    """Check `obj` for problems; raises HeadError if it has no landmarks or regions."""
    mesh = mesh_of(obj)
    return check_head(read_vertices(mesh), read_faces(mesh), read_landmarks(obj), read_regions(obj))


def missing_parts(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """Return what the mesh `obj` lacks to be driven: a sentence, and the operator that adds it.

    Only names are examined, which is fast enough for drawing a panel; `check_object` examines the mesh itself.
    """
    mesh = obj.data
    if LANDMARKS_PROPERTY not in mesh:
        return [("This mesh has no landmarks yet", "facemime.bind_landmarks")]
    if (bound_at := stored_integers(mesh, COUNT_PROPERTY)) is not None and not np.array_equal(
        bound_at, len(mesh.vertices)
    ):
        return [("The vertex count has changed since the landmarks were bound", "facemime.bind_landmarks")]
    if any(name not in obj.vertex_groups for name in REGION_GROUPS):
        return [("This mesh has no regions yet", "facemime.propose_regions")]
    return []


def read_marks(mesh: bpy.types.Mesh) -> dict[int, int]:
    """Return the marked points: iBUG number to vertex index."""
    flat = stored_integers(mesh, MARKS_PROPERTY)
    if flat is None or flat.ndim != 1 or len(flat) % 2:
        return {}
    return dict(flat.reshape(-1, 2).tolist())


def write_mark(mesh: bpy.types.Mesh, number: int, vertex: int) -> None:
    """Mark `vertex` as the landmark with the iBUG number `number`.

    Parameters
    ----------
    mesh : bpy.types.Mesh
    number : int
        iBUG number of the landmark.
    vertex : int
    """
    marks = read_marks(mesh) | {number: vertex}
    mesh[MARKS_PROPERTY] = [value for pair in marks.items() for value in pair]


def clear_marks(mesh: bpy.types.Mesh) -> None:
    """Remove all marked points."""
    if MARKS_PROPERTY in mesh:
        del mesh[MARKS_PROPERTY]


def selected_vertex(obj: bpy.types.Object) -> int:
    """Return the single vertex selected in Edit Mode; raises HeadError unless exactly one is selected."""
    obj.update_from_editmode()
    selected = np.empty(len(obj.data.vertices), dtype=bool)
    obj.data.vertices.foreach_get("select", selected)
    if selected.sum() != 1:
        raise HeadError(f"{int(selected.sum())} vertices are selected. Select a single one in Edit Mode.")
    return int(np.flatnonzero(selected)[0])


def move_landmark(obj: bpy.types.Object, landmark: int, vertex: int) -> None:
    """Bind a landmark to another vertex.

    Parameters
    ----------
    obj : bpy.types.Object
    landmark : int
        Index in the 66 landmarks.
    vertex : int

    Raises
    ------
    HeadError
        If another landmark is bound to that vertex.
    """
    landmarks = read_landmarks(obj)
    taken = np.flatnonzero(landmarks == vertex)
    if len(taken) and taken[0] != landmark:
        raise HeadError("Another landmark is bound to this vertex. Select a different vertex.")
    landmarks[landmark] = vertex
    write_landmarks(obj.data, landmarks)


def _bound(
    vertices: NDArray[np.floating], faces: NDArray[np.intp], marks: dict[int, int], axes: list[NDArray[np.floating]]
) -> tuple[Binding, NDArray[np.floating]]:
    """Return the binding, and the one of `axes`, (3, 3) rotations, along which it was found: the first along which
    there is a human face, or otherwise that along which the template was bent least.

    Raises
    ------
    HeadError
        If no face is found along any of them.
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
        if binding.strain <= _HUMAN_STRAIN:
            break
    if not found:
        assert failure is not None
        raise failure
    return min(found, key=lambda pair: pair[0].strain)


def _skin(obj: bpy.types.Object) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (N,) vertex indices of `obj` without eyes that were cut out, whose border could be mistaken for that of
    the lids, and the (F, K) faces between them, as indices into these.
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
        raise HeadError(
            f"The mesh of {obj.name} has to be rotated to face -Y, but other objects share it. Make it single-user."
        )
    turn = Matrix(rotation.tolist()).to_4x4()
    obj.data.transform(turn, shape_keys=True)
    obj.matrix_world = obj.matrix_world @ turn.inverted()
    for child in obj.children:
        child.matrix_parent_inverse = turn @ child.matrix_parent_inverse

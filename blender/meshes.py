"""Vertices of a mesh to and from numpy, and the rig (landmarks, regions) that is stored with a mesh."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.control_points.greedy import GreedySelection
from ..core.control_points.select import from_json, to_json
from ..core.errors import HeadError
from ..core.heads.eyeballs import eyeball_of
from ..core.heads.rig import HeadRig
from ..core.landmarks import N_LANDMARKS, OUTER_EYE_CORNERS
from .frames import flat_in_blender, from_blender
from .names import COUNT_PROPERTY, EYES_GROUP, LANDMARKS_PROPERTY, PART_PROPERTY, REGION_GROUPS, SELECTION_PROPERTY

_JAW_SIDES = (2, 14)
_VERTICES_A_CHECK = 2048


def exists(block: bpy.types.ID) -> bool:
    """Whether a data-block that Python refers to is still there: it dies when the user deletes it."""
    try:
        return bool(block.name)
    except ReferenceError:
        return False


def mesh_of(obj: bpy.types.Object | None) -> bpy.types.Mesh:
    """The mesh of `obj`; HeadError where there is no object or it is no mesh."""
    if obj is None:
        raise HeadError("No object is active. Add a head with Add > Mesh > Facemime Head, or select your own.")
    if not isinstance(obj.data, bpy.types.Mesh):
        raise HeadError(f"{obj.name} is not a mesh. Select a head mesh, or add one with Add > Mesh > Facemime Head.")
    return obj.data


def require_own(mesh: bpy.types.Mesh) -> None:
    """Raise HeadError where `mesh` is linked from another file: what is written to it is gone with this one."""
    if mesh.library is not None:
        raise HeadError(
            f"The mesh {mesh.name} is linked from another file, and what is changed here would be lost. "
            "Change it there, or make it local."
        )


def is_head(obj: bpy.types.Object) -> bool:
    """Whether `obj` is a mesh with landmarks."""
    return isinstance(obj.data, bpy.types.Mesh) and LANDMARKS_PROPERTY in obj.data


def read_vertices(mesh: bpy.types.Mesh) -> NDArray[np.float32]:
    """Rest vertices of `mesh`, (V, 3) float32 in the head frame: of its basis shape key where it has keys.

    Raises
    ------
    HeadError
        In Edit mode, where Blender keeps those of a mesh without shape keys elsewhere.
    """
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    if mesh.shape_keys is not None:
        mesh.shape_keys.reference_key.points.foreach_get("co", flat)
    elif mesh.is_editmode:
        raise HeadError(f"{mesh.name} is being edited. Leave Edit mode first.")
    elif len(mesh.vertices):  # an empty mesh lacks the attribute
        mesh.attributes["position"].data.foreach_get("vector", flat)
    return from_blender(flat.reshape(-1, 3))


def write_vertices(mesh: bpy.types.Mesh, vertices: NDArray[np.float32]) -> None:
    """Move all vertices of `mesh`, which has no shape keys, to (V, 3) `vertices` in the head frame.

    The assignment of one vertex to itself renews normals and bounds, which the fast write leaves stale before 5.2.
    """
    flat = flat_in_blender(np.ascontiguousarray(vertices, dtype=np.float32))
    mesh.attributes["position"].data.foreach_set("vector", flat)
    first = mesh.vertices[0]
    first.co = first.co


def read_faces(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    """(F, K) vertices of each face, padded with -1."""
    corners = read_corners(mesh)
    counts = np.empty(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("loop_total", counts)
    faces = np.full((len(counts), max(3, int(counts.max(initial=3)))), -1, dtype=np.int32)
    faces[np.arange(faces.shape[1]) < counts[:, None]] = corners
    return faces


def read_corners(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    """The vertices of all faces' corners, one face behind the other."""
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    if mesh.is_editmode:  # its attributes are those of what is being edited
        mesh.loops.foreach_get("vertex_index", corners)
    elif len(corners):  # an empty mesh lacks the attribute
        mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
    return corners


def read_landmarks(obj: bpy.types.Object) -> NDArray[np.intp]:
    """(66,) vertices of the landmarks of `obj`.

    Raises
    ------
    HeadError
        Where none are bound, or the mesh is no longer the one that they were bound on.
    """
    mesh = mesh_of(obj)
    landmarks, bound_at = stored_integers(mesh, LANDMARKS_PROPERTY), stored_integers(mesh, COUNT_PROPERTY)
    if landmarks is None or landmarks.shape != (N_LANDMARKS,):
        raise HeadError(
            f"{obj.name} has no landmarks. Bind them (sidebar, Facemime, Your Own Head), or use the built-in head."
        )
    count = len(mesh.vertices)
    if bound_at is not None and not np.array_equal(bound_at, count):
        raise HeadError(
            f"{obj.name} had {bound_at} vertices when its landmarks were bound and has {count} now. "
            "Undo that change, or bind the landmarks again."
        )
    if landmarks.min() < 0 or landmarks.max() >= count:
        raise HeadError(f"The landmarks of {obj.name} name vertices that the mesh no longer has. Bind them again.")
    return landmarks


def stored_integers(mesh: bpy.types.Mesh, name: str) -> NDArray[np.intp] | None:
    """The whole number or numbers in a custom property of `mesh`; None where it is missing or holds something else.

    Custom properties are the user's to edit, and other add-ons'.
    """
    value = mesh.get(name)
    try:
        numbers = np.asarray(value.to_list() if hasattr(value, "to_list") else value)
    except ValueError:
        return None
    return numbers.astype(np.intp) if numbers.dtype.kind in "iu" and numbers.ndim <= 1 else None


def write_landmarks(mesh: bpy.types.Mesh, landmarks: NDArray[np.integer]) -> None:
    """Keep (66,) `landmarks` with `mesh`: they go with it through undo, saving, copying and renaming.

    Raises
    ------
    HeadError
        Where `mesh` is linked from another file.
    """
    require_own(mesh)
    mesh[LANDMARKS_PROPERTY] = [int(vertex) for vertex in landmarks]
    mesh[COUNT_PROPERTY] = len(mesh.vertices)


def read_selection(mesh: bpy.types.Mesh) -> GreedySelection | None:
    """The control points chosen for `mesh`; None where all landmarks are."""
    text = mesh.get(SELECTION_PROPERTY)
    return None if text is None else from_json(str(text))


def write_selection(mesh: bpy.types.Mesh, selection: GreedySelection | None) -> None:
    """Keep the chosen control points with `mesh`; None goes back to all landmarks."""
    if selection is not None:
        mesh[SELECTION_PROPERTY] = to_json(selection)
    elif SELECTION_PROPERTY in mesh:
        del mesh[SELECTION_PROPERTY]


def read_rig(obj: bpy.types.Object | None) -> HeadRig:
    """What driving `obj` needs, read from its mesh, landmark property and vertex groups.

    Raises
    ------
    HeadError
        Where the object is no mesh, or its landmarks or regions are missing or no longer fit the mesh.
    """
    mesh_of(obj)
    quick = _read_quickly(obj)
    return HeadRig(**quick, region_weights=read_regions(obj), faces=read_faces(obj.data))


def rig_checks(obj: bpy.types.Object, rig: HeadRig) -> Iterator[bool]:
    """Whether `obj` is still as `rig` says, as far as one slice after the other shows; for use between two frames.

    The weights of a dense mesh take a tenth of a second to read, as Blender hands them out one by one; a slice of them
    takes some 2 ms. Faces count as the same where their corners are.

    Raises
    ------
    HeadError
        As `read_rig`.
    """
    mesh_of(obj)
    quick = _read_quickly(obj)
    # Eyes that have turned have their old size but for rounding.
    yield all(
        np.allclose(value, getattr(rig, name), rtol=1e-5, atol=1e-9)
        if name == "eyeballs" and len(value) == len(rig.eyeballs)
        else np.array_equal(value, getattr(rig, name))
        for name, value in quick.items()
    )
    if rig.faces is not None:
        faces = mesh_of(obj).polygons
        yield len(rig.faces) == len(faces) and np.array_equal(read_corners(obj.data), rig.faces[rig.faces >= 0])
    for first in range(0, len(rig.vertices), _VERTICES_A_CHECK):
        mesh_of(obj)
        part = slice(first, first + _VERTICES_A_CHECK)
        yield np.array_equal(read_weights(obj, part), rig.region_weights[:, part])


def _read_quickly(obj: bpy.types.Object) -> dict[str, NDArray | None]:
    """All of a rig but what takes long: its regions and faces."""
    landmarks = read_landmarks(obj)
    selection = read_selection(obj.data)
    vertices = read_vertices(obj.data)
    return {
        "vertices": vertices,
        "landmarks": landmarks,
        "jaw_pivot": _jaw_pivot(obj, vertices[landmarks]),
        "eyeballs": read_eyeballs(obj, vertices[landmarks]),
        "control_points": None if selection is None else selection.membership,
        "covariance": None if selection is None else selection.covariance,
    }


def eye_vertices(obj: bpy.types.Object) -> NDArray[np.intp]:
    """(N,) the vertices of eyes that were cut out of the skin of `obj`; none on most heads."""
    group = obj.vertex_groups.get(EYES_GROUP)
    if group is None:
        return np.empty(0, dtype=np.intp)
    number = group.index
    within = [v.index for v in obj.data.vertices if any(element.group == number for element in v.groups)]
    return np.array(within, dtype=np.intp)


def read_eyeballs(obj: bpy.types.Object, landmarks: NDArray[np.floating]) -> NDArray[np.float64]:
    """(E, 4) centre and radius, in the frame of `obj`, of the eyeballs that are its children or parts of its mesh.

    Eyes of its mesh are told apart by the side on which they lie of the landmarks (66, 3).
    """
    points = read_vertices(obj.data)[eye_vertices(obj)].astype(np.float64)
    right, left = landmarks[OUTER_EYE_CORNERS].astype(np.float64)
    side = (points - (right + left) / 2.0) @ (left - right)
    eyeballs = [eyeball_of(eye).tolist() for eye in (points[side < 0], points[side >= 0]) if len(eye) > 3]
    for child in obj.children:
        if str(child.get(PART_PROPERTY, "")).startswith("eye") and isinstance(child.data, bpy.types.Mesh):
            within = child.matrix_parent_inverse @ child.matrix_basis
            radius = float(np.linalg.norm(read_vertices(child.data), axis=1).max(initial=0.0))
            eyeballs.append([*from_blender(np.array(within.translation)), radius * within.median_scale])
    return np.array(eyeballs).reshape(-1, 4)


def _jaw_pivot(obj: bpy.types.Object, landmarks: NDArray[np.float32]) -> NDArray[np.float64]:
    """Where the jaw turns, (3,): the origin of the lower teeth, or between the jaw line's third points."""
    for child in obj.children:
        if child.get(PART_PROPERTY) == "teeth_lower":
            return from_blender(np.array((child.matrix_parent_inverse @ child.matrix_basis).translation))
    return landmarks[list(_JAW_SIDES)].astype(np.float64).mean(axis=0)


def read_regions(obj: bpy.types.Object) -> NDArray[np.float32]:
    """(3, V) weights of the vertex groups Upper, Middle and Lower; HeadError where one is missing or empty."""
    weights = read_weights(obj, slice(None))
    if empty := [name for name, row in zip(REGION_GROUPS, weights, strict=True) if not row.any()]:
        raise HeadError(
            f"The vertex groups {', '.join(empty)} of {obj.name} are empty. Paint these regions on the mesh."
        )
    return weights


def read_weights(obj: bpy.types.Object, part: slice) -> NDArray[np.float32]:
    """(3, n) weights of the vertex groups Upper, Middle and Lower for `part` of the vertices: some 0.7 us for each.

    Raises
    ------
    HeadError
        If one of the groups is missing.
    """
    groups = [obj.vertex_groups.get(name) for name in REGION_GROUPS]
    if missing := [name for name, group in zip(REGION_GROUPS, groups, strict=True) if group is None]:
        raise HeadError(f"{obj.name} lacks the vertex groups {', '.join(missing)}. Paint these regions on the mesh.")
    vertices = obj.data.vertices[part]
    weights = np.zeros((len(groups), len(vertices)), dtype=np.float32)
    row_of = {group.index: row for row, group in enumerate(groups)}
    for place, vertex in enumerate(vertices):
        for element in vertex.groups:
            if (row := row_of.get(element.group)) is not None:
                weights[row, place] = element.weight
    return weights


def write_regions(obj: bpy.types.Object, weights: NDArray[np.floating]) -> None:
    """Make the vertex groups Upper, Middle and Lower of `obj` hold (3, V) `weights`; other groups stay.

    Eyes that were cut out of the skin are in none of them: lids slide over eyes that stay where they are.

    Raises
    ------
    HeadError
        Where the mesh is linked from another file.
    """
    require_own(obj.data)
    shares = np.array(weights)
    shares[:, eye_vertices(obj)] = 0.0
    for name, row in zip(REGION_GROUPS, shares, strict=True):
        group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
        group.remove(np.flatnonzero(row == 0.0).tolist())
        for vertex in np.flatnonzero(row).tolist():
            group.add([vertex], float(row[vertex]), "REPLACE")

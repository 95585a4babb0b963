"""Conversion of meshes to and from numpy, the landmarks and regions that are stored with a mesh, and the bones of
armatures.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.control_points.selection import GreedySelection, from_json, to_json
from ..core.errors import HeadError
from ..core.face.landmarks import N_LANDMARKS
from .frames import flat_in_blender, from_blender
from .names import (
    BAKED_KEY_PREFIX,
    COUNT_PROPERTY,
    EYES_GROUP,
    KEYS_PROPERTY,
    LANDMARKS_PROPERTY,
    REGION_GROUPS,
    SELECTION_PROPERTY,
)


def exists(block: bpy.types.ID) -> bool:
    """Return whether a data-block that Python refers to has not been deleted."""
    try:
        return bool(block.name)
    except ReferenceError:
        return False


def object_of(obj: bpy.types.Object | None) -> bpy.types.Object:
    """Return `obj`; raises HeadError if there is no object."""
    if obj is None:
        raise HeadError("There is no active object. Add a head with Add > Mesh > Facemime Head, or select one.")
    return obj


def mesh_of(obj: bpy.types.Object | None) -> bpy.types.Mesh:
    """Return the mesh of `obj`; raises HeadError if there is no object or it is not a mesh."""
    obj = object_of(obj)
    if not isinstance(obj.data, bpy.types.Mesh):
        raise HeadError(
            "{name} is not a mesh. Select a head mesh, or add one with Add > Mesh > Facemime Head.", name=obj.name
        )
    return obj.data


def make_room(key: bpy.types.ShapeKey, value: float) -> None:
    """Extend the range of a shape key to a value that would be clipped to it; a range that ends before 1, or does not
    begin at 0, is a choice of the user's, and stays.
    """
    if 1.0 <= key.slider_max < value:
        key.slider_max = value
    if value < key.slider_min == 0.0:
        key.slider_min = -1.0


def keys_of(obj: bpy.types.Object) -> bpy.types.Key:
    """Return the shape keys of a mesh that has some."""
    keys = mesh_of(obj).shape_keys
    assert keys is not None, f"{obj.name} has no shape keys"
    return keys


def require_own(mesh: bpy.types.Mesh) -> None:
    """Raise HeadError if `mesh` is linked from another file, as changes to it would not be saved."""
    if mesh.library is not None:
        raise HeadError(
            "The mesh {name} is linked from another file, so changes to it would be lost. "
            "Change it in that file, or make it local.",
            name=mesh.name,
        )


def is_head(obj: bpy.types.Object) -> bool:
    """Return whether `obj` is a mesh with landmarks."""
    return isinstance(obj.data, bpy.types.Mesh) and LANDMARKS_PROPERTY in obj.data


def driven_by_keys(obj: bpy.types.Object) -> bool:
    """Return whether `obj` is a mesh without landmarks that is bound by its shape keys."""
    return isinstance(obj.data, bpy.types.Mesh) and KEYS_PROPERTY in obj.data and not is_head(obj)


def can_be_driven(obj: bpy.types.Object) -> bool:
    """Return whether `obj` is bound, by landmarks or by its shape keys."""
    return is_head(obj) or driven_by_keys(obj)


def read_vertices(mesh: bpy.types.Mesh) -> NDArray[np.float32]:
    """Return the vertices of `mesh` at rest, (V, 3) float32 in the head frame: of the Basis if it has shape keys.

    Raises HeadError if a mesh without shape keys is in Edit Mode, where Blender stores its vertices elsewhere.
    """
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    if mesh.shape_keys is not None:
        mesh.shape_keys.reference_key.points.foreach_get("co", flat)
    elif mesh.is_editmode:
        raise HeadError("{name} is in Edit Mode. Leave Edit Mode first.", name=mesh.name)
    elif len(mesh.vertices):  # an empty mesh lacks the attribute
        mesh.attributes["position"].data.foreach_get("vector", flat)
    return from_blender(flat.reshape(-1, 3))


def write_vertices(mesh: bpy.types.Mesh, vertices: NDArray[np.float32]) -> None:
    """Set the vertices (V, 3) of a mesh without shape keys, in the head frame.

    Before Blender 5.2 a bulk write leaves normals and bounds stale; assigning one vertex to itself updates them.
    """
    flat = flat_in_blender(np.ascontiguousarray(vertices, dtype=np.float32))
    mesh.attributes["position"].data.foreach_set("vector", flat)
    first = mesh.vertices[0]
    first.co = first.co


def move_vertices(mesh: bpy.types.Mesh, offsets: NDArray[np.floating[Any]]) -> None:
    """Move the vertices of a mesh by (V, 3) in its axes, at rest and in all of its shape keys."""
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", flat)
    mesh.vertices.foreach_set("co", flat + np.asarray(offsets, dtype=np.float32).reshape(-1))
    for key in [] if mesh.shape_keys is None else mesh.shape_keys.key_blocks:
        key.points.foreach_set("co", (key_points(key) + offsets).astype(np.float32).reshape(-1))
    mesh.update()


def read_faces(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    """Return (F, K) vertex indices of each face, padded with -1."""
    corners = read_corners(mesh)
    counts = np.empty(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("loop_total", counts)
    faces = np.full((len(counts), max(3, int(counts.max(initial=3)))), -1, dtype=np.int32)
    faces[np.arange(faces.shape[1]) < counts[:, None]] = corners
    return faces


def read_uv(mesh: bpy.types.Mesh, faces: NDArray[np.int32]) -> NDArray[np.float32] | None:
    """Return the active texture coordinates (F, K, 2) of the corners of `faces`, all those of the mesh, or None."""
    layer = mesh.uv_layers.active
    if layer is None or len(layer.data) != len(mesh.loops):
        return None
    flat = np.empty(2 * len(mesh.loops), dtype=np.float32)
    layer.data.foreach_get("uv", flat)
    uv = np.zeros((*faces.shape, 2), dtype=np.float32)
    uv[faces >= 0] = flat.reshape(-1, 2)
    return uv


def read_corners(mesh: bpy.types.Mesh) -> NDArray[np.int32]:
    """Return the vertex indices of all face corners, face after face."""
    corners = np.empty(len(mesh.loops), dtype=np.int32)
    if mesh.is_editmode:  # its attributes are not up to date
        mesh.loops.foreach_get("vertex_index", corners)
    elif len(corners):  # an empty mesh lacks the attribute
        mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
    return corners


def read_landmarks(obj: bpy.types.Object) -> NDArray[np.intp]:
    """Return the vertices (66,) of the landmarks; raises HeadError without any, or if the vertex count has changed."""
    return _stored_landmarks(obj, LANDMARKS_PROPERTY)


def read_places(obj: bpy.types.Object) -> NDArray[np.intp]:
    """Do what `read_landmarks` does, or return vertices (66,) near where they would lie if keys drive the head."""
    return _stored_landmarks(obj, KEYS_PROPERTY if driven_by_keys(obj) else LANDMARKS_PROPERTY)


def _stored_landmarks(obj: bpy.types.Object, name: str) -> NDArray[np.intp]:
    mesh = mesh_of(obj)
    landmarks, bound_at = stored_integers(mesh, name), stored_integers(mesh, COUNT_PROPERTY)
    if landmarks is None or landmarks.shape != (N_LANDMARKS,):
        raise HeadError(
            "{name} has no landmarks. Find its face in Head > Your Own Head, or use the built-in head.", name=obj.name
        )
    count = len(mesh.vertices)
    if bound_at is not None and not np.array_equal(bound_at, count):
        raise HeadError(
            "The vertex count of {name} has changed from {bound_at} to {count} since its face was found. "
            "Undo that change, or find the face again.",
            name=obj.name,
            bound_at=bound_at,
            count=count,
        )
    if landmarks.min() < 0 or landmarks.max() >= count:
        raise HeadError(
            "The landmarks of {name} refer to vertices that no longer exist. Find the face again.", name=obj.name
        )
    return landmarks


def stored_integers(mesh: bpy.types.Mesh, name: str) -> NDArray[np.intp] | None:
    """Read an integer () or integers (N,) from a custom property, which users and add-ons may have edited.

    It is None if the property is missing or has another type.
    """
    value = mesh.get(name)
    try:
        numbers = np.asarray(value.to_list() if hasattr(value, "to_list") else value)
    except ValueError:
        return None
    return numbers.astype(np.intp) if numbers.dtype.kind in "iu" and numbers.ndim <= 1 else None


def write_landmarks(mesh: bpy.types.Mesh, landmarks: NDArray[np.integer[Any]]) -> None:
    """Store landmarks (66,) in custom properties of a mesh, which undo, saving, copying and renaming preserve.

    Raises HeadError if the mesh is linked from another file.
    """
    require_own(mesh)
    mesh[LANDMARKS_PROPERTY] = [int(vertex) for vertex in landmarks]
    mesh[COUNT_PROPERTY] = len(mesh.vertices)


def key_names(obj: bpy.types.Object) -> list[str]:
    """Return the names of the user's shape keys of `obj`: neither the Basis nor those that Facemime made."""
    keys = mesh_of(obj).shape_keys
    if keys is None:
        return []
    return [
        key.name
        for key in keys.key_blocks
        if key != keys.reference_key and not key.name.startswith(BAKED_KEY_PREFIX) and key.slider_min < key.slider_max
    ]


def key_offsets(key: bpy.types.ShapeKey) -> NDArray[np.float32]:
    """Return (V, 3) displacements by a key at value 1 in Blender's axes, without its vertex group."""
    return key_points(key) - key_points(key.relative_key)


def key_points(key: bpy.types.ShapeKey) -> NDArray[np.float32]:
    """Return (V, 3) positions of a key in Blender's axes."""
    flat = np.empty(3 * len(key.points), dtype=np.float32)
    key.points.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def read_selection(mesh: bpy.types.Mesh) -> GreedySelection | None:
    """Return the control points selected for `mesh`; None if all landmarks are."""
    text = mesh.get(SELECTION_PROPERTY)
    return None if text is None else from_json(str(text))


def write_selection(mesh: bpy.types.Mesh, selection: GreedySelection | None) -> None:
    """Store the selected control points with `mesh`; None stands for all landmarks."""
    if selection is not None:
        mesh[SELECTION_PROPERTY] = to_json(selection)
    elif SELECTION_PROPERTY in mesh:
        del mesh[SELECTION_PROPERTY]


def eye_vertices(obj: bpy.types.Object) -> NDArray[np.intp]:
    """Return (N,) indices of the vertices of eyes that were cut out of the skin of `obj`; empty on most heads."""
    group = obj.vertex_groups.get(EYES_GROUP)
    if group is None:
        return np.empty(0, dtype=np.intp)
    number = group.index
    within = [v.index for v in mesh_of(obj).vertices if any(element.group == number for element in v.groups)]
    return np.array(within, dtype=np.intp)


def group_weights(obj: bpy.types.Object, name: str) -> NDArray[np.float32]:
    """Return (V,) weights of the vertex group `name` of `obj`, all 0 if it has no such group."""
    return np.asarray(_group_weights(obj, (name,), slice(None))[0])


def read_regions(obj: bpy.types.Object) -> NDArray[np.float32]:
    """Return (3, V) weights of the upper, middle and lower region; raises HeadError if one is missing or empty."""
    weights = read_weights(obj, slice(None))
    if empty := [name for name, row in zip(REGION_GROUPS, weights, strict=True) if not row.any()]:
        raise HeadError(
            "Empty vertex groups of {name}: {empty}. Paint these regions, or use Reset Regions.",
            name=obj.name,
            empty=", ".join(empty),
        )
    return weights


def read_weights(obj: bpy.types.Object, part: slice) -> NDArray[np.float32]:
    """Read the weights (3, n) of the upper, middle and lower region at n vertices, in about 0.7 us per vertex.

    Raises HeadError if one of the vertex groups is missing.
    """
    if missing := [name for name in REGION_GROUPS if name not in obj.vertex_groups]:
        raise HeadError(
            "Missing vertex groups of {name}: {missing}. Paint these regions, or use Reset Regions.",
            name=obj.name,
            missing=", ".join(missing),
        )
    return _group_weights(obj, REGION_GROUPS, part)


def _group_weights(obj: bpy.types.Object, names: tuple[str, ...], part: slice) -> NDArray[np.float32]:
    """Weights of some vertices in groups, (G, n), 0 in those that do not exist."""
    vertices = mesh_of(obj).vertices[part]
    weights = np.zeros((len(names), len(vertices)), dtype=np.float32)
    groups = [obj.vertex_groups.get(name) for name in names]
    row_of = {group.index: row for row, group in enumerate(groups) if group is not None}
    for place, vertex in enumerate(vertices):
        for element in vertex.groups:
            if (row := row_of.get(element.group)) is not None:
                weights[row, place] = element.weight
    return weights


def write_regions(obj: bpy.types.Object, weights: NDArray[np.floating[Any]]) -> None:
    """Write the weights (3, V) of the upper, middle and lower region; other vertex groups are left unchanged.

    Eyes that were cut out of the skin are removed from all regions, so that they stay in place under the lids. Raises
    HeadError if the mesh is linked from another file.
    """
    require_own(mesh_of(obj))
    shares = np.array(weights)
    shares[:, eye_vertices(obj)] = 0.0
    for name, row in zip(REGION_GROUPS, shares, strict=True):
        group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
        group.remove(np.flatnonzero(row == 0.0).tolist())
        for vertex in np.flatnonzero(row).tolist():
            group.add([vertex], float(row[vertex]), "REPLACE")


def rest_bones(armature: bpy.types.Object) -> bpy.types.ArmatureBones:
    """Return the bones of an armature at rest."""
    return armature_data(armature).bones


def armature_data(armature: bpy.types.Object) -> bpy.types.Armature:
    """Return the data of an armature."""
    assert isinstance(armature.data, bpy.types.Armature), f"{armature.name} is no armature"
    return armature.data


def posed_bones(armature: bpy.types.Object) -> bpy.types.bpy_prop_collection[bpy.types.PoseBone]:
    """Return the bones of an armature as they are posed."""
    assert armature.pose is not None, f"{armature.name} is no armature"
    return armature.pose.bones

"""Defects of a mesh that keep its face from being found, each with its remedy."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.numeric.arrays import FloatArray
from ..contexts import evaluated_depsgraph
from ..frames import to_blender
from ..meshes import keys_of, mesh_of, read_faces, read_vertices
from .family import family_of

_INFINITE = 1e15
"""Coordinate above which a vertex counts as infinite: Blender limits those that are set to the largest number."""
_NAMED = 3
"""Number of vertices that a message names."""
_ASTRAY = 16.0
"""Distance from the middle of a mesh above which a vertex is astray, relative to the distance within which `_SPREAD`
percent of the vertices lie. The feet of a character whose head has nine tenths of the vertices are at 10."""
_SPREAD = 90.0
"""Percentage of the vertices whose distance from the middle is the usual one."""
_FEW = 0.01
"""Largest share of the vertices that can be astray; more are a part of the mesh."""
_ONE_SIDED = 0.98
"""Share of the vertices on one side of a mirror above which the mesh is only half of what is seen."""
_HARMLESS = {"ARMATURE", "MASK", "TRIANGULATE", "WELD", "EDGE_SPLIT", "BEVEL", "SOLIDIFY"}
"""Types of modifiers that add no part of a face that the mesh lacks."""
_SUBDIVIDING = {"SUBSURF", "MULTIRES"}
"""Types of modifiers that add vertices to a face that is in the mesh."""


_SELECTIONS = (".select_vert", ".select_edge", ".select_poly")
"""Attributes of a mesh that hold which vertices, edges and faces are selected."""


def require_sound(obj: bpy.types.Object) -> None:
    """Raise HeadError if vertices of the character of `obj` are not at numbers, which are then selected, or half of
    `obj` is mirrored.
    """
    for member in family_of(obj):
        _require_finite(member)
    mirrors = [modifier for modifier in _shown_modifiers(obj) if isinstance(modifier, bpy.types.MirrorModifier)]
    for modifier in mirrors:
        if _is_half(obj, modifier):
            raise HeadError(
                "{name} is one half of a head, and its modifier {modifier} shows the other. "
                "Apply the modifier, and find the face again.",
                name=obj.name,
                modifier=modifier.name,
            )


def generating_modifiers(obj: bpy.types.Object, *, coarse: bool) -> list[str]:
    """Return the names of modifiers that may add a face to what is in the mesh `obj`, or vertices if it is `coarse`."""
    harmless = _HARMLESS if coarse else _HARMLESS | _SUBDIVIDING
    names = [modifier.name for modifier in _shown_modifiers(obj) if modifier.type not in harmless]
    final = obj.evaluated_get(evaluated_depsgraph(bpy.context)) if names else obj
    return names if names and len(mesh_of(final).vertices) != len(mesh_of(obj).vertices) else []


def stray_vertices(obj: bpy.types.Object) -> NDArray[np.bool_]:
    """Return (V,) whether a vertex is astray: in no face, as scans leave some behind, or far from all others."""
    vertices, faces = read_vertices(mesh_of(obj)).astype(np.float64), read_faces(mesh_of(obj))
    loose = np.ones(len(vertices), dtype=bool)
    loose[np.unique(faces[faces >= 0])] = False
    if not (~loose).any():
        return np.zeros_like(loose)
    away = np.linalg.norm(vertices - np.median(vertices[~loose], axis=0), axis=1)
    far = away > _ASTRAY * np.percentile(away[~loose], _SPREAD)
    return loose | far if far.mean() <= _FEW else loose


def _require_finite(obj: bpy.types.Object) -> None:
    bad = _infinite(read_vertices(mesh_of(obj)))
    if bad.any():
        _select(mesh_of(obj), bad)
        numbers = ", ".join(map(str, np.flatnonzero(bad)[:_NAMED])) + (", ..." if bad.sum() > _NAMED else "")
        raise HeadError(
            "{name} has vertices whose positions are infinite or not numbers: {numbers}. "
            "Delete them in Edit Mode, where they are selected, and find the face again.",
            name=obj.name,
            numbers=numbers,
        )
    for key in keys_of(obj).key_blocks if mesh_of(obj).shape_keys is not None else ():
        flat = np.empty(3 * len(key.points), dtype=np.float32)
        key.points.foreach_get("co", flat)
        if _infinite(flat.reshape(-1, 3)).any():
            raise HeadError(
                "The shape key {key} of {name} has positions that are infinite or not numbers. "
                "Delete the key, and find the face again.",
                key=key.name,
                name=obj.name,
            )


def _infinite(places: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    return np.asarray(~(np.abs(places) < _INFINITE).all(axis=1))


def _select(mesh: bpy.types.Mesh, chosen: NDArray[np.bool_]) -> None:
    """Select only these vertices (V,).

    Blender 5.0 stores a selection of none or all as one value, and crashes when several are written over that.
    """
    for name in _SELECTIONS:
        if (layer := mesh.attributes.get(name)) is not None:
            mesh.attributes.remove(layer)
    mesh.vertices.foreach_set("select", chosen)


def _shown_modifiers(obj: bpy.types.Object) -> list[bpy.types.Modifier]:
    return [modifier for modifier in obj.modifiers if modifier.show_viewport]


def _is_half(obj: bpy.types.Object, mirror: bpy.types.MirrorModifier) -> bool:
    """Return whether (almost) all vertices of `obj` are on one side of a plane of its Mirror modifier."""
    places = np.array(to_blender(read_vertices(mesh_of(obj))), dtype=np.float64)
    if mirror.mirror_object is not None:
        own = np.array(mirror.mirror_object.matrix_world.inverted_safe() @ obj.matrix_world)
        places = places @ own[:3, :3].T + own[:3, 3]
    return any(_is_one_sided(places[:, axis]) for axis in range(3) if mirror.use_axis[axis])


def _is_one_sided(across: FloatArray) -> bool:
    middle = 1e-4 * float(np.abs(across).max(initial=0.0))
    return bool(max((across >= -middle).mean(), (across <= middle).mean()) >= _ONE_SIDED)

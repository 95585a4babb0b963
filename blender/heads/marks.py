"""Marked points from outside Blender's window: by vertex, or by position in the scene."""

from __future__ import annotations

from collections.abc import Mapping

import bpy
import numpy as np

from ...core.errors import HeadError
from ...core.numeric.arrays import FloatArray
from ..frames import to_blender
from ..meshes import mesh_of, read_vertices
from .binding import write_marks
from .family import family_of

Mark = int | tuple[float, float, float]
"""A vertex, or a position in the scene."""
_REACH = 0.1
"""Largest distance of a position from the mesh, as a share of the mesh's diagonal."""


def mark_points(obj: bpy.types.Object, marks: Mapping[int, Mark]) -> bpy.types.Object:
    """Mark points of a face, and return the mesh on which they are.

    Parameters
    ----------
    obj : bpy.types.Object
        A mesh of the character, to which marked vertices belong. Positions mark the mesh of the character that is
        nearest to them.

    Raises
    ------
    HeadError
        If there is no such vertex, or a position is not on the mesh.
    """
    chosen = {number: mark for number, mark in marks.items() if isinstance(mark, int)}
    positions = {number: np.array(mark) for number, mark in marks.items() if not isinstance(mark, int)}
    if positions and not chosen:
        obj = min(family_of(obj), key=lambda mesh: float(_distances(mesh, positions).min(axis=1).sum()))
    count = len(mesh_of(obj).vertices)
    for number, vertex in chosen.items():
        if not 0 <= vertex < count:
            raise HeadError(
                "Point {number} cannot be vertex {vertex}: {name} has {count} vertices, from 0.",
                number=number,
                vertex=vertex,
                name=obj.name,
                count=count,
            )
    away = _distances(obj, positions)
    size = float(np.linalg.norm(np.ptp(_in_scene(obj), axis=0)))
    for number, distances in zip(positions, away, strict=True):
        if distances.min() > _REACH * size:
            raise HeadError(
                "Point {number} is {distance:.3g} m away from {name}. Use Blender's coordinates, with Z up.",
                number=number,
                distance=distances.min(),
                name=obj.name,
            )
        chosen[number] = int(distances.argmin())
    write_marks(mesh_of(obj), chosen)
    return obj


def position_of(obj: bpy.types.Object, vertex: int) -> FloatArray:
    """Return the position of a vertex in the scene, (3,)."""
    return np.asarray(_in_scene(obj)[vertex])


def _in_scene(obj: bpy.types.Object) -> FloatArray:
    matrix = np.array(obj.matrix_world)
    places = np.asarray(to_blender(read_vertices(mesh_of(obj))), dtype=np.float64)
    return np.asarray(places @ matrix[:3, :3].T + matrix[:3, 3])


def _distances(obj: bpy.types.Object, positions: Mapping[int, FloatArray]) -> FloatArray:
    """Distances, (P, V), of positions from the vertices of a mesh."""
    places = _in_scene(obj)
    if not positions or not len(places):
        return np.full((len(positions), 1), np.inf)
    return np.array([np.linalg.norm(places - position, axis=1) for position in positions.values()])

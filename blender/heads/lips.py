"""Opening of joined lips, such as those of a scan, with a dark pocket behind them."""

from __future__ import annotations

from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from ...core.errors import HeadError
from ...core.face.landmarks import MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, from_ibug, outer_eye_distance
from ...core.heads.lips import lip_line, rim_landmarks
from ...core.mesh.surface import SurfaceGraph, lips_joined
from ...core.numeric.arrays import IntArray
from ..meshes import mesh_of, object_of, read_faces, read_landmarks, read_vertices, write_landmarks
from .binding import propose_head_regions
from .cutting import close_seams, copy_moved, edited, indices, separate, split_along
from .materials import plain_material
from .parts import current_skin

_LOWER_LIP = set(from_ibug((*range(55, 60), *range(65, 68))).tolist())
_INNER = np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
_DEPTH = 0.3
"""Depth of the pocket behind the lips, in outer-eye distances."""
_MOUTH = "Facemime Mouth"
_COLOUR = (0.035, 0.012, 0.01)


def open_lips(obj: bpy.types.Object | None) -> int:
    """Cut the mesh of `obj` between the lips, bind the inner lips to the two rims, and propose its regions again.

    A dark pocket is added behind the cut, so that the open mouth cannot be seen through.

    Returns
    -------
    int
        Number of edges that were cut.

    Raises
    ------
    HeadError
        If the mesh has no landmarks, its lips are already open, or no line of edges leads between them.
    """
    mesh, obj = mesh_of(obj), object_of(obj)
    landmarks, skin = read_landmarks(obj), current_skin(obj)
    if not lips_joined(SurfaceGraph(read_vertices(mesh)[skin.kept], skin.faces), skin.number[landmarks]):
        raise HeadError("The lips are already separate from each other, so the mouth can open. Nothing has to be cut.")
    close_seams(obj, skin)
    vertices, landmarks = read_vertices(mesh), read_landmarks(obj)
    graph = SurfaceGraph(vertices, read_faces(mesh))
    line = lip_line(graph, landmarks)
    unit = outer_eye_distance(vertices[landmarks])
    upper, lower, moved = _cut(mesh, line, landmarks, _DEPTH * unit)
    if not mesh.materials:
        mesh.materials.append(None)
    mesh.materials.append(bpy.data.materials.get(_MOUTH) or plain_material(_MOUTH, _COLOUR, 1.0))
    chosen = rim_landmarks(vertices[line])
    moved[MOUTH_INNER_UPPER] = upper[chosen]
    moved[MOUTH_INNER_LOWER] = lower[chosen[::-1]]
    write_landmarks(mesh, separate(moved, read_vertices(mesh), _INNER))
    propose_head_regions(obj)
    return len(line) - 1


def _cut(
    mesh: bpy.types.Mesh, line: IntArray, landmarks: IntArray, depth: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Return (N,) vertices of the upper and of the lower rim, which share the corners, and the (66,) landmarks."""
    with edited(mesh) as work:
        before = list(work.verts)
        rims = _rims(split_along(work, [before[vertex] for vertex in line.tolist()]))
        lower, upper = sorted(rims, key=_height_beside)
        _put_pocket_behind(work, rims, depth, max(1, len(mesh.materials)))
        work.verts.index_update()
        on_line = {before[vertex]: place for place, vertex in enumerate(line.tolist())}
        bound = [before[vertex] for vertex in landmarks.tolist()]
        for landmark, vertex in enumerate(bound):
            if vertex in on_line:
                bound[landmark] = (lower if landmark in _LOWER_LIP else upper)[on_line[vertex]]
        return indices(upper), indices(lower), indices(bound)


def _rims(copies: list[list[bmesh.types.BMVert]]) -> list[list[bmesh.types.BMVert]]:
    """Return the two rims of a cut from the copies of each vertex of its line; edges join vertices of the same rim."""
    if [len(place) for place in copies] != [1, *[2] * (len(copies) - 2), 1]:
        raise HeadError("The mesh has holes at the lips. Cut it along the line between them: Edge > Edge Split.")
    first, last = copies[0][0], copies[-1][0]
    rims = [[first, start] for start in copies[1]]
    for place in copies[2:-1]:
        for rim in rims:
            joined = {edge.other_vert(rim[-1]) for edge in rim[-1].link_edges if edge.is_boundary}
            rim.append(next(vertex for vertex in place if vertex in joined))
    return [[*rim, last] for rim in rims]


def _put_pocket_behind(
    work: bmesh.types.BMesh, rims: list[list[bmesh.types.BMVert]], depth: float, material: int
) -> None:
    """Add walls that lead back from both rims by `depth`, and a wall that joins them there."""
    back_by = Vector((0.0, depth, 0.0))  # the head faces -y
    backs: list[list[bmesh.types.BMVert]] = []
    for rim in rims:
        back = [copy_moved(work, vertex, back_by) for vertex in rim[1:-1]]
        ends = [backs[0][0], backs[0][-1]] if backs else [copy_moved(work, rim[i], back_by) for i in (0, -1)]
        backs.append([ends[0], *back, ends[1]])
    strips = [*zip(rims, backs, strict=True), tuple(backs)]
    for near, far in strips:
        for (a, b), (c, d) in zip(pairwise(near), pairwise(far), strict=True):
            corners = list(dict.fromkeys((a, b, d, c)))  # a triangle at the corners of the mouth
            face = work.faces.new(corners)
            face.material_index, face.smooth = material, True


def _height_beside(rim: list[bmesh.types.BMVert]) -> float:
    """Return how far the faces along a rim are above it; the head is upright along z."""
    return sum(face.calc_center_median().z - vertex.co.z for vertex in rim[1:-1] for face in vertex.link_faces)

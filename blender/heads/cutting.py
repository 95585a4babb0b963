"""Mesh operations shared by opening the lips and opening the eyes of a scan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from ...core.face.landmarks import N_LANDMARKS
from ...core.heads.rig import Skin
from ...core.numeric.arrays import FloatArray, IntArray
from ..meshes import mesh_of, read_faces, read_landmarks, read_vertices, write_landmarks

_TAG = "facemime_line"


@contextmanager
def edited(mesh: bpy.types.Mesh) -> Iterator[bmesh.types.BMesh]:
    """Yield a copy of `mesh` to edit, which is written back unless an error is raised."""
    work = bmesh.new()
    try:
        work.from_mesh(mesh)
        # Adding or removing a layer invalidates references to vertices, so this is done only here.
        tag = work.verts.layers.int.new(_TAG)
        yield work
        work.verts.layers.int.remove(tag)
        work.to_mesh(mesh)
    finally:
        work.free()
    mesh.update()


def surface_of(work: bmesh.types.BMesh) -> tuple[FloatArray, IntArray]:
    """Return (V, 3) vertices in the head frame and (F, K) faces padded with -1."""
    # A mesh can be read much faster than a bmesh.
    mesh = bpy.data.meshes.new("Facemime Surface")
    try:
        work.to_mesh(mesh)
        return read_vertices(mesh), read_faces(mesh)
    finally:
        bpy.data.meshes.remove(mesh)


def close_seams(obj: bpy.types.Object, skin: Skin) -> None:
    """Weld vertices of the skin that are duplicated at texture seams.

    Nothing is lost, as seams are stored on the corners of faces.
    """
    leader = np.where(skin.number >= 0, skin.kept[skin.number], np.arange(len(skin.number)))
    doubled = np.flatnonzero(leader != np.arange(len(leader)))
    if not len(doubled):
        return
    landmarks = read_landmarks(obj)
    with edited(mesh_of(obj)) as work:
        vertices = list(work.verts)
        bound = [vertices[vertex] for vertex in leader[landmarks].tolist()]
        bmesh.ops.weld_verts(work, targetmap={vertices[v]: vertices[leader[v]] for v in doubled.tolist()})
        work.verts.index_update()
        moved = indices(bound)
    write_landmarks(mesh_of(obj), moved)


def split_along(
    work: bmesh.types.BMesh, line: list[bmesh.types.BMVert], *, closed: bool = False
) -> list[list[bmesh.types.BMVert]]:
    """Split the edges along a line of vertices, and return all copies of each vertex.

    In a closed line the last vertex is joined to the first.
    """
    tag = work.verts.layers.int.get(_TAG)
    assert tag is not None
    for place, vertex in enumerate(line, start=1):
        vertex[tag] = place
    pairs = [*pairwise(line), (line[-1], line[0])] if closed else list(pairwise(line))
    bmesh.ops.split_edges(work, edges=[work.edges.get(pair) for pair in pairs])
    copies: list[list[bmesh.types.BMVert]] = [[] for _ in line]
    for vertex in work.verts:
        if vertex[tag]:
            copies[vertex[tag] - 1].append(vertex)
            vertex[tag] = 0
    return copies


def move(work: bmesh.types.BMesh, vertex: bmesh.types.BMVert, by: Vector) -> None:
    """Move a vertex by an offset in every shape key."""
    vertex.co += by
    for key in work.verts.layers.shape.values():
        vertex[key] = vertex[key] + by


def copy_moved(work: bmesh.types.BMesh, vertex: bmesh.types.BMVert, by: Vector) -> bmesh.types.BMVert:
    """Copy a vertex with its weights, moved by an offset in every shape key; parameters as for `move`."""
    copy = work.verts.new(vertex.co, vertex)
    for key in work.verts.layers.shape.values():
        copy[key] = vertex[key]
    move(work, copy, by)
    return copy


def indices(vertices: Iterable[bmesh.types.BMVert]) -> IntArray:
    """Return the indices of vertices; call `work.verts.index_update` before."""
    return np.array([vertex.index for vertex in vertices], dtype=np.intp)


def separate(landmarks: IntArray, vertices: FloatArray, fixed: IntArray) -> IntArray:
    """Move landmarks (66,) that share a vertex to the nearest free one, except for the `fixed` landmarks."""
    moved = landmarks.copy()
    first = fixed.tolist()
    taken: set[int] = set()
    for landmark in (*first, *(i for i in range(N_LANDMARKS) if i not in first)):
        if int(moved[landmark]) in taken:
            order = np.argsort(np.linalg.norm(vertices - vertices[moved[landmark]], axis=1))
            moved[landmark] = next(v for v in order.tolist() if v not in taken)
        taken.add(int(moved[landmark]))
    return moved

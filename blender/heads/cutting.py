"""A skin cut apart: what opening the lips and opening the eyes of a scan have in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from ...core.arrays import FloatArray, IntArray
from ...core.landmarks import N_LANDMARKS
from ..meshes import read_faces, read_vertices

_TAG = "facemime_line"


@contextmanager
def edited(mesh: bpy.types.Mesh) -> Iterator[bmesh.types.BMesh]:
    """A copy of `mesh` to work on, which is written back where no error is raised."""
    work = bmesh.new()
    try:
        work.from_mesh(mesh)
        # Layers come and go here: with one, references to vertices die.
        tag = work.verts.layers.int.new(_TAG)
        yield work
        work.verts.layers.int.remove(tag)
        work.to_mesh(mesh)
    finally:
        work.free()
    mesh.update()


def surface_of(work: bmesh.types.BMesh) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) in the head frame, and faces (F, K) padded with -1; by way of a mesh, which is quick to read."""
    mesh = bpy.data.meshes.new("Facemime Surface")
    try:
        work.to_mesh(mesh)
        return read_vertices(mesh), read_faces(mesh)
    finally:
        bpy.data.meshes.remove(mesh)


def split_along(
    work: bmesh.types.BMesh, line: list[bmesh.types.BMVert], *, closed: bool = False
) -> list[list[bmesh.types.BMVert]]:
    """Cut along the edges between the vertices of `line`; the copies that there are of each of them then."""
    tag = work.verts.layers.int[_TAG]
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
    """Move a vertex, in every shape key."""
    vertex.co += by
    for key in work.verts.layers.shape.values():
        vertex[key] = vertex[key] + by


def copy_moved(work: bmesh.types.BMesh, vertex: bmesh.types.BMVert, by: Vector) -> bmesh.types.BMVert:
    """A new vertex beside one, in every shape key, of the same weights."""
    copy = work.verts.new(vertex.co, vertex)
    for key in work.verts.layers.shape.values():
        copy[key] = vertex[key]
    move(work, copy, by)
    return copy


def indices(vertices: Iterable[bmesh.types.BMVert]) -> IntArray:
    """The numbers of vertices, once `work.verts.index_update` has been called."""
    return np.array([vertex.index for vertex in vertices], dtype=np.intp)


def apart(landmarks: IntArray, vertices: FloatArray, firm: IntArray) -> IntArray:
    """The landmarks (66,), those that share a vertex moved to the nearest free one; those named by `firm` stay."""
    moved = landmarks.copy()
    first = firm.tolist()
    taken: set[int] = set()
    for landmark in (*first, *(i for i in range(N_LANDMARKS) if i not in first)):
        if int(moved[landmark]) in taken:
            order = np.argsort(np.linalg.norm(vertices - vertices[moved[landmark]], axis=1))
            moved[landmark] = next(v for v in order.tolist() if v not in taken)
        taken.add(int(moved[landmark]))
    return moved

"""A dark pocket behind lips that are open to the inside of the head."""

from __future__ import annotations

import bmesh
import bpy
from mathutils import Vector

from ...core.face.landmarks import outer_eye_distance
from ..meshes import mesh_of, read_landmarks, read_vertices, write_landmarks
from .binding import propose_head_regions
from .cutting import close_seams, copy_moved, edited, indices, move
from .materials import mouth_material
from .parts import current_skin, open_border

POCKET_DEPTH = 0.3
"""Depth of the pocket behind the lips, in outer-eye distances."""


def put_pocket(obj: bpy.types.Object) -> int:
    """Add a dark pocket behind the open lips of a head, and propose its regions again; return its number of edges.

    It is 0 if the lips are not open to the inside of the head.
    """
    if not len(open_border(obj)):
        return 0
    close_seams(obj, current_skin(obj))
    mesh, landmarks = mesh_of(obj), read_landmarks(obj)
    unit = outer_eye_distance(read_vertices(mesh)[landmarks])
    rim = set(open_border(obj).tolist())
    if not mesh.materials:
        mesh.materials.append(None)
    mesh.materials.append(mouth_material())
    with edited(mesh) as work:
        vertices = list(work.verts)
        bound = [vertices[vertex] for vertex in landmarks.tolist()]
        edges = [e for e in work.edges if e.is_boundary and all(vertex.index in rim for vertex in e.verts)]
        _extrude(work, edges, POCKET_DEPTH * unit, len(mesh.materials) - 1)
        work.verts.index_update()
        bound_at = indices(bound)
    write_landmarks(mesh, bound_at)
    propose_head_regions(obj)
    return len(edges)


def _extrude(work: bmesh.types.BMesh, edges: list[bmesh.types.BMEdge], depth: float, material: int) -> None:
    """Add walls that lead back from edges of a border by a depth, and a wall across their ends."""
    back_by = Vector((0.0, depth, 0.0))  # the head faces -y
    rim = list(dict.fromkeys(vertex for edge in edges for vertex in edge.verts))
    backs = {vertex: copy_moved(work, vertex, back_by) for vertex in rim}
    middle = copy_moved(work, rim[0], back_by)
    places = [vertex.co for vertex in backs.values()]
    move(work, middle, sum(places, Vector()) / len(places) - middle.co)
    for edge in edges:
        corner = edge.link_loops[0]
        start, end = corner.vert, corner.link_loop_next.vert
        for corners in ((end, start, backs[start], backs[end]), (backs[end], backs[start], middle)):
            face = work.faces.new(corners)
            face.material_index, face.smooth = material, True

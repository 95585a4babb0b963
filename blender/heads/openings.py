"""Opening of joined lips, with a dark pocket behind them, and of eyes that are joined to their lids, such as those of a
scan, so that the lids can close over them.
"""

from __future__ import annotations

from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from ...core.errors import HeadError
from ...core.face.landmarks import MOUTH_INNER_LOWER, MOUTH_INNER_UPPER, from_ibug, outer_eye_distance
from ...core.heads.eyeballs import EYES, EyeOutline, eye_outline
from ...core.heads.lids import EyeCut, coarse_edges, cut_eye, eyes_joined
from ...core.heads.slits import lip_line, lips_joined, rim_landmarks
from ...core.mesh.surface import SurfaceGraph
from ...core.numeric.arrays import FloatArray, IntArray
from ..frames import from_blender, to_blender
from ..meshes import mesh_of, object_of, read_faces, read_landmarks, read_vertices, write_landmarks
from ..names import EYES_GROUP
from .binding import propose_head_regions
from .cutting import close_seams, copy_moved, edited, indices, move, separate, split_along, surface_of
from .materials import mouth_material
from .parts import current_skin
from .pockets import POCKET_DEPTH, put_pocket

_MAX_SUBDIVISIONS = 5
_SKIRT = 0.15
"""How far the surface of an eye extends behind the lids, in eye widths; it is seen when they open wide."""


_LOWER_LIP = set(from_ibug((*range(55, 60), *range(65, 68))).tolist())
_INNER = np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])


def open_lips(obj: bpy.types.Object | None) -> int:
    """Cut the mesh of `obj` between the lips, bind the inner lips to the two rims, and propose its regions again.

    A dark pocket is added behind the cut, so that the open mouth cannot be seen through; behind lips that are open to
    the inside of the head, it is added alone. Returns the number of edges in front of it. Raises HeadError if the mesh
    has no landmarks, its lips are open and something is behind them, or no line of edges leads between them.
    """
    mesh, obj = mesh_of(obj), object_of(obj)
    landmarks, skin = read_landmarks(obj), current_skin(obj)
    if not lips_joined(SurfaceGraph(read_vertices(mesh)[skin.kept], skin.faces), skin.number[landmarks]):
        if edges := put_pocket(obj):
            return edges
        raise HeadError("The lips are already separate from each other, so the mouth can open. Nothing has to be cut.")
    close_seams(obj, skin)
    vertices, landmarks = read_vertices(mesh), read_landmarks(obj)
    graph = SurfaceGraph(vertices, read_faces(mesh))
    line = lip_line(graph, landmarks)
    unit = outer_eye_distance(vertices[landmarks])
    upper, lower, moved = _cut(mesh, line, landmarks, POCKET_DEPTH * unit)
    if not mesh.materials:
        mesh.materials.append(None)
    mesh.materials.append(mouth_material())
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


def open_eyes(obj: bpy.types.Object | None) -> int:
    """Cut the mesh of `obj` along the lids of each joined eye, and propose its regions again.

    The inside becomes an eye on a sphere just behind the lids, in the vertex group `EYES_GROUP` and in no region. It
    extends behind the lids, and walls join it to their rim, so that there is no gap. The landmarks of the lids are
    bound to the rim. Coarse meshes are subdivided around the eyes. Returns the number of eyes that were cut. Raises
    HeadError if the mesh has no landmarks, its eyes are already open, or it has holes there.
    """
    mesh, obj = mesh_of(obj), object_of(obj)
    landmarks = read_landmarks(obj)
    skin = current_skin(obj)
    joined = eyes_joined(read_vertices(mesh)[skin.kept], skin.faces, skin.number[landmarks])
    eyes = [eye for eye, one_skin in zip(EYES, joined, strict=True) if one_skin]
    if not eyes:
        raise HeadError("The lids are already separate from the eyes, so they can close. Nothing has to be cut.")
    close_seams(obj, skin)
    vertices, landmarks = read_vertices(mesh), read_landmarks(obj)
    outlines = [eye_outline(vertices, landmarks, eye) for eye in eyes]
    patches = []
    with edited(mesh) as work:
        for outline in outlines:
            _subdivide(work, outline)
        surface = surface_of(work)
        cuts = [cut_eye(*surface, outline) for outline in outlines]
        before = list(work.verts)
        bound = [before[vertex] for vertex in landmarks.tolist()]
        for eye, cut in zip(eyes, cuts, strict=True):
            lids, patch = _cut_out(work, cut, before, bound)
            for landmark, place in zip(eye.tolist(), cut.landmark_places(_places(lids)).tolist(), strict=True):
                bound[landmark] = lids[place]
            patches += patch
        work.verts.index_update()
        moved, members = indices(bound), indices(patches)
    group = obj.vertex_groups.get(EYES_GROUP) or obj.vertex_groups.new(name=EYES_GROUP)
    group.add(members.tolist(), 1.0, "REPLACE")
    vertices = read_vertices(mesh)
    vertices[members] = np.inf
    write_landmarks(mesh, separate(moved, vertices, np.concatenate(eyes)))
    propose_head_regions(obj)
    return len(eyes)


def _subdivide(work: bmesh.types.BMesh, outline: EyeOutline) -> None:
    """Halve long edges around an eye. New vertices are appended: indices stay valid, references to vertices do not."""
    for _ in range(_MAX_SUBDIVISIONS):
        long = coarse_edges(SurfaceGraph(*surface_of(work)), outline)
        if not len(long):
            break
        vertices = list(work.verts)
        edges = [work.edges.get((vertices[a], vertices[b])) for a, b in long.tolist()]
        bmesh.ops.subdivide_edges(work, edges=edges, cuts=1, use_grid_fill=True)


def _cut_out(
    work: bmesh.types.BMesh, cut: EyeCut, before: list[bmesh.types.BMVert], bound: list[bmesh.types.BMVert]
) -> tuple[list[bmesh.types.BMVert], list[bmesh.types.BMVert]]:
    """Apply a cut; return the rim of the lids and the vertices of the eye. Landmarks in `bound` stay on the lids."""
    vertices = before.copy()
    for (within, without), share in zip(cut.edges.tolist(), cut.shares.tolist(), strict=True):
        edge = work.edges.get((vertices[within], vertices[without]))
        vertices.append(bmesh.utils.edge_split(edge, vertices[within], share)[1])
    for a, b in cut.chords.tolist():
        face = next(face for face in vertices[a].link_faces if vertices[b] in face.verts)
        bmesh.utils.face_split(face, vertices[a], vertices[b])
    copies = split_along(work, [vertices[i] for i in cut.rim.tolist()], closed=True)
    if any(len(pair) != 2 for pair in copies):
        raise HeadError("The mesh has holes at the eyes. Fill them, or cut along the lids: Edge > Edge Split.")
    eye = _joined_to(vertices[int(cut.within[0])])
    lids, rim = ([next(v for v in pair if (v in eye) == within) for pair in copies] for within in (False, True))
    of_lid = {vertex: lid for pair, lid in zip(copies, lids, strict=True) for vertex in pair}
    bound[:] = [of_lid.get(vertex, vertex) for vertex in bound]
    patch = list(eye)
    _move_to(work, patch, cut.project_to_eye(_places(patch)))
    border = [copy_moved(work, vertex, Vector()) for vertex in rim]
    _move_to(work, border, cut.behind_lids(_places(lids), _SKIRT))
    _put_strip(work, rim, border)
    _put_strip(work, lids, border)
    for a, b in [*_round(lids), *_round(border)]:
        work.edges.get((a, b)).smooth = False
    return lids, patch + border


def _put_strip(work: bmesh.types.BMesh, near: list[bmesh.types.BMVert], far: list[bmesh.types.BMVert]) -> None:
    """Add faces from one closed line, a border of the mesh, to another, with the attributes of the border's faces."""
    for (a, b), (c, d) in zip(_round(near), _round(far), strict=True):
        first = work.edges.get((a, b)).link_loops[0]
        last = first.link_loop_next
        ahead = first.vert == a
        face = work.faces.new((b, a, c, d) if ahead else (a, b, d, c), first.face)
        for corner in face.loops:
            corner.copy_from(first if (corner.vert in (a, c)) == ahead else last)


def _round(line: list[bmesh.types.BMVert]) -> list[tuple[bmesh.types.BMVert, bmesh.types.BMVert]]:
    """Return the ends of the edges of a closed line."""
    return list(pairwise([*line, line[0]]))


def _joined_to(vertex: bmesh.types.BMVert) -> dict[bmesh.types.BMVert, None]:
    """Return all vertices connected to one by edges, in the order in which they were found."""
    found: dict[bmesh.types.BMVert, None] = {}
    waiting = [vertex]
    while waiting:
        if (here := waiting.pop()) not in found:
            found[here] = None
            waiting += [other for edge in here.link_edges if (other := edge.other_vert(here)) is not None]
    return found


def _places(vertices: list[bmesh.types.BMVert]) -> FloatArray:
    return from_blender(np.array([vertex.co for vertex in vertices], dtype=np.float64))


def _move_to(work: bmesh.types.BMesh, vertices: list[bmesh.types.BMVert], places: FloatArray) -> None:
    """Move vertices to (N, 3) positions in the head frame, with the same offset in every shape key."""
    for vertex, place in zip(vertices, to_blender(places).tolist(), strict=True):
        move(work, vertex, Vector(place) - vertex.co)

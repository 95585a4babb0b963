"""The left half of the head, cut out of the base mesh as triangles that keep track of their origin.

Only the left half (x >= 0) is cut and coarsened; the right half is its mirror image, so that symmetry is exact. Every
vertex is a blend of at most two vertices of hm08, so everything that is defined there (identities, face units) carries
over exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .source import BaseMesh

FACE, CAVITY, SOCKET, NECK = range(4)
"""Charts of the texture layout: outer skin, inside of the mouth, behind the lids, neck below the chin's island."""

_NECK_LEVEL, _NECK_SLOPE = -0.628, 0.32
_SOCKET_DEPTH = 0.0085


@dataclass(frozen=True)
class BlendedMesh:
    """A mesh in terms of hm08.

    Attributes
    ----------
    blend : (V, 2) int, the two vertices of hm08 that a vertex blends
    share : (V,) share of the second one
    """

    blend: NDArray[np.int64]
    share: NDArray[np.float64]

    def positions(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Blend (N, 3) `points` of hm08 to (V, 3)."""
        share = self.share[:, None]
        return (1.0 - share) * points[self.blend[:, 0]] + share * points[self.blend[:, 1]]


@dataclass(frozen=True)
class HalfMesh(BlendedMesh):
    """Triangles of the left half.

    Attributes
    ----------
    triangles : (T, 3) int
    tokens : (T, 3) int, a number for each corner's place in the texture
    token_chart, token_uv : (K,), (K, 2), chart and native coordinates of each token; NaN for the neck's
    quad : (T,) number of the quad that a triangle came from
    """

    triangles: NDArray[np.int64]
    tokens: NDArray[np.int64]
    token_chart: NDArray[np.int64]
    token_uv: NDArray[np.float64]
    quad: NDArray[np.int64]


def cut_half(base: BaseMesh, points: NDArray[np.float64]) -> HalfMesh:
    """The left half of the head, from the crown to a slanted plane through the neck; `points` are in the head frame."""
    chart = face_charts(base, points)
    faces = np.flatnonzero(chart >= 0)
    below = _below_cut(points)
    keep = ~below[base.faces[faces]].all(axis=1) & (points[base.faces[faces], 0].min(axis=1) > -1e-7)
    faces = faces[keep & ~_deep_socket(base, points, faces, chart)]
    builder = _Builder(base, points)
    for face in faces:
        builder.add(face, chart[face], below)
    return builder.finish()


def _below_cut(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return _height_over_cut(points) < 0.0


def _height_over_cut(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height over the neck's cut, which rises towards the nape; similar to a signed distance."""
    return _NECK_LEVEL - points[:, 1] - _NECK_SLOPE * (points[:, 2] + 0.08)


def face_charts(base: BaseMesh, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Chart of every face of the head, (F,), -1 elsewhere: islands of the native texture layout."""
    island = _uv_islands(base)
    faces = np.flatnonzero(base.groups == "body")
    chart = np.full(len(base.faces), -1)
    skin_seed, lip_seed, eye_seed = 164, 588, 7788
    seeds = {FACE: skin_seed, CAVITY: lip_seed, SOCKET: eye_seed}
    for kind, seed in seeds.items():
        touching = faces[(base.faces[faces] == seed).any(axis=1)]
        numbers = {int(n) for n in island[base.face_uv[touching, 0]]}
        if kind != FACE:
            numbers -= {int(island[base.face_uv[f, 0]]) for f in faces[chart[faces] == FACE]}
        chart[faces[np.isin(island[base.face_uv[faces, 0]], list(numbers))]] = kind
    centre = points[base.faces].mean(axis=1)
    neck = (chart < 0) & (base.groups == "body") & (np.abs(centre[:, 0]) < 0.11)
    chart[neck & ~_below_cut(points)[base.faces].all(axis=1)] = NECK
    return chart


def _uv_islands(base: BaseMesh) -> NDArray[np.int64]:
    """Number of the connected island of each texture coordinate, (T,), by repeated minimum over faces."""
    island = np.arange(len(base.uv))
    while True:
        lowest = island[base.face_uv].min(axis=1)
        new = island.copy()
        np.minimum.at(new, base.face_uv.ravel(), np.repeat(lowest, base.face_uv.shape[1]))
        new = new[new]
        if (new == island).all():
            return island
        island = new


def _deep_socket(
    base: BaseMesh, points: NDArray[np.float64], faces: NDArray[np.int64], chart: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Faces behind the lids, which the eyeball hides."""
    socket = chart[faces] == SOCKET
    front = points[base.faces[faces[socket]], 2].min()
    return socket & (points[base.faces[faces], 2].max(axis=1) > front + _SOCKET_DEPTH)


class _Builder:
    """Collects triangles of whole and of sliced quads."""

    def __init__(self, base: BaseMesh, points: NDArray[np.float64]) -> None:
        self.base, self.points = base, points
        self.height = _height_over_cut(points)
        self.vertex: dict[tuple[int, int], int] = {}
        self.share: list[float] = []
        self.token: dict[tuple[int, int], int] = {}
        self.token_uv: list[tuple[float, float]] = []
        self.triangles: list[tuple[int, int, int]] = []
        self.tokens: list[tuple[int, int, int]] = []
        self.quad: list[int] = []

    def add(self, face: int, chart: int, below: NDArray[np.bool_]) -> None:
        corners = self.base.faces[face]
        if below[corners].any():
            corner_vertices, uv = self._slice(corners, below), None
            chart = NECK
        else:
            corner_vertices = [self._vertex(int(c), int(c), 0.0) for c in corners]
            uv = self.base.uv[self.base.face_uv[face]] if chart != NECK else None
        keys = self.base.face_uv[face] if uv is not None else corner_vertices
        tokens = [self._token(chart, int(k), None if uv is None else uv[i]) for i, k in enumerate(keys)]
        order = self._fan(corner_vertices)
        for a, b, c in order:
            self.triangles.append((corner_vertices[a], corner_vertices[b], corner_vertices[c]))
            self.tokens.append((tokens[a], tokens[b], tokens[c]))
            self.quad.append(face if len(corner_vertices) == 4 else -1 - len(self.quad))

    def finish(self) -> HalfMesh:
        return HalfMesh(
            blend=np.array(list(self.vertex)),
            share=np.array(self.share),
            triangles=np.array(self.triangles),
            tokens=np.array(self.tokens),
            token_chart=np.array([chart for chart, _ in self.token]),
            token_uv=np.array(self.token_uv),
            quad=np.array(self.quad),
        )

    def _vertex(self, a: int, b: int, share: float) -> int:
        key = (a, b)
        if key not in self.vertex:
            self.vertex[key] = len(self.vertex)
            self.share.append(share)
        return self.vertex[key]

    def _token(self, chart: int, key: int, uv: NDArray[np.float64] | None) -> int:
        if (chart, key) not in self.token:
            self.token[chart, key] = len(self.token)
            self.token_uv.append((np.nan, np.nan) if uv is None else (float(uv[0]), float(uv[1])))
        return self.token[chart, key]

    def _slice(self, corners: NDArray[np.int64], below: NDArray[np.bool_]) -> list[int]:
        """Return the part of a quad above the cut, whose new corners blend the ends of the crossing edges."""
        polygon = []
        for here, there in zip(corners, np.roll(corners, -1), strict=True):
            if not below[here]:
                polygon.append(self._vertex(int(here), int(here), 0.0))
            if below[here] != below[there]:
                low, high = sorted((int(here), int(there)))
                share = self.height[low] / (self.height[low] - self.height[high])
                polygon.append(self._vertex(low, high, share))
        return polygon

    def _fan(self, corners: list[int]) -> list[tuple[int, int, int]]:
        """Return the triangles of a polygon; a quad is split along its shorter diagonal."""
        if len(corners) == 4:
            keys = list(self.vertex)
            p = [self.points[keys[c][0]] for c in corners]
            if np.linalg.norm(p[1] - p[3]) < np.linalg.norm(p[0] - p[2]):
                return [(0, 1, 3), (1, 2, 3)]
        return [(0, i, i + 1) for i in range(1, len(corners) - 1)]

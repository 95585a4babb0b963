"""The skin: the half head coarsened where it matters least, with its quads restored, and mirrored to the whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import anatomy
from .coarsen import coarsen
from .cut import CAVITY, FACE, NECK, SOCKET, BlendedMesh, HalfMesh, cut_half
from .occlusion import vertex_normals
from .refine import refine, swell
from .source import BaseMesh

N_VERTICES = 1781

_CROWN_SPACING = 0.0105
"""Desired distance between vertices under the hair in metres, whose outline would otherwise be a polygon."""

_FLAT, _SQUARE = 0.9, 0.35
_MIDDLE, _EAR, _EAR_SIZE = 0.4842, (0.848, 0.1416), (0.026, 0.020)
"""In the native texture layout: the face's midline, and middle and half size of an ear beside it."""


@dataclass(frozen=True)
class Surface(BlendedMesh):
    """The whole skin mesh in terms of hm08.

    Attributes
    ----------
    faces : (F, 4) int, -1 pads triangles
    tokens : (F, 4) int, rows of `token_chart` and `token_uv`
    mirrored : (F,) bool, whether a face is of the right half, whose texture place is the mirror image of its token's
    mirror : (V,) int, the vertex on the other side
    """

    faces: NDArray[np.int64]
    tokens: NDArray[np.int64]
    token_chart: NDArray[np.int64]
    token_uv: NDArray[np.float64]
    mirrored: NDArray[np.bool_]
    mirror: NDArray[np.int64]

    def vertex_of(self, native: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the vertices of the skin that are the vertices `native` of hm08; each of them must have been kept."""
        whole = self.blend[:, 0] == self.blend[:, 1]
        number = {int(v): i for i, v in enumerate(self.blend[:, 0]) if whole[i]}
        return np.array([number[int(v)] for v in native])


def ear_share(surface: Surface) -> NDArray[np.float64]:
    """1 on the ears, fading to 0 around them, (V,), by the native texture layout, where an ear is a disc."""
    is_face = (surface.token_chart[surface.tokens] == FACE) & (surface.faces >= 0)
    native = surface.token_uv[surface.tokens[is_face]]
    across = np.abs(native[:, 1] - _MIDDLE)
    distance = np.hypot((native[:, 0] - _EAR[0]) / _EAR_SIZE[0], (across - _EAR[1]) / _EAR_SIZE[1])
    share = np.zeros(len(surface.share))
    np.maximum.at(share, surface.faces[is_face], np.clip(2.6 - 1.6 * distance, 0.0, 1.0))
    return share


def build_surface(base: BaseMesh, points: NDArray[np.float64], scalp: NDArray[np.bool_]) -> Surface:
    """The skin of the head whose base mesh has the vertices `points`, (N, 3) in the head frame.

    `scalp` (N,) says where hair grows.
    """
    half = cut_half(base, points)
    half = refine(half, scalp[half.blend[:, 0]])
    positions = half.positions(points) + swell(half, points, vertex_normals(points, base.faces))
    positions[np.abs(positions[:, 0]) < 1e-7, 0] = 0.0
    spacing, locked = _wishes(half, positions, points)
    spacing[scalp[half.blend].all(axis=1)] = _CROWN_SPACING
    coarse = coarsen(half, positions, spacing, locked, N_VERTICES)
    return _mirror(base, coarse, coarse.positions(points))


def _wishes(
    half: HalfMesh, positions: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Desired edge length at each vertex, (V,), in metres, and the vertices to keep, (V,)."""
    lids = _distance(positions, points[[*anatomy.UPPER_LID_EDGE, *anatomy.LOWER_LID_EDGE]])
    lips = _distance(
        positions,
        points[[*anatomy.UPPER_LIP_BORDER, *anatomy.LOWER_LIP_BORDER, *anatomy.UPPER_LIP_LINE]],
    )
    brow = _distance(positions, points[[anatomy.LEFT_LANDMARKS[i] for i in range(22, 27)]])
    nose = _distance(positions, points[[anatomy.LEFT_LANDMARKS[i] for i in (29, 30, 33, 34, 35)]])
    mouth_line = _distance(positions, points[[*anatomy.UPPER_LIP_LINE, *anatomy.LOWER_LIP_LINE]])
    away = np.maximum(positions[:, 2] + 0.115, 0.0) + np.maximum(-0.82 - positions[:, 1], 0.0)
    spacing = np.minimum.reduce(
        [
            0.0010 + 0.19 * lids,
            0.0015 + 0.22 * lips,
            0.0045 + 0.25 * brow,
            0.0022 + 0.20 * nose,
            np.minimum(0.0080 + 0.11 * away, 0.0140),
        ]
    )
    ear = (positions[:, 0] > 0.066) & (np.abs(positions[:, 2] + 0.05) < 0.03) & (np.abs(positions[:, 1] + 0.755) < 0.04)
    spacing[ear] = 0.0060
    chart = _vertex_chart(half)
    inside = chart == CAVITY
    spacing[inside] = np.minimum(0.0020 + 0.9 * mouth_line[inside], 0.020)
    spacing[chart == SOCKET] = 0.0045
    spacing[chart == NECK] = 0.020
    kept = [*anatomy.LEFT_LANDMARKS.values(), *anatomy.UPPER_LID_EDGE, *anatomy.LOWER_LID_EDGE]
    kept += [*anatomy.UPPER_LIP_INSIDE, *anatomy.LOWER_LIP_INSIDE]
    kept += [*anatomy.UPPER_LIP_BORDER, *anatomy.LOWER_LIP_BORDER, *anatomy.UPPER_LIP_LINE, *anatomy.LOWER_LIP_LINE]
    locked = np.isin(half.blend[:, 0], kept) & (half.share == 0.0)
    return spacing, locked


def _vertex_chart(half: HalfMesh) -> NDArray[np.int64]:
    chart = np.full(len(half.share), FACE)
    for kind in (NECK, SOCKET, CAVITY):
        inside = half.token_chart[half.tokens] == kind
        chart[np.setdiff1d(half.triangles[inside], half.triangles[~inside])] = kind
    return chart


def _distance(points: NDArray[np.float64], to: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(points[:, None] - to[None], axis=2).min(axis=1))


def _mirror(base: BaseMesh, half: HalfMesh, positions: NDArray[np.float64]) -> Surface:
    faces, tokens = _pair_triangles(half, positions)
    midline = np.abs(positions[:, 0]) < 1e-7
    n = len(positions)
    other = np.arange(n)
    other[~midline] = n + np.arange((~midline).sum())
    quads = faces[:, 3:] >= 0

    def flip(rows: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(quads, rows[:, ::-1], rows[:, [2, 1, 0, 3]])

    flipped, flipped_tokens = flip(np.where(faces < 0, -1, other[faces])), flip(tokens)
    mirror = np.concatenate([other, np.flatnonzero(~midline)])
    return Surface(
        blend=np.concatenate([half.blend, base.mirror[half.blend[~midline]]]),
        share=np.concatenate([half.share, half.share[~midline]]),
        faces=np.concatenate([faces, flipped]),
        tokens=np.concatenate([tokens, flipped_tokens]),
        token_chart=half.token_chart,
        token_uv=half.token_uv,
        mirrored=np.arange(2 * len(faces)) >= len(faces),
        mirror=mirror,
    )


def _pair_triangles(half: HalfMesh, positions: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Join triangles to quads, (F, 4): first those that were one quad of hm08, then the flattest, squarest pairs."""
    edge: dict[tuple[int, int], list[int]] = {}
    for t, triangle in enumerate(half.triangles):
        for a, b in zip(triangle, np.roll(triangle, -1), strict=True):
            edge.setdefault((min(a, b), max(a, b)), []).append(t)
    candidates = []
    for key in sorted(edge):
        if len(edge[key]) != 2:
            continue
        quad = _joined(half, *edge[key], key)
        if quad is not None:
            native = half.quad[edge[key][0]] >= 0 and half.quad[edge[key][0]] == half.quad[edge[key][1]]
            score = _quad_score(positions[quad[0]])
            if native or score > 0.0:
                candidates.append((-2.0 if native else -score, *edge[key], quad))
    taken: set[int] = set()
    faces, tokens = [], []
    for _, s, t, (corners, places) in sorted(candidates, key=lambda c: c[:3]):
        if s not in taken and t not in taken:
            taken |= {s, t}
            faces.append(corners)
            tokens.append(places)
    for t in range(len(half.triangles)):
        if t not in taken:
            faces.append([*half.triangles[t], -1])
            tokens.append([*half.tokens[t], -1])
    return np.array(faces), np.array(tokens)


def _joined(half: HalfMesh, s: int, t: int, key: tuple[int, int]) -> tuple[list[int], list[int]] | None:
    """Corners and tokens of the quad of two triangles; None across a seam of the texture."""
    first, second = half.triangles[s].tolist(), half.triangles[t].tolist()
    ft = dict(zip(first, half.tokens[s].tolist(), strict=True))
    st = dict(zip(second, half.tokens[t].tolist(), strict=True))
    if any(ft[v] != st[v] for v in key):
        return None
    start = next(i for i in range(3) if first[i] not in key)
    a, b, c = first[start], first[(start + 1) % 3], first[(start + 2) % 3]
    d = next(v for v in second if v not in key)
    return [a, b, d, c], [ft[a], ft[b], st[d], ft[c]]


def _quad_score(p: NDArray[np.float64]) -> float:
    """Above 0 for a nearly flat, convex quad of nearly right angles; 1 is a square."""
    edges = np.roll(p, -1, axis=0) - p
    edges /= np.linalg.norm(edges, axis=1, keepdims=True) + 1e-12
    normals = np.cross(np.roll(edges, 1, axis=0), edges)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    flat = float((normals @ normals.T).min())
    slant = float(np.abs((edges * np.roll(edges, 1, axis=0)).sum(axis=1)).max())
    if flat < _FLAT or slant > 1.0 - _SQUARE:
        return 0.0
    return flat * (1.0 - slant)

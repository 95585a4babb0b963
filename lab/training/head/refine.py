"""Halving of long edges of the crown, where hm08 is so coarse that the outline of the head is a polygon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .cut import FACE, BlendedMesh, HalfMesh

_HALF = 0.5


def refine(half: HalfMesh, chosen: NDArray[np.bool_]) -> HalfMesh:
    """Split the edges between `chosen` vertices of hm08, (V,), that belong to the outer skin.

    A new vertex blends both ends of its edge in equal parts.
    """
    return _Splitter(half, chosen).split()


class _Splitter:
    def __init__(self, half: HalfMesh, chosen: NDArray[np.bool_]) -> None:
        self.half = half
        self.chosen = chosen & (half.share == 0.0)
        self.blend = half.blend.tolist()
        self.share = half.share.tolist()
        self.places = half.token_uv.tolist()
        self.charts = half.token_chart.tolist()
        self.middle: dict[tuple[int, int], int] = {}
        self.place: dict[tuple[int, int], int] = {}
        self.triangles: list[tuple[int, int, int]] = []
        self.tokens: list[tuple[int, int, int]] = []
        self.quad: list[int] = []

    def split(self) -> HalfMesh:
        half = self.half
        skin = (half.token_chart[half.tokens] == FACE).all(axis=1)
        for triangle, tokens, quad, outer in zip(half.triangles, half.tokens, half.quad, skin, strict=True):
            self._add(triangle.tolist(), tokens.tolist(), int(quad), outer=bool(outer))
        return replace(
            half,
            blend=np.array(self.blend),
            share=np.array(self.share),
            triangles=np.array(self.triangles),
            tokens=np.array(self.tokens),
            token_chart=np.array(self.charts),
            token_uv=np.array(self.places),
            quad=np.array(self.quad),
        )

    def _add(self, corners: list[int], tokens: list[int], quad: int, *, outer: bool) -> None:
        """Keep a triangle, or replace it by those between its corners and the middles of its edges."""
        splits = [outer and bool(self.chosen[[corners[i], corners[i - 2]]].all()) for i in range(3)]
        if not any(splits):
            self._keep(corners, tokens, quad)
            return
        polygon, places = [], []
        for i, (here, there) in enumerate(zip(corners, corners[1:] + corners[:1], strict=True)):
            polygon.append(here)
            places.append(tokens[i])
            if splits[i]:
                polygon.append(self._middle(here, there))
                places.append(self._place(tokens[i], tokens[i - 2]))
        for order in _TRIANGLES[tuple(splits)]:
            self._keep([polygon[k] for k in order], [places[k] for k in order], -1 - len(self.quad))

    def _keep(self, corners: list[int], tokens: list[int], quad: int) -> None:
        self.triangles.append((corners[0], corners[1], corners[2]))
        self.tokens.append((tokens[0], tokens[1], tokens[2]))
        self.quad.append(quad)

    def _middle(self, a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in self.middle:
            self.middle[key] = len(self.blend)
            self.blend.append([self.blend[key[0]][0], self.blend[key[1]][0]])
            self.share.append(_HALF)
        return self.middle[key]

    def _place(self, a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in self.place:
            self.place[key] = len(self.places)
            self.places.append([(u + v) / 2.0 for u, v in zip(self.places[a], self.places[b], strict=True)])
            self.charts.append(self.charts[a])
        return self.place[key]


_TRIANGLES: dict[tuple[bool, ...], tuple[tuple[int, int, int], ...]] = {
    (True, True, True): ((0, 1, 5), (1, 2, 3), (5, 3, 4), (1, 3, 5)),
    (True, True, False): ((0, 1, 4), (1, 2, 3), (1, 3, 4)),
    (False, True, True): ((0, 1, 2), (0, 2, 4), (2, 3, 4)),
    (True, False, True): ((0, 1, 4), (1, 2, 4), (2, 3, 4)),
    (True, False, False): ((0, 1, 3), (1, 2, 3)),
    (False, True, False): ((0, 1, 2), (0, 2, 3)),
    (False, False, True): ((0, 1, 3), (1, 2, 3)),
}
"""Triangles of the polygon of a triangle's corners and the middles of its edges, by the edges that are split: the first
one is that from the first corner to the second."""


def swell(mesh: BlendedMesh, points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) by which the middles of edges rise to the curved surface that the normals at the ends stand on.

    The middle is projected onto the planes through both ends; half of the mean way is the height of the arc, if it is
    that of a circle (after Boubekeur and Alexa, Phong Tessellation, 2008). `points` and `normals`, (N, 3), are of hm08.
    """
    rise = np.zeros((len(mesh.share), 3))
    split = (mesh.share == _HALF) & (mesh.blend[:, 0] != mesh.blend[:, 1])
    middle = mesh.positions(points)[split]
    for end in mesh.blend[split].T:
        away = ((points[end] - middle) * normals[end]).sum(axis=1, keepdims=True)
        rise[split] += 0.25 * away * normals[end]
    return rise

"""Coarsening of the half head to an exact number of vertices, dense where expressions need it.

Edges are collapsed onto one of their ends, the cheapest first. The cost of an edge is its length, relative to the
desired length at that place, times the bending of the surface there. Kept vertices are therefore vertices of the base
mesh, and lids, lips and landmarks, which are locked, keep their native quads. Quadric error alone would spend the
vertices on ears and nostrils, and leave long thin triangles on cheeks that must move smoothly.
"""

from __future__ import annotations

import heapq
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .cut import HalfMesh

_FLIP = 0.35
_BEND = 4.0
_THIN = 0.22


def coarsen(
    mesh: HalfMesh,
    positions: NDArray[np.float64],
    spacing: NDArray[np.float64],
    locked: NDArray[np.bool_],
    total: int,
) -> HalfMesh:
    """Collapse edges of the half `mesh` until it and its mirror image, joined at x = 0, have `total` vertices.

    `positions` (V, 3) metres; `spacing` (V,) is the edge length wanted at a vertex; `locked` (V,) are kept.
    """
    work = _Collapser(mesh, positions, spacing, locked)
    midline = np.abs(positions[:, 0]) < 1e-9
    count = 2 * len(positions) - int(midline.sum())
    while count > total:
        gone = work.collapse_cheapest(only_midline=count == total + 1)
        count -= 1 if midline[gone] else 2
    return work.finish(mesh)


class _Collapser:
    def __init__(
        self,
        mesh: HalfMesh,
        positions: NDArray[np.float64],
        spacing: NDArray[np.float64],
        locked: NDArray[np.bool_],
    ) -> None:
        self.p, self.spacing, self.locked = positions, spacing, locked
        self.midline = np.abs(positions[:, 0]) < 1e-9
        self.tri = {i: list(map(int, t)) for i, t in enumerate(mesh.triangles)}
        self.tok = {i: list(map(int, t)) for i, t in enumerate(mesh.tokens)}
        self.fan: list[set[int]] = [set() for _ in positions]
        for i, triangle in self.tri.items():
            for v in triangle:
                self.fan[v].add(i)
        self.touched: set[int] = set()
        self.stamp = [0] * len(positions)
        self.heap: list[tuple[float, int, int, int, int]] = []
        for v in range(len(positions)):
            self._offer(v)

    def collapse_cheapest(self, *, only_midline: bool) -> int:
        """Remove one vertex and return it."""
        aside = []
        while self.heap:
            entry = heapq.heappop(self.heap)
            _, gone, kept, stamp_gone, stamp_kept = entry
            if stamp_gone != self.stamp[gone] or stamp_kept != self.stamp[kept]:
                continue
            if only_midline and not self.midline[gone]:
                aside.append(entry)
                continue
            if (renamed := self._allowed(gone, kept)) is not None:
                self._collapse(gone, kept, renamed)
                for item in aside:
                    heapq.heappush(self.heap, item)
                return gone
        raise RuntimeError("no edge can be collapsed any more; lock fewer vertices")

    def finish(self, mesh: HalfMesh) -> HalfMesh:
        alive = sorted({v for triangle in self.tri.values() for v in triangle})
        number = {v: i for i, v in enumerate(alive)}
        order = sorted(self.tri)
        quad = np.array([-1 - i if i in self.touched else mesh.quad[i] for i in order])
        return replace(
            mesh,
            blend=mesh.blend[alive],
            share=mesh.share[alive],
            triangles=np.array([[number[v] for v in self.tri[i]] for i in order]),
            tokens=np.array([self.tok[i] for i in order]),
            quad=quad,
        )

    def _neighbours(self, v: int) -> set[int]:
        return {w for t in self.fan[v] for w in self.tri[t]} - {v}

    def _offer(self, gone: int) -> None:
        """Add every collapse of `gone` onto a neighbour to the heap."""
        if not self.locked[gone]:
            bend = self._bend(gone)
            for kept in sorted(self._neighbours(gone)):
                self._offer_edge(gone, kept, bend)

    def _offer_edge(self, gone: int, kept: int, bend: float) -> None:
        wanted = min(self.spacing[gone], self.spacing[kept])
        length = float(np.linalg.norm(self.p[gone] - self.p[kept])) / wanted
        cost = length * length * (1.0 + _BEND * bend)
        heapq.heappush(self.heap, (cost, gone, kept, self.stamp[gone], self.stamp[kept]))

    def _bend(self, v: int) -> float:
        """0 for a flat fan; near or above 1 for a sharp one."""
        normals = np.array([self._normal(self.tri[t]) for t in sorted(self.fan[v])])
        mean = normals.sum(axis=0)
        mean /= np.linalg.norm(mean) + 1e-12
        return float(1.0 - (normals @ mean).min())

    def _normal(self, triangle: list[int]) -> NDArray[np.float64]:
        a, b, c = self.p[triangle]
        normal = np.cross(b - a, c - a)
        return np.asarray(normal / (np.linalg.norm(normal) + 1e-15))

    def _border(self, v: int) -> set[int]:
        """Neighbours of `v` along the border of the half mesh."""
        counts: dict[int, int] = {}
        for t in self.fan[v]:
            for w in self.tri[t]:
                if w != v:
                    counts[w] = counts.get(w, 0) + 1
        return {w for w, n in counts.items() if n == 1}

    def _allowed(self, gone: int, kept: int) -> dict[int, int] | None:
        """Return the texture tokens of `gone` and their replacements if the collapse is valid, else None."""
        border = self._border(gone)
        if border and (kept not in border or len({bool(self.midline[w]) for w in border}) > 1):
            return None
        if self.midline[gone] and not self.midline[kept]:
            return None
        around = self._neighbours(gone)
        shared = self.fan[gone] & self.fan[kept]
        if len(around & self._neighbours(kept)) != len(shared):
            return None
        if self.midline[kept] and not self.midline[gone]:
            chords = {w for w in around if self.midline[w]} - {kept}
            if chords - self._border(kept):
                return None
        renamed: dict[int, int] = {}
        for t in shared:
            tok = dict(zip(self.tri[t], self.tok[t], strict=True))
            if renamed.setdefault(tok[gone], tok[kept]) != tok[kept]:
                return None
        moved = self.fan[gone] - shared
        if any(self.tok[t][self.tri[t].index(gone)] not in renamed for t in moved):
            return None
        return renamed if all(self._sound(t, gone, kept) for t in moved) else None

    def _sound(self, t: int, gone: int, kept: int) -> bool:
        """Whether triangle `t` neither flips nor becomes a sliver."""
        after = [kept if v == gone else v for v in self.tri[t]]
        if float(self._normal(self.tri[t]) @ self._normal(after)) < _FLIP:
            return False
        return _quality(self.p[after]) > min(_THIN, 0.8 * _quality(self.p[self.tri[t]]))

    def _collapse(self, gone: int, kept: int, renamed: dict[int, int]) -> None:
        for t in self.fan[gone] & self.fan[kept]:
            for v in self.tri.pop(t):
                self.fan[v].discard(t)
            del self.tok[t]
        for t in self.fan[gone]:
            corner = self.tri[t].index(gone)
            self.tri[t][corner] = kept
            self.tok[t][corner] = renamed[self.tok[t][corner]]
            self.fan[kept].add(t)
            self.touched.add(t)
        self.fan[gone] = set()
        self.stamp[gone] += 1
        for v in sorted({kept} | self._neighbours(kept)):
            self.stamp[v] += 1
        for v in sorted({kept} | self._neighbours(kept)):
            self._offer(v)
            for w in sorted(self._neighbours(v) - self._neighbours(kept) - {kept}):
                if not self.locked[w]:
                    self._offer_edge(w, v, self._bend(w))


def _quality(corners: NDArray[np.float64]) -> float:
    """1 for an equilateral triangle, 0 for a line."""
    edges = corners - np.roll(corners, -1, axis=0)
    area = np.linalg.norm(np.cross(edges[0], edges[1])) / 2.0
    return float(4.0 * np.sqrt(3.0) * area / ((edges**2).sum() + 1e-15))

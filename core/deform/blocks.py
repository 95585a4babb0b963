"""The product of a frame, `rest + A d`, with an `A` whose rows are much alike where vertices are near each other.

What a frame costs is the reading of `A`: on a head of 100,000 vertices it exceeds the processor's caches. But within a
small piece of the face all control points together move the vertices in few ways only, as the fields are smooth. So
vertices of the same regions are put side by side in pieces, halved across their widest side, and each piece keeps the
strongest singular vectors of its rows: `A ~ U (W d)`, with a bound on what is left out. A sparse matrix would
be slower: its rows are short.

The blocks lie as (rank, vertices): their transpose times four columns (three coordinates and one of zeros, which the
matrix product's inner loop likes better than three) writes the coordinates of a vertex side by side, which are then put
back into the mesh's order. On a small mesh the sorting would cost more than it saves, and one block as it is is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

TOLERANCE = 5e-4
"""How far a vertex may be off, over the root of the sum of the control points' squared displacements."""
_PIECE = 2_048
"""Vertices of a piece at most: smaller ones have a lower rank but cost more calls."""
_SMALL = 4_096
_CHUNK = 30_000
"""Vertices put back at a time: they stay in the processor's second cache."""


@dataclass(frozen=True)
class RegionMatrix:
    """One region's matrix: `rows` (Vr,) vertices, `columns` (Pr,) control points, `matrix` (Vr, Pr)."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    matrix: NDArray[np.float32]


class BlockProduct:
    """`rest + A d` for many `d`, prepared once.

    Parameters
    ----------
    rest : (V, 3) float32
    regions : sequence of RegionMatrix
        They may share vertices, which take the sum.
    n_columns : int
        Control points in all.

    Attributes
    ----------
    nbytes : int
        Memory that the blocks take.

    Notes
    -----
    No vertex is further than `TOLERANCE |d|` from the exact product, `|d|` being the root of the sum of squares of all
    displacements; up to 4,096 vertices the product is exact.
    """

    def __init__(self, rest: NDArray[np.float32], regions: list[RegionMatrix], n_columns: int) -> None:
        count = len(rest)
        rows_of = _RowsOf(regions, count, n_columns)
        self._place: NDArray[np.intp] | None = None
        if count <= _SMALL:
            order = np.arange(count)
            pieces = [order]
            factors = [(rows_of(order), np.eye(n_columns, dtype=np.float32))]
        else:
            pieces = [piece for vertices in rows_of.classes() for piece in _pieces(rest, vertices)]
            still = np.ones(count, dtype=np.bool_)
            still[np.concatenate(pieces)] = False
            order = np.concatenate([*pieces, np.flatnonzero(still)])
            self._place = np.argsort(order)
            factors = [_factors(rows_of(piece)) for piece in pieces]
        widths = [len(modes) + 3 for _, modes in factors]
        self._inputs = np.zeros((4, n_columns + 3), dtype=np.float32)
        self._inputs[:3, n_columns:] = np.eye(3)
        self._modes = np.zeros((n_columns + 3, sum(widths)), dtype=np.float32)
        self._amounts = np.zeros((4, sum(widths)), dtype=np.float32)
        self._moved = np.zeros((1, count, 4), dtype=np.float32)
        self._moved[0, :, :3] = rest[order]
        self._sorted = np.empty((1, min(_CHUNK, count), 4), dtype=np.float32)
        self._products: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]] = []
        # One array for all blocks: numpy asks for huge pages where an array is large, and a frame walks through it all.
        store = np.empty(sum(w * len(p) for w, p in zip(widths, pieces, strict=True)), dtype=np.float32)
        row = column = used = 0
        for piece, width, (left, modes) in zip(pieces, widths, factors, strict=True):
            self._modes[:n_columns, column : column + width - 3] = modes.T
            self._modes[n_columns:, column + width - 3 : column + width] = np.eye(3)
            block = store[used : used + width * len(piece)].reshape(width, len(piece))
            block[:-3], block[-3:] = left.T, rest[piece].T
            self._products.append(
                (block.T, self._amounts[:, column : column + width].T, self._moved[0, row : row + len(piece)])
            )
            row, column, used = row + len(piece), column + width, used + block.size
        self.nbytes = store.nbytes + self._modes.nbytes

    def apply(self, displacements: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Write `rest + A displacements` for (P, 3) float32 displacements into (V, 3) float32 contiguous `out`."""
        self._inputs[:3, :-3] = displacements.T
        np.matmul(self._inputs, self._modes, out=self._amounts)
        for block, amounts, moved in self._products:
            np.matmul(block, amounts, out=moved)
        result = out.reshape(1, -1, 3)
        if self._place is None:
            cv2.cvtColor(self._moved, cv2.COLOR_BGRA2BGR, result)
            return
        for start in range(0, len(self._place), _CHUNK):
            place = self._place[start : start + _CHUNK]
            part = self._sorted[:, : len(place)]
            self._moved[0].take(place, axis=0, out=part[0], mode="clip")
            cv2.cvtColor(part, cv2.COLOR_BGRA2BGR, result[:, start : start + _CHUNK])


class _RowsOf:
    """Rows of the sum of the regions' matrices, (len(vertices), n_columns)."""

    def __init__(self, regions: list[RegionMatrix], count: int, n_columns: int) -> None:
        self._n_columns = n_columns
        self._regions = regions
        self._places = np.full((len(regions), count), -1, dtype=np.int32)
        for region, place in zip(regions, self._places, strict=True):
            place[region.rows] = np.arange(len(region.rows))

    def __call__(self, vertices: NDArray[np.intp]) -> NDArray[np.float32]:
        rows = np.zeros((len(vertices), self._n_columns), dtype=np.float32)
        for region, place in zip(self._regions, self._places[:, vertices], strict=True):
            here = np.flatnonzero(place >= 0)
            rows[here[:, None], region.columns] += region.matrix[place[here]]
        return rows

    def classes(self) -> list[NDArray[np.intp]]:
        """Vertices that hang on the same regions, which lie along slits; those of small classes together."""
        bits = np.left_shift(1, np.arange(len(self._regions)))
        key = bits @ (self._places >= 0)
        keys, counts = np.unique(key[key > 0], return_counts=True)
        large = keys[counts >= _PIECE]
        rest = np.flatnonzero((key > 0) & ~np.isin(key, large))
        return [group for group in [*(np.flatnonzero(key == k) for k in large), rest] if len(group)]


def _pieces(places: NDArray[np.float32], vertices: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """`vertices` in pieces that are near each other in (V, 3) `places`: halved across the widest side."""
    if len(vertices) <= _PIECE:
        return [np.sort(vertices)]
    there = places[vertices]
    order = np.argpartition(there[:, np.ptp(there, axis=0).argmax()], len(vertices) // 2)
    halves = np.array_split(vertices[order], 2)
    return [piece for half in halves for piece in _pieces(places, half)]


def _factors(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`left` (N, K) and orthonormal `modes` (K, P): `left modes` differs in no row by more than the tolerance."""
    exact = rows.astype(np.float64)
    _, vectors = np.linalg.eigh(exact.T @ exact)
    modes = vectors[:, ::-1].T.astype(np.float32)
    left = rows @ modes.T
    beyond = np.sqrt(np.cumsum(np.square(left[:, ::-1]), axis=1)[:, ::-1].max(axis=0))
    rank = int((beyond > TOLERANCE).sum())
    return left[:, :rank], modes[:rank]

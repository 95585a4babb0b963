"""The product of a frame, `rest + A d`, with an `A` that is dense within regions and empty between them.

A sparse matrix would be four times slower: its rows are short and its columns are always the same few. So vertices
that hang on the same control points are put side by side, and each such class is one dense block. The blocks lie as
(P, V): their transpose times four columns of displacements (three and one of zeros, which the matrix product's inner
loop likes better than three) writes the coordinates of a vertex side by side, which are then put back into the mesh's
order. On a small mesh the sorting would cost more than it saves, and one block over all vertices is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_CALL = 25_000
"""What one more product costs, in multiply-adds of a coordinate: below that, classes are merged."""
_SORTING = 40_000
"""What putting sorted vertices back costs on top of 4 a vertex, in the same unit."""
_CHUNK = 30_000
"""Vertices put back at a time: they stay in the processor's second cache."""
_PRODUCT = 900_000
"""Multiply-adds of a product, four coordinates together: above a million OpenBLAS copies the block first."""


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
    """

    def __init__(self, rest: NDArray[np.float32], regions: list[RegionMatrix], n_columns: int) -> None:
        count = len(rest)
        classes = _classes(regions, count)
        self._place: NDArray[np.intp] | None = None
        order = np.arange(count)
        if len(classes) == 1 or _cost(classes) + _SORTING + 4 * count > count * n_columns:
            classes = [(order, np.arange(n_columns))]
        else:
            order = np.concatenate([rows for rows, _ in classes] + [_untouched(regions, count)])
            self._place = np.argsort(order)
        self._displacements = np.zeros((4, n_columns + 3), dtype=np.float32)
        self._displacements[:3, n_columns:] = np.eye(3)
        at_rest = np.arange(n_columns, n_columns + 3)
        self._columns = np.concatenate([np.append(columns, at_rest) for _, columns in classes])
        self._gathered = np.zeros((4, len(self._columns)), dtype=np.float32)
        self._moved = np.zeros((1, count, 4), dtype=np.float32)
        self._moved[0, :, :3] = rest[order]
        self._sorted = np.empty((1, min(_CHUNK, count), 4), dtype=np.float32)
        self._products: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]] = []
        # One array for all blocks: numpy asks for huge pages where an array is large, and a frame walks through it all.
        store = np.empty(sum((len(columns) + 3) * len(rows) for rows, columns in classes), dtype=np.float32)
        row = column = used = 0
        for rows, columns in classes:
            block = np.concatenate([_gather(regions, rows, columns, count), rest[rows].T])
            inputs = self._gathered[:, column : column + len(block)].T
            for part in np.array_split(np.arange(len(rows)), -(-4 * block.size // _PRODUCT)):
                matrix = store[used : used + len(block) * len(part)].reshape(len(block), len(part))
                matrix[:] = block[:, part[0] : part[-1] + 1]
                used += matrix.size
                self._products.append((matrix.T, inputs, self._moved[0, row + part[0] : row + part[-1] + 1]))
            row, column = row + len(rows), column + len(block)
        self.nbytes = store.nbytes

    def apply(self, displacements: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Write `rest + A displacements` for (P, 3) float32 displacements into (V, 3) float32 contiguous `out`."""
        self._displacements[:3, :-3] = displacements.T
        self._displacements.take(self._columns, axis=1, out=self._gathered, mode="clip")
        for matrix, inputs, moved in self._products:
            np.matmul(matrix, inputs, out=moved)
        result = out.reshape(1, -1, 3)
        if self._place is None:
            cv2.cvtColor(self._moved, cv2.COLOR_BGRA2BGR, result)
            return
        for start in range(0, len(self._place), _CHUNK):
            place = self._place[start : start + _CHUNK]
            part = self._sorted[:, : len(place)]
            self._moved[0].take(place, axis=0, out=part[0], mode="clip")
            cv2.cvtColor(part, cv2.COLOR_BGRA2BGR, result[:, start : start + _CHUNK])


def _cost(classes: list[tuple[NDArray[np.intp], NDArray[np.intp]]]) -> int:
    return sum(_CALL + len(rows) * len(columns) for rows, columns in classes)


def _classes(regions: list[RegionMatrix], count: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """(rows, columns) of vertices that hang on the same regions, merged where one more product would cost more."""
    key = np.zeros(count, dtype=np.int64)
    for bit, region in enumerate(regions):
        key[region.rows] |= 1 << bit
    found = {
        int(k): [
            (key == k).sum(),
            frozenset(c for b, r in enumerate(regions) if k >> b & 1 for c in r.columns.tolist()),
        ]
        for k in np.unique(key[key > 0])
    }
    groups = [({k}, int(n), columns) for k, (n, columns) in found.items()]
    while len(groups) > 1:
        saving, i, j = max(
            (
                _CALL + a[1] * len(a[2]) + b[1] * len(b[2]) - (a[1] + b[1]) * len(a[2] | b[2]),
                i,
                j,
            )
            for i, a in enumerate(groups)
            for j, b in enumerate(groups[:i])
        )
        if saving <= 0:
            break
        a, b = groups[i], groups[j]
        groups = [group for n, group in enumerate(groups) if n not in (i, j)]
        groups.append((a[0] | b[0], a[1] + b[1], a[2] | b[2]))
    return [
        (np.flatnonzero(np.isin(key, list(keys))), np.array(sorted(columns), dtype=np.intp))
        for keys, _, columns in groups
    ]


def _untouched(regions: list[RegionMatrix], count: int) -> NDArray[np.intp]:
    free = np.ones(count, dtype=bool)
    for region in regions:
        free[region.rows] = False
    return np.flatnonzero(free)


def _gather(
    regions: list[RegionMatrix], rows: NDArray[np.intp], columns: NDArray[np.intp], count: int
) -> NDArray[np.float32]:
    """(columns, rows) sum of the regions' matrices over these rows and columns."""
    block = np.zeros((len(columns), len(rows)), dtype=np.float32)
    place = np.full(count, -1)
    place[rows] = np.arange(len(rows))
    for region in regions:
        here = np.flatnonzero(place[region.rows] >= 0)
        if len(here):
            target = np.ix_(np.searchsorted(columns, region.columns), place[region.rows[here]])
            block[target] += region.matrix[here].T
    return block

"""The product of a frame, ``rest + A d``, in blocks of low rank (docs/method.md, section 5.7).

A frame is limited by reading `A`, which exceeds the CPU's caches on a head of 100,000 vertices. Within a small piece of
the face, however, all control points together move the vertices in only a few ways, as the fields are smooth. Vertices
of the same regions are therefore grouped into pieces, and each piece keeps the strongest singular vectors of its rows:
``A ~ U (Y d)``, with a bound on the error. A sparse matrix would be slower, as its rows are short.

Blocks are stored as (rank, vertices). Their transpose times four columns (three coordinates and one of zeros, as matrix
products with four columns are faster) gives contiguous coordinates, which are then reordered to the mesh. On a small
mesh, where reordering would cost more than it saves, a single exact block is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .. import linalg

TOLERANCE = 5e-4
"""Error allowed at a vertex, relative to the root of the sum of the squared displacements of all control points."""
_MAX_PIECE = 2_048
"""Largest number of vertices of a piece. Smaller pieces have lower ranks, but need more calls."""
_EXACT_VERTICES = 4_096
"""Largest number of vertices of a mesh for which a single exact block is used."""
_CHUNK = 30_000
"""Number of vertices reordered at a time, which fit into the CPU's second-level cache."""


@dataclass(frozen=True)
class RegionMatrix:
    """The matrix of a region.

    Attributes
    ----------
    rows : (Vr,) intp
        Vertices that the region moves.
    columns : (Pr,) intp
        Control points of the region.
    matrix : (Vr, Pr) float32
        The matrix.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    matrix: NDArray[np.float32]


class BlockProduct:
    """The product ``rest + A d`` for many `d`, prepared once.

    Parameters
    ----------
    rest : (V, 3) float32
        Rest positions.
    regions : sequence of RegionMatrix
        Matrices whose sum is `A`; they may share vertices.
    n_columns : int
        Number of control points.

    Attributes
    ----------
    nbytes : int
        Memory of the blocks in bytes.

    Notes
    -----
    No vertex is off by more than ``TOLERANCE |d|``, where ``|d|`` is the root of the sum of all squared displacements.
    Up to 4,096 vertices the product is exact.
    """

    def __init__(self, rest: NDArray[np.float32], regions: list[RegionMatrix], n_columns: int) -> None:
        count = len(rest)
        build_rows = RowBuilder(regions, count, n_columns)
        self._place: NDArray[np.intp] | None = None
        if count <= _EXACT_VERTICES:
            order = np.arange(count)
            pieces = [order]
            factors = [(build_rows(order), np.eye(n_columns, dtype=np.float32))]
        else:
            # 1. Group the vertices into pieces, with unmoved ones last, and factor the rows of each piece.
            pieces = [piece for vertices in build_rows.classes() for piece in _pieces(rest, vertices)]
            still = np.ones(count, dtype=np.bool_)
            still[np.concatenate(pieces)] = False
            order = np.concatenate([*pieces, np.flatnonzero(still)])
            self._place = np.empty_like(order)
            self._place[order] = np.arange(count)
            factors = [_factors(build_rows(piece)) for piece in pieces]
        # 2. Buffers of a frame. Each block has three more modes, which add its rest positions within the same product.
        widths = [len(modes) + 3 for _, modes in factors]
        self._inputs = np.zeros((4, n_columns + 3), dtype=np.float32)
        self._inputs[:3, n_columns:] = np.eye(3)
        self._modes = np.zeros((n_columns + 3, sum(widths)), dtype=np.float32)
        # The modes of a single exact block are the displacements themselves.
        self._amounts = self._inputs if self._place is None else np.zeros((4, sum(widths)), dtype=np.float32)
        self._moved = np.zeros((1, count, 4), dtype=np.float32)
        self._moved[0, :, :3] = rest[order]
        self._sorted = np.empty((1, min(_CHUNK, count), 4), dtype=np.float32)
        self._products: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]] = []
        # 3. Store the blocks in one array, for which numpy requests huge pages if it is large.
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
        self.nbytes = store.nbytes + (0 if self._place is None else self._modes.nbytes)

    def apply(self, displacements: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Compute ``rest + A d``.

        Parameters
        ----------
        displacements : (P, 3) float32
            Displacements `d` of the control points.
        out : (V, 3) float32
            C-contiguous array for the result, which is overwritten.
        """
        self._inputs[:3, :-3] = displacements.T
        # d -> Y d for all blocks at once, then U (Y d) per block.
        if self._place is not None:
            np.matmul(self._inputs, self._modes, out=self._amounts)
        for block, amounts, moved in self._products:
            np.matmul(block, amounts, out=moved)
        result = out.reshape(1, -1, 3)
        if self._place is None:
            cv2.cvtColor(self._moved, cv2.COLOR_BGRA2BGR, result)
            return
        # Back to the order of the mesh. OpenCV drops the fourth column faster than numpy does.
        for start in range(0, len(self._place), _CHUNK):
            place = self._place[start : start + _CHUNK]
            part = self._sorted[:, : len(place)]
            self._moved[0].take(place, axis=0, out=part[0], mode="clip")
            cv2.cvtColor(part, cv2.COLOR_BGRA2BGR, result[:, start : start + _CHUNK])


class RowBuilder:
    """Builds rows of the sum of the regions' matrices, (len(vertices), n_columns)."""

    def __init__(self, regions: list[RegionMatrix], count: int, n_columns: int) -> None:
        self._n_columns = n_columns
        self._regions = regions
        # A product with rows of the identity puts columns in place faster than indexing does.
        self._columns = [np.eye(n_columns, dtype=np.float32)[region.columns] for region in regions]
        self._places = np.full((len(regions), count), -1, dtype=np.int32)
        for region, place in zip(regions, self._places, strict=True):
            place[region.rows] = np.arange(len(region.rows))

    def __call__(self, vertices: NDArray[np.intp]) -> NDArray[np.float32]:
        rows = np.zeros((len(vertices), self._n_columns), dtype=np.float32)
        for region, place, columns in zip(self._regions, self._places[:, vertices], self._columns, strict=True):
            here = np.flatnonzero(place >= 0)
            if len(here):
                rows[here] += region.matrix.take(place[here], axis=0) @ columns
        return rows

    def classes(self) -> list[NDArray[np.intp]]:
        """Group vertices by the set of regions that move them; small groups, which lie along slits, are joined."""
        bits = np.left_shift(1, np.arange(len(self._regions)))
        key = bits @ (self._places >= 0)
        keys, counts = np.unique(key[key > 0], return_counts=True)
        large = keys[counts >= _MAX_PIECE]
        rest = np.flatnonzero((key > 0) & ~np.isin(key, large))
        return [group for group in [*(np.flatnonzero(key == k) for k in large), rest] if len(group)]


def _pieces(places: NDArray[np.float32], vertices: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Split `vertices`, with positions `places` (V, 3), into compact pieces by halving across the widest side."""
    if len(vertices) <= _MAX_PIECE:
        return [np.sort(vertices)]
    there = np.ascontiguousarray(places[vertices].T)
    order = np.argpartition(there[np.ptp(there, axis=1).argmax()], len(vertices) // 2)
    halves = np.array_split(vertices[order], 2)
    return [piece for half in halves for piece in _pieces(places, half)]


def _factors(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return `left` (N, K) and orthonormal `modes` (K, P) whose product approximates each row within the tolerance."""
    exact = rows.astype(np.float64)
    # Right singular vectors from the Gram matrix, the strongest first.
    _, vectors = linalg.eigh(exact.T @ exact)
    modes = vectors[:, ::-1].T.astype(np.float32)
    left = rows @ modes.T
    # The error of a row after K modes is the norm of its remaining coefficients; take the smallest sufficient K.
    beyond = np.sqrt((np.square(left) @ np.tri(len(modes), dtype=np.float32)).max(axis=0))
    rank = int((beyond > TOLERANCE).sum())
    return left[:, :rank], modes[:rank]

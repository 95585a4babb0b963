"""The product of a frame, ``rest + A d``, in blocks of low rank (method.md, section 5.7).

A frame is limited by reading `A`, which exceeds the CPU's caches on a head of 100,000 vertices. Within a small piece of
the face, however, all control points together move the vertices in only a few ways, as the fields are smooth. Vertices
of the same regions are therefore grouped into pieces, and each piece keeps the strongest singular vectors of its rows:
``A ~ U (Y d)``, with a bound on the error. A sparse matrix would be slower, as its rows are short.

A network of OpenCV holds the blocks and multiplies them. scipy's BLAS, a product per block, takes 0.6 to 0.8 times as
long on a CPU with AVX-512, but 0.8 to 1.2 times on one with AVX2 only, most on the built-in head, with either kind of
numpy. The result is reordered to the mesh. On a small mesh, where reordering would cost more than it saves, a single
exact block is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric import linalg
from ..numeric.linalg import multiply
from ..numeric.opencv import Node, encode_network, read_network

TOLERANCE = 5e-4
"""Error allowed at a vertex, relative to the root of the sum of the squared displacements of all control points."""
_MAX_PIECE = 2_048
"""Largest number of vertices of a piece. Smaller pieces have lower ranks, but need more calls."""
_EXACT_VERTICES = 4_096
"""Largest number of vertices of a mesh for which a single exact block is used."""
_CHUNK = 30_000
"""Number of vertices interleaved at a time, which fit into the CPU's second-level cache."""


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

    Notes
    -----
    No vertex is off by more than ``TOLERANCE |d|``, where ``|d|`` is the root of the sum of all squared displacements.
    Up to 4,096 vertices the product is exact. `nbytes` is the memory of the blocks.
    """

    def __init__(self, rest: NDArray[np.float32], regions: list[RegionMatrix], n_columns: int) -> None:
        count = len(rest)
        build_rows = RowBuilder(regions, count, n_columns)
        self._place: NDArray[np.intp] | None = None
        if count <= _EXACT_VERTICES:
            order = np.arange(count)
            pieces, factors = [order], [(build_rows(order), np.eye(n_columns, dtype=np.float32))]
        else:
            # 1. Group the vertices into pieces, with unmoved ones last, and factor the rows of each piece.
            pieces = [piece for vertices in build_rows.classes() for piece in _pieces(rest, vertices)]
            still = np.ones(count, dtype=np.bool_)
            still[np.concatenate(pieces)] = False
            order = np.concatenate([*pieces, np.flatnonzero(still)])
            self._place = np.empty_like(order)
            self._place[order] = np.arange(count)
            self._sorted = rest[order].reshape(-1, 1, 3)
            factors = [_factors(build_rows(piece)) for piece in pieces]
        # 2. A network that multiplies by the modes, and by the block of each piece. Each has three more modes, which
        # add the rest positions within the same product.
        self._inputs = np.zeros((3, n_columns + 3), dtype=np.float32)
        self._inputs[:, n_columns:] = np.eye(3)
        nodes, constants = [], {}
        for i, (piece, (left, modes)) in enumerate(zip(pieces, factors, strict=True)):
            amounts = "displacements"
            if self._place is not None:
                widened = np.zeros((len(modes) + 3, n_columns + 3), dtype=np.float32)
                widened[:-3, :n_columns], widened[-3:, n_columns:] = modes, np.eye(3)
                amounts, constants[f"modes {i}"] = f"amounts {i}", widened
                nodes.append(_inner_product("displacements", f"modes {i}", amounts, len(widened)))
            constants[f"block {i}"] = np.concatenate([left, rest[piece]], axis=1)
            nodes.append(_inner_product(amounts, f"block {i}", f"moved {i}", len(piece)))
        if len(pieces) > 1:
            nodes.append(Node("Concat", tuple(f"moved {i}" for i in range(len(pieces))), "moved", {"axis": 1}))
        self._network = read_network(encode_network(nodes, {"displacements": self._inputs.shape}, constants))
        self.nbytes = sum(constant.nbytes for constant in constants.values())

    def apply(self, displacements: NDArray[np.float32], out: NDArray[np.float32]) -> None:
        """Compute ``rest + A d`` from displacements (P, 3) of the control points into `out` (V, 3), C-contiguous."""
        self._inputs[:, :-3] = displacements.T
        self._network.setInput(self._inputs)
        moved = self._network.forward()
        # From rows of coordinates to vertices, and back to the order of the mesh.
        result = out.reshape(-1, 1, 3) if self._place is None else self._sorted
        for start in range(0, moved.shape[1], _CHUNK):
            part = moved[:, start : start + _CHUNK]
            cv2.merge([part[0], part[1], part[2]], result[start : start + part.shape[1]])
        if self._place is not None:
            self._sorted.reshape(-1, 3).take(self._place, axis=0, out=out, mode="clip")


def _inner_product(values: str, matrix: str, result: str, rows: int) -> Node:
    """Product of `values` (3, K) and the transpose of a constant (rows, K).

    This is no operator of ONNX, but OpenCV tries its own layers for unknown ones, and this one is made for few rows of
    values: it takes half the time of `MatMul`.
    """
    return Node("InnerProduct", (values, matrix), result, {"num_output": rows, "bias_term": 0, "axis": 1})


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
                rows[here] += multiply(region.matrix.take(place[here], axis=0), columns)
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
    # Right singular vectors from the Gram matrix, the strongest first.
    precise = rows.astype(np.float64)
    _, vectors = linalg.eigh(multiply(precise.T, precise))
    modes = vectors[:, ::-1].T.astype(np.float32)
    left = multiply(rows, modes.T)
    # The error of a row after K modes is the norm of its remaining coefficients; take the smallest sufficient K.
    beyond = np.sqrt(np.cumsum(np.square(left)[:, ::-1], axis=1)[:, ::-1].max(axis=0))
    rank = int((beyond > TOLERANCE).sum())
    return left[:, :rank], modes[:rank]

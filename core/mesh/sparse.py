"""Sparse symmetric systems on meshes, solved with numpy alone by nested dissection (docs/method.md, section 5.4).

Two halves of a mesh are joined by a line of vertices, the separator. Eliminating it after both halves leaves dense
systems of a few hundred unknowns instead of one of thousands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..arrays import FloatArray, IntArray

_LEAF = 80
"""Number of unknowns up to which a part is not divided further, as dense elimination is then faster."""


@dataclass(frozen=True)
class _Front:
    """An elimination step: ``x[own] = pivot^-1 b - carry x[rest]``, where `rest` is eliminated later.

    Unknowns are numbered in order of elimination, so that those of a front are contiguous.
    """

    own: slice
    rest: NDArray[np.intp]
    pivot: FloatArray
    carry: FloatArray


class NestedDissection:
    """Solve ``A x = b`` for a positive definite A whose entries connect neighbours on a mesh.

    Parameters
    ----------
    edges : (E, 2) array of int
        Pairs of different unknowns, each pair once.
    weights : (E,) array
        Entries of A at `edges`.
    diagonal : (N,) array
        Diagonal of A.
    places : (N, D) array
        Positions of the unknowns; parts are halved across their widest side.
    dtype : data type
        Precision of `solve`. Single precision takes half the memory and suffices for well-conditioned systems.

    Notes
    -----
    Factorisation is O(N^1.5) on a surface: nested dissection (George 1973) with frontal matrices (Duff & Reid 1983).
    """

    def __init__(
        self,
        edges: IntArray,
        weights: FloatArray,
        diagonal: FloatArray,
        places: FloatArray,
        dtype: DTypeLike = np.float64,
    ) -> None:
        count = len(diagonal)
        # Rows of A in compressed form: both directions of each edge, sorted by row.
        both = np.concatenate([edges, edges[:, ::-1]])
        order = np.argsort(both[:, 0], kind="stable")
        self._from, self._to = both[order].T
        self._weights = np.tile(weights, 2)[order]
        self._starts = np.searchsorted(self._from, np.arange(count + 1))
        self._diagonal, self._places = diagonal, places
        self._mark = np.zeros(count, dtype=np.bool_)
        self._done = np.zeros(count, dtype=np.bool_)
        self._column = np.empty(count, dtype=np.intp)
        self._dtype = np.dtype(dtype)
        self._eliminated: list[NDArray[np.intp]] = []
        self._fronts: list[_Front] = []
        self._eliminate(np.arange(count))
        self._order = np.concatenate(self._eliminated)
        self._rank = np.argsort(self._order)
        self._fronts = [replace(front, rest=self._rank[front.rest]) for front in self._fronts]

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for several right-hand sides.

        Parameters
        ----------
        right : (N, K) array
            The right-hand sides.

        Returns
        -------
        (N, K) array
            The solutions, in the precision of the solver.
        """
        x = np.asarray(right, dtype=self._dtype)[self._order]
        # Forward elimination, then back substitution. Right-hand sides are mostly zeros, so fronts that they do not
        # reach are skipped.
        for front in self._fronts:
            given = x[front.own]
            if given.any():
                x[front.rest] -= front.carry.T @ given
                x[front.own] = np.linalg.solve(front.pivot, given)
        for front in reversed(self._fronts):
            x[front.own] -= front.carry @ x[front.rest]
        return np.asarray(x[self._rank])

    def _eliminate(self, nodes: NDArray[np.intp]) -> tuple[NDArray[np.intp], FloatArray]:
        """Eliminate `nodes`; return the later unknowns coupled to them, (B,), and the update of these, (B, B)."""
        # 1. Eliminate both halves; `own`, the separator between them, comes last.
        own, parts = self._split(nodes)
        updates = [self._eliminate(part) for part in parts]
        # 2. `rest`: the later unknowns that are coupled to the separator or to a half.
        entries = self._entries(own)
        entries = entries[~self._done[self._to[entries]]]
        unknowns = np.unique(np.concatenate([self._to[entries], *(rest for rest, _ in updates)]))
        self._mark[own] = True
        rest = unknowns[~self._mark[unknowns]]
        self._mark[own] = False
        self._done[own] = True
        # 3. Assemble the dense front: entries of A in the rows of the separator, minus the updates of the halves.
        count = len(own)
        self._column[own], self._column[rest] = np.arange(count), np.arange(count, count + len(rest))
        front = np.zeros((count + len(rest), count + len(rest)))
        front[self._column[self._from[entries]], self._column[self._to[entries]]] = self._weights[entries]
        front[np.arange(count), np.arange(count)] = self._diagonal[own]
        for others, update in updates:
            at = self._column[others]
            front[at[:, None], at] -= update
        # 4. Eliminate the separator; its Schur complement updates `rest`.
        pivot, coupling = front[:count, :count], front[:count, count:]
        carry = np.linalg.solve(pivot, coupling)
        place = self._fronts[-1].own.stop if self._fronts else 0
        self._eliminated.append(own)
        self._fronts.append(
            _Front(slice(place, place + count), rest, pivot.astype(self._dtype), carry.astype(self._dtype))
        )
        return rest, coupling.T @ carry - front[count:, count:]

    def _split(self, nodes: NDArray[np.intp]) -> tuple[NDArray[np.intp], list[NDArray[np.intp]]]:
        """Split `nodes` into a separator and the two halves between which it lies; small parts are not divided."""
        if len(nodes) <= _LEAF:
            return nodes, []
        places = self._places[nodes]
        along = places[:, np.ptp(places, axis=0).argmax()]
        order = np.argpartition(along, len(nodes) // 2)
        low, high = nodes[order[: len(nodes) // 2]], nodes[order[len(nodes) // 2 :]]
        # The separator: vertices of the lower half with a neighbour in the upper half.
        self._mark[high] = True
        entries = self._entries(low)
        border = np.unique(self._from[entries[self._mark[self._to[entries]]]])
        self._mark[high] = False
        self._mark[border] = True
        inner = low[~self._mark[low]]
        self._mark[border] = False
        return border, [part for part in (inner, high) if len(part)]

    def _entries(self, nodes: NDArray[np.intp]) -> NDArray[np.intp]:
        """Indices of all off-diagonal entries in the rows `nodes`."""
        counts = self._starts[nodes + 1] - self._starts[nodes]
        ends = np.cumsum(counts)
        return np.asarray(np.arange(int(counts.sum())) + np.repeat(self._starts[nodes] - ends + counts, counts))

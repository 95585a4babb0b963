"""Sparse symmetric systems on meshes, solved by nested dissection (method.md, section 5.4).

Two halves of a mesh are joined by a line of vertices, the separator. Eliminating it after both halves leaves dense
systems of a few hundred unknowns instead of one of thousands. There are thousands of small parts and few large ones, so
parts of a similar size are padded to the same size and eliminated together, as stacks of matrices.

scipy's SuperLU, in single precision and with the ordering for symmetric matrices, takes 0.5 times as long for the 1,300
vertices of the built-in head, as long for 6,200, twice as long for 25,000 and four times for 100,000, whether numpy has
a BLAS or, as Blender's own, has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base import linalg
from ..base.arrays import FloatArray, IntArray

_LEAF = 64
"""Number of unknowns up to which a part is not divided further, as dense elimination is then faster."""
_BITS = 2
"""Halvings per level. Two, which divide a part into quarters, need half as many copies between levels as one."""
_BATCH = 64
"""Largest number of parts in a batch, whose matrices fit into the CPU's second-level cache."""
_MIN_BATCHES = 32
"""Smallest number of batches of a level with that many parts, as parts of a batch should have similar sizes."""


@dataclass(frozen=True)
class _Batch:
    """Parts that are eliminated together: ``x[own] = inverse b - carry x[rest]``, where `rest` is eliminated later.

    Unknowns are numbered in order of elimination. Lists are padded with the row N of `x`, which stays 0.

    Attributes
    ----------
    nodes : (B,) intp
        The parts, as nodes of the tree.
    own : (B, P) intp
        Unknowns that are eliminated.
    both : (B, P + Q) intp
        `own` and `rest`.
    sums, targets : (B, Q) intp
        Rows in which the elimination of right-hand sides sums the updates of `rest` by smaller parts, and to which it
        passes them, in the parent; parts that are not divided have no `sums`.
    back : (B, P, P + Q)
        ``[inverse, -carry]``.
    """

    nodes: NDArray[np.intp]
    own: NDArray[np.intp]
    both: NDArray[np.intp]
    sums: NDArray[np.intp] | None
    targets: NDArray[np.intp]
    back: NDArray[np.floating[Any]]


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
        Precision. Single precision takes half the time and memory and suffices for well-conditioned systems.

    Notes
    -----
    Factorisation is O(N^1.5) on a surface: nested dissection (George 1973) with frontal matrices (Duff & Reid 1983).
    Node 1 of the tree is the separator of the whole mesh; the children of node n are ``n << _BITS`` and following.
    """

    def __init__(
        self,
        edges: IntArray,
        weights: FloatArray,
        diagonal: FloatArray,
        places: FloatArray,
        dtype: DTypeLike = np.float64,
    ) -> None:
        self._count, self._dtype = len(diagonal), np.dtype(dtype)
        self._levels = 0
        while self._count > _LEAF << (_BITS * self._levels):
            self._levels += 1
        # 1. Number the unknowns in order of elimination: descending nodes, so that children precede their parents.
        nodes = _dissect(np.asarray(edges), np.asarray(places), self._levels)
        self._order = np.argsort(-nodes, kind="stable")
        self._rank = np.empty_like(self._order)
        self._rank[self._order] = np.arange(self._count)
        self._node = nodes[self._order]
        self._sizes = np.bincount(nodes, minlength=2 << (_BITS * self._levels))
        self._starts = self._count - np.cumsum(self._sizes)
        # 2. Edges from the end that is eliminated first to the other, and the later unknowns coupled to each node.
        ends = self._rank[np.asarray(edges).T]
        low, high = np.minimum(*ends), np.maximum(*ends)
        self._couplings = self._find_couplings(low, high)
        # Node n has the couplings from `firsts[n]` to `firsts[n + 1]`.
        self._firsts = np.searchsorted(self._couplings, np.arange(len(self._sizes) + 1) * self._count)
        self._later = self._couplings % max(self._count, 1)
        self._n_rest = np.diff(self._firsts)
        # 3. Frontal matrices, level by level.
        self._batches: list[_Batch] = []
        self._factorise(low, high, np.asarray(weights), np.asarray(diagonal)[self._order])

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
        x = self._rows(right.shape[1])
        x[: self._count] = right[self._order]
        self._forward(x)
        self._backward(x)
        return np.asarray(x[self._rank])

    def sandwich(self, seeds: IntArray, masses: FloatArray) -> FloatArray:
        """Return columns of ``A^-1 M A^-1`` with a diagonal M; faster than two calls of `solve`.

        Parameters
        ----------
        seeds : (K,) array of int
            The columns; -1 gives a column of zeros.
        masses : (N,) array
            The diagonal of M.

        Returns
        -------
        (N, K) array
            The columns, in the precision of the solver.
        """
        x = self._rows(len(seeds))
        given = np.flatnonzero(seeds >= 0)
        at = self._rank[seeds[given]]
        x[at, given] = 1.0
        # The first right-hand sides are mostly zeros: only nodes above the seeds take part in the elimination.
        reached = np.zeros(len(self._sizes), dtype=np.bool_)
        for level in range(self._levels + 1):
            reached[self._node[at] >> (_BITS * level)] = True
        self._forward(x, reached)
        self._backward(x)
        x[: self._count] *= masses[self._order, None].astype(self._dtype)
        x[self._count :] = 0.0
        self._forward(x)
        self._backward(x)
        return np.asarray(x[self._rank])

    def _rows(self, columns: int) -> FloatArray:
        """Rows for all unknowns, one for padding, and one per coupling of parts that are divided, all 0."""
        coupled = self._firsts[1 << (_BITS * self._levels)]
        return np.zeros((self._count + 1 + int(coupled), columns), dtype=self._dtype)

    def _forward(self, x: FloatArray, reached: NDArray[np.bool_] | None = None) -> None:
        """Eliminate right-hand sides; nodes that are not `reached` have zeros."""
        for batch in self._batches:
            used = slice(None) if reached is None else np.flatnonzero(reached[batch.nodes])
            own = batch.own[used]
            if len(own):
                carry = batch.back[used][:, :, own.shape[1] :]
                update = _products(carry.transpose(0, 2, 1), x.take(own, axis=0))
                if batch.sums is not None:
                    update += x.take(batch.sums[used], axis=0)
                # Within a batch no two nodes have the same parent, so no row is a target twice, except for padding.
                x[batch.targets[used]] += update
                x[self._count] = 0.0

    def _backward(self, x: FloatArray) -> None:
        for batch in reversed(self._batches):
            x[batch.own] = _products(batch.back, x.take(batch.both, axis=0))

    def _find_couplings(self, low: NDArray[np.intp], high: NDArray[np.intp]) -> NDArray[np.intp]:
        """Pairs of a node and a later unknown coupled to it or to a node below it, as sorted ``node N + unknown``."""
        node, count = self._node[low], self._count
        direct = np.unique((node * count + high)[self._node[high] != node])
        levels = [np.empty(0, dtype=np.intp)]
        for level in range(self._levels, -1, -1):
            # Couplings of children, except to the node itself, and those of its own unknowns.
            child, later = np.divmod(levels[-1], max(count, 1))
            parent = child >> _BITS
            passed = (parent * count + later)[self._node[later] != parent]
            begin, end = np.searchsorted(direct, np.array([1, 1 << _BITS]) * (count << (_BITS * level)))
            levels.append(np.unique(np.concatenate([passed, direct[begin:end]])))
        return np.concatenate(levels[::-1])

    def _slots(
        self, nodes: NDArray[np.intp], unknowns: NDArray[np.intp], widths: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Positions of `unknowns` in the fronts of `nodes`, and their rows in the elimination of right-hand sides."""
        slots, rows = unknowns - self._starts[nodes], unknowns.copy()
        rest = np.flatnonzero(self._node[unknowns] != nodes)
        coupling = np.searchsorted(self._couplings, nodes[rest] * self._count + unknowns[rest])
        slots[rest] = widths[nodes[rest]] + coupling - self._firsts[nodes[rest]]
        rows[rest] = self._count + 1 + coupling
        return slots, rows

    def _factorise(
        self, low: NDArray[np.intp], high: NDArray[np.intp], weights: FloatArray, diagonal: FloatArray
    ) -> None:
        count, dtype = self._count, self._dtype
        # 1. Batches of each level, and place and size of each front in the buffer of its level. Fronts have one more
        # row and column than unknowns, for padding.
        widths, strides, offsets = (np.zeros(len(self._sizes), dtype=np.intp) for _ in range(3))
        levels = []
        for level in range(self._levels + 1):
            groups = self._groups(level)
            width, rest = (sizes[groups].max(axis=1) for sizes in (self._sizes, self._n_rest))
            stride = width + rest + 1
            widths[groups], strides[groups] = width[:, None], stride[:, None]
            areas = np.repeat(np.square(stride), groups.shape[1])
            ends = np.cumsum(areas)
            offsets[groups] = (ends - areas).reshape(groups.shape)
            levels.append((groups, width.tolist(), rest.tolist(), int(ends[-1])))
        # 2. Entries of A in their fronts, and positions of couplings in the front of the parent.
        node = self._node[low]
        row, column = low - self._starts[node], self._slots(node, high, widths)[0]
        upper, lower = offsets[node] + row * strides[node] + column, offsets[node] + column * strides[node] + row
        inner = self._node[high] == node
        parents = self._couplings // max(count, 1) >> _BITS
        below = int(self._firsts[min(1 << _BITS, len(self._firsts) - 1)])
        slots, targets = (
            np.concatenate([np.zeros(below, dtype=np.intp), found])
            for found in self._slots(parents[below:], self._later[below:], widths)
        )
        padded, weights = np.append(diagonal, 1.0).astype(dtype), weights.astype(dtype)
        front = np.zeros(levels[-1][3], dtype=dtype)
        for level in range(self._levels, -1, -1):
            groups, group_widths, group_rests, _ = levels[level]
            first = 1 << (_BITS * level)
            here = np.flatnonzero((node >= first) & (node < first << _BITS))
            front[upper[here]] += weights[here]
            here = here[inner[here]]
            front[lower[here]] += weights[here]
            above = np.zeros(levels[level - 1][3] if level else 0, dtype=dtype)
            for nodes, width, rest in zip(groups, group_widths, group_rests, strict=True):
                # 3. Unknowns of the batch, and its fronts in the buffer; the diagonal of padding is 1.
                size = width + rest + 1
                begin = offsets[nodes[0]]
                fronts = front[begin : begin + len(nodes) * size * size].reshape(len(nodes), size, size)
                own = self._starts[nodes, None] + np.arange(width)
                own[np.arange(width) >= self._sizes[nodes, None]] = count
                fronts[:, np.arange(width), np.arange(width)] += padded[own]
                couplings = self._firsts[nodes, None] + np.arange(rest)
                padding = np.arange(rest) >= self._n_rest[nodes, None]
                couplings[padding] = 0
                # 4. Eliminate `own`. The products are stored for the solution.
                inverse = _inverse(fronts[:, :width, :width])
                coupling = fronts[:, :width, width:-1]
                carry = _products(inverse, coupling)
                back = np.concatenate([inverse, -carry], axis=2)
                # 5. The Schur complement updates the front of the parent.
                if level:
                    update = _products(coupling.transpose(0, 2, 1), carry)
                    update -= fronts[:, width:-1, width:-1]
                    parent = nodes[:, None] >> _BITS
                    slot = np.where(padding, strides[parent] - 1, slots[couplings])
                    rows = offsets[parent] + slot * strides[parent]
                    above[rows[:, :, None] + slot[:, None, :]] -= update
                both = np.concatenate([own, np.where(padding, count, self._later[couplings])], axis=1)
                sums = None if level == self._levels else np.where(padding, count, count + 1 + couplings)
                target = np.where(padding, count, targets[couplings])
                self._batches.append(_Batch(nodes, own, both, sums, target, back))
            front = above

    def _groups(self, level: int) -> NDArray[np.intp]:
        """Group the nodes of a level into batches, (G, B), of similar sizes and of different parents."""
        nodes = np.arange(1 << (_BITS * level), 2 << (_BITS * level))
        children = nodes & ((1 << _BITS) - 1)
        nodes = nodes[np.lexsort((self._sizes[nodes] + self._n_rest[nodes], children))]
        return np.reshape(nodes, (-1, min(_BATCH, max(1, len(nodes) // _MIN_BATCHES))))


def _dissect(edges: IntArray, places: FloatArray, levels: int) -> NDArray[np.intp]:
    """Nodes of all unknowns, (N,): separators at inner nodes of the tree, and undivided parts at its leaves."""
    depth = _BITS * levels
    parts = _halve(places, depth)
    # 1. Edges that a halving cuts, those of the first halving first, from the lower to the upper half.
    ends = parts[edges.T]
    differ = ends[0] ^ ends[1]
    cut = np.flatnonzero(differ)
    halving = depth - np.frexp(differ[cut])[1]
    order = np.argsort(halving.astype(np.int8), kind="stable")
    cut, bounds = cut[order], np.searchsorted(halving[order], np.arange(depth + 1))
    first, second = edges[cut].T
    upper = np.where(ends[0, cut] > ends[1, cut], first, second)
    lower = first + second - upper
    # 2. The separator: vertices of the lower half with a neighbour in the upper half that is in no earlier separator.
    found = np.full(len(places), depth)
    for i in range(depth):
        low, high = lower[bounds[i] : bounds[i + 1]], upper[bounds[i] : bounds[i + 1]]
        found[low[(found[low] == depth) & (found[high] >= i)]] = i
    # 3. Halvings of the same level form one separator.
    bits = found // _BITS * _BITS
    return np.asarray((1 << bits) + (parts >> (depth - bits)))


def _halve(places: FloatArray, depth: int) -> NDArray[np.intp]:
    """Halve the unknowns `depth` times across the widest side of each part; return parts, (N,), from 0."""
    count = len(places)
    # All parts of a halving form one array, so they have the same size: some unknowns are listed twice.
    order = np.resize(np.arange(count), -(-count >> depth) << depth)[None]
    there = np.ascontiguousarray(places.T, dtype=np.float32)[:, order]
    for _ in range(depth):
        half = order.shape[1] // 2
        widest = np.ptp(there, axis=2).argmax(axis=0)
        chosen = np.argpartition(there[widest, np.arange(len(order))], half, axis=1)
        chosen += np.arange(len(order))[:, None] * order.shape[1]
        order = order.take(chosen).reshape(-1, half)
        there = there.reshape(len(there), -1).take(chosen.reshape(-1, half), axis=1)
    parts = np.empty(count, dtype=np.intp)
    parts[order] = np.arange(len(order))[:, None]
    return parts


def _products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply the matrices of two stacks. Unlike numpy's, scipy's products are fast in Blender."""
    return np.stack([linalg.multiply(a, b) for a, b in zip(left, right, strict=True)])


def _inverse(matrices: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Invert a stack of symmetric positive definite matrices, (B, P, P)."""
    out = np.empty_like(matrices)
    if not out.size:  # of a separator between pieces that are not joined; LAPACK may end the process for it
        return out
    factorise, invert = linalg.get_lapack_funcs(("potrf", "potri"), (matrices,))
    for matrix, inverse in zip(matrices, out, strict=True):
        factor, fault = factorise(matrix.T)
        inverse[...] = linalg.inv(matrix) if fault else invert(factor)[0].T  # rounding made it indefinite
    lower = np.tril_indices(matrices.shape[-1], -1)
    out[:, lower[1], lower[0]] = out[:, lower[0], lower[1]]
    return out

"""Corrections that were taught by examples: radial basis functions over expressions (method.md, section 5.11).

The paper interpolates displacements over positions; here, corrections are interpolated over expressions. At rest there
is nothing to correct, so rest is another example, without a correction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.names import N_ACTIONS
from ..heads.style import Example, Style
from ..mesh.kernels import distances
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..numeric.linalg import multiply
from ..takes.face_space import TRUST
from ..takes.neutral import Neutral
from ..takes.take import Take
from ..tracking.result import TrackResult

_ACTION = 0.1
"""Length of a full action, in outer-eye distances. On one half of the strangers' clips of `lab.bench.teaching`, 0.05 to
0.1 are best, by little."""
_WIDTH = 2.0
"""Width of the kernel, relative to the median distance between examples, rest included. Chosen likewise: from 2 to 6
the error hardly changes, and the wider, the more a correction overshoots beyond the examples."""
_SAME = 0.04
"""Distance, in outer-eye distances, below which two expressions count as the same: that of two successive frames is
0.06 in the median."""
_RIDGE = 1e-10
"""Regularisation of equation 5.11, as a share of the kernel's value at 0, against rounding alone."""
_EDITED = 1e-5
"""Smallest change of a vertex that counts, as a share of the outer-eye distance: rounding of positions is below it."""
_MAX_FRAMES = 1500
"""Largest number of frames among which examples are suggested."""
_MAX_SPREAD = 2
"""Number of vertices for each that moves up to which all are added as one slice, which is faster."""
_SCALE = np.concatenate([TRUST, np.full(N_ACTIONS, _ACTION)])
_Asked = Callable[[Example], bool]


class Expressions:
    """Describes tracked frames of a performer as expressions, (213,), which are 0 at rest.

    They contain the displacements of the landmarks without the pose, in outer-eye distances and weighted by how well a
    camera shows them, and the actions above rest, of which NaN counts as 0.
    """

    def __init__(self, neutral: Neutral) -> None:
        self._rest = _SCALE * np.concatenate([neutral.shape.ravel(), np.nan_to_num(neutral.actions)])

    def of(self, result: TrackResult) -> FloatArray:
        """Return the expression of a frame with a face."""
        moved: FloatArray = np.concatenate([result.shape.ravel(), result.actions]) * _SCALE - self._rest
        moved[np.isnan(moved)] = 0.0
        return moved


class Interpolation:
    """Weights of examples by expression: 1 and 0 at the examples, all 0 at rest, and fading far from both.

    With the expressions ``c_i`` of k examples and ``c_0 = 0``, the weights of an expression x are ``a(x) = phi(|x - c|)
    Phi^-1``, ``Phi_ij = phi(|c_i - c_j|)``, without that of rest (equation 5.11). The matrix is factored once.

    The kernel is Matern's with smoothness 3/2, ``phi(r) = (1 + sqrt(3) r / s) exp(-sqrt(3) r / s)``. A Gaussian is no
    more accurate, and unstable where examples are alike: with ten along one motion, it exaggerates what was taught
    thousands of times just beyond them, and this kernel six times.
    """

    def __init__(self, expressions: FloatArray) -> None:
        self._centres = np.concatenate([np.zeros((1, expressions.shape[1])), expressions])
        apart = distances(self._centres, self._centres)
        count = len(self._centres)
        self._width = _WIDTH * float(np.median(apart[np.triu_indices(count, 1)])) if count > 1 else 1.0
        phi = self._kernel(apart) + _RIDGE * np.eye(count)
        self._solved = linalg.solve_definite(phi, np.eye(count)[:, 1:])

    def weights(self, expression: FloatArray) -> FloatArray:
        """Return the weights of the examples, (k,), for an expression (213,)."""
        apart = np.linalg.norm(self._centres - expression, axis=1)
        return multiply(self._kernel(apart), self._solved)

    def _kernel(self, apart: FloatArray) -> FloatArray:
        scaled = np.sqrt(3.0) / self._width * apart
        return np.asarray((1.0 + scaled) * np.exp(-scaled))


def counting(style: Style, asked: _Asked) -> tuple[Example, ...]:
    """Return the examples of a style that count: those that are not muted, and for which `asked` is true.

    Left out are those with the same expression as a later one, or as rest.
    """
    kept: list[Example] = []
    for example in reversed(style.examples):
        if not example.muted and asked(example):
            known = [np.zeros_like(example.expression), *(other.expression for other in kept)]
            if min(np.linalg.norm(example.expression - at) for at in known) >= _SAME:
                kept.append(example)
    return tuple(reversed(kept))


def same_expression(style: Style, expression: FloatArray) -> int | None:
    """Return the last example with the same expression (213,); None without any."""
    apart = [float(np.linalg.norm(example.expression - expression)) for example in style.examples]
    return next((number for number in reversed(range(len(apart))) if apart[number] < _SAME), None)


def require_expression(expression: FloatArray) -> None:
    """Raise HeadError if an expression (213,) is that at rest, where nothing can be corrected."""
    if np.linalg.norm(expression) < _SAME:
        raise HeadError("The face is at rest in this frame, where nothing is corrected. Choose one with an expression.")


class TaughtVertices:
    """Corrections of the vertices of a head.

    Parameters
    ----------
    style : Style
    count : int
        Number of vertices of the head, A.
    skin : (U,) int
        Vertex of the head of each vertex of the deformed skin.
    others : (O,) int
        Vertices of other parts.

    Raises
    ------
    HeadError
        If an example was taught on another mesh.

    Attributes
    ----------
    modes : (k, U, 3) float32
        Displacements of the skin at weight 1 of each example.
    """

    def __init__(self, style: Style, count: int, skin: IntArray, others: IntArray) -> None:
        examples = counting(style.fitted_to(count), lambda example: len(example.offsets) > 0)
        offsets = [np.float32(example.weight) * example.offsets for example in examples]
        every = np.array(offsets, dtype=np.float32).reshape(len(examples), count, 3)
        self._interpolation = Interpolation(_expressions(examples)) if examples else None
        self.modes = every[:, skin]
        self._skin = _Moved(self.modes, np.arange(len(skin)))
        self._others = _Moved(every[:, others], np.asarray(others))

    def weights(self, expression: FloatArray) -> FloatArray:
        """Return the weights of the examples, (k,), for an expression (213,)."""
        return np.empty(0) if self._interpolation is None else self._interpolation.weights(expression)

    def move_skin(self, vertices: NDArray[np.float32], weights: FloatArray) -> None:
        """Add the correction to the vertices of the skin, (U, 3), in place."""
        self._skin.add(vertices, weights)

    def move_others(self, vertices: NDArray[np.float32], weights: FloatArray) -> None:
        """Add the correction to the vertices of other parts among all, (A, 3), in place."""
        self._others.add(vertices, weights)


class _Moved:
    """The vertices that examples move, of which there are often few; `rows` (n,) are their places."""

    def __init__(self, modes: NDArray[np.float32], rows: IntArray) -> None:
        moved = np.flatnonzero(modes.any(axis=(0, 2)))
        self._rows: IntArray | slice = rows[moved]
        if len(moved) and np.ptp(self._rows) == np.ptp(moved) < _MAX_SPREAD * len(moved):
            moved = np.arange(moved[0], moved[-1] + 1)
            self._rows = slice(int(rows[moved[0]]), int(rows[moved[-1]]) + 1)
        self._modes = np.ascontiguousarray(modes[:, moved].reshape(len(modes), 3 * len(moved)))

    def add(self, vertices: NDArray[np.float32], weights: FloatArray) -> None:
        if self._modes.size:
            vertices[self._rows] += multiply(weights.astype(np.float32), self._modes).reshape(-1, 3)


class TaughtControls:
    """Corrections of the controls of a rig that drive a head.

    `names` are the channels that they change, by `RigChannel.key`.
    """

    def __init__(self, style: Style) -> None:
        examples = counting(style, lambda example: bool(self._values(example)))
        self.names = tuple(dict.fromkeys(name for example in examples for name in self._values(example)))
        self._changes = np.array(
            [[example.weight * self._values(example).get(name, 0.0) for name in self.names] for example in examples]
        )
        self._interpolation = Interpolation(_expressions(examples)) if examples else None

    def changes(self, expression: FloatArray) -> dict[str, float]:
        """Return the changes, by name, for an expression (213,)."""
        if self._interpolation is None:
            return {}
        mixed = multiply(self._interpolation.weights(expression), self._changes)
        return dict(zip(self.names, mixed.tolist(), strict=True))

    def _values(self, example: Example) -> Mapping[str, float]:
        return example.controls


class TaughtKeys(TaughtControls):
    """Corrections of the values of shape keys that drive a head, as those of controls."""

    def _values(self, example: Example) -> Mapping[str, float]:
        return example.keys

    def corrected(
        self,
        values: Mapping[str, FloatArray],
        expressions: Sequence[FloatArray],
        ranges: Mapping[str, tuple[float, float]],
        rest: Mapping[str, float],
    ) -> dict[str, FloatArray]:
        """Return the values (N,) of keys in N frames with the corrections, within the ranges of the keys.

        Keys that were taught but have no values start from `rest`, or 0. Those without a range do not exist.
        """
        changes = [self.changes(expression) for expression in expressions]
        out = {name: np.asarray(value) for name, value in values.items()}
        for name in (name for name in self.names if name in ranges):
            start = out.get(name, np.full(len(expressions), rest.get(name, 0.0)))
            out[name] = np.clip(start + np.array([change[name] for change in changes]), *ranges[name])
        return out


def taught_keys(
    shown: Mapping[str, float], edited: Mapping[str, float], changes: Mapping[str, float]
) -> dict[str, float]:
    """Return the changes of keys to teach, given the values that a head shows, those it should have, and the `changes`
    that are already part of the first.
    """
    every = {name: changes.get(name, 0.0) + edited[name] - shown[name] for name in edited}
    return {name: change for name, change in every.items() if abs(change) > _EDITED}


def edited_vertices(wanted: NDArray[np.float32], shown: NDArray[np.float32], unit: float) -> NDArray[np.bool_]:
    """Return which vertices (A,) differ between two shapes (A, 3); `unit` is the outer-eye distance."""
    return np.asarray(np.abs(wanted - shown).max(axis=1) > _EDITED * unit)


def suggest_frames(
    expressions: FloatArray, doubts: FloatArray, taught: Sequence[FloatArray], count: int
) -> NDArray[np.intp]:
    """Choose the frames of a take for which an example would help most, the most helpful first.

    Greedily, each is the frame that shortens the distances of all frames from the nearest example, rest included, most
    (k-medians, Kaufman and Rousseeuw 1987), where frames count more the less certain their landmarks are.

    Parameters
    ----------
    expressions : (N, 213) float64
        Expressions of the frames.
    doubts : (N,) float64
        How doubtful each is, 0 to 1.
    taught : sequence of (213,) float64
        Expressions of the examples.
    count : int
        Largest number of frames. There are fewer if all others are like one of these.

    Returns
    -------
    (M,) intp
    """
    rows = np.unique(np.linspace(0, len(expressions) - 1, min(len(expressions), _MAX_FRAMES)).astype(np.intp))
    among = expressions[rows]
    apart, centres = distances(among, among), np.array([np.zeros(among.shape[1]), *taught])
    nearest, weights = distances(among, centres).min(axis=1), 1.0 + doubts[rows]
    chosen: list[int] = []
    while len(chosen) < count:
        gains = multiply(weights, np.maximum(nearest[:, None] - apart, 0.0))
        gains[nearest < _SAME] = 0.0
        if (best := int(gains.argmax())) in chosen or gains[best] <= 0.0:
            break
        chosen.append(best)
        np.minimum(nearest, apart[best], out=nearest)
    return rows[chosen]


def doubts_of(take: Take, frames: IntArray) -> FloatArray:
    """Return how doubtful the landmarks of frames (N,) of a take are, (N,), 0 to 1."""
    certain = np.nan_to_num(take.landmark_confidence[frames], nan=1.0).mean(axis=1)
    return np.asarray(1.0 - np.clip(certain * take.confidence[frames], 0.0, 1.0), dtype=np.float64)


def _expressions(examples: Sequence[Example]) -> FloatArray:
    return np.array([example.expression for example in examples], dtype=np.float64)

"""The order in which controls of a rig help most to show a motion (method.md, section 9.7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import N_LANDMARKS, outer_eye_distance
from ..heads.built_in import load_head
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_least_squares
from ..numeric.linalg import multiply
from .control_names import mirrored
from .rig_map import RigMap

_FRAMES = 52
"""Frames of a motion that are looked at, evenly spaced: as many as ARKit has expressions."""
_TRIED = 3
"""Controls that are tried at each step, those that promise most."""
_FLAT = 0.02
"""Share of the error by which a step has to lower it so that the next one is chosen among several."""
_RIDGE = 3e-3
"""Weight of the squares of the variables, relative to the mean square of their effects, as in the solver."""


class ControlOrder:
    """Greedy order of controls; `steps` first.

    A control and its mirror image, by their names, are added together.

    Parameters
    ----------
    rig_map : RigMap
    motion : (N, 66, 3) array
        Displacements of the landmarks in the head frame and unit of the map.

    Attributes
    ----------
    groups : list of list of str
        Controls that were added together, those that help most first.
    errors : list of float
        Mean distance of the landmarks from the motion, relative to the mean displacement, after each group.
    """

    def __init__(self, rig_map: RigMap, motion: FloatArray) -> None:
        self.groups: list[list[str]] = []
        self.errors: list[float] = []
        self._map = rig_map.of_landmarks()
        chosen = np.unique(np.linspace(0, len(motion) - 1, min(_FRAMES, len(motion))).astype(np.intp))
        self._of = np.array([self._map.channels[k].control for k in self._map.channel.tolist()])
        self._rows = self._map.effects.reshape(len(self._of), -1) / rig_map.unit
        self._wanted = motion[chosen][:, :N_LANDMARKS].reshape(len(chosen), -1).astype(np.float64) / rig_map.unit
        gram = multiply(self._rows, self._rows.T)
        self._gram = gram + _RIDGE * np.trace(gram) / max(len(gram), 1) * np.eye(len(gram))

    def steps(self) -> Iterator[float]:
        """Add group after group; yield the share that is done."""
        left, total = _paired(self._map.controls), len(self._map.controls)
        used = np.zeros(len(self._of), dtype=np.bool_)
        x, before = np.zeros((len(self._wanted), len(self._of))), 1.0
        while left:
            best, x = self._best(used, x, left, _TRIED if self._is_steep(before) else 1)
            before = self.errors[-1] if self.errors else 1.0
            used |= self._variables(best)
            left.remove(best)
            self.groups.append(best)
            self.errors.append(self._error(x))
            yield 1.0 - sum(map(len, left)) / total

    def _is_steep(self, before: float) -> bool:
        """Whether the last group lowered the error by so much that it matters which one is next."""
        return not self.errors or self.errors[-1] < (1.0 - _FLAT) * before

    def _best(
        self, used: NDArray[np.bool_], x: FloatArray, groups: Sequence[list[str]], tried: int
    ) -> tuple[list[str], FloatArray]:
        """Return the group that helps most, and the solutions with it."""
        promised = self._promises(x, groups)
        results = []
        for number in np.argsort(-promised, kind="stable")[:tried].tolist():
            solved = self._solved(used | self._variables(groups[number]), x)
            gained = self._missed(x) - self._missed(solved)
            results.append((gained / len(groups[number]), -number, solved))
        _, number, solved = max(results, key=lambda result: result[:2])
        return groups[-number], solved

    def _variables(self, group: Sequence[str]) -> NDArray[np.bool_]:
        return np.isin(self._of, group)

    def _solved(self, used: NDArray[np.bool_], x: FloatArray) -> FloatArray:
        """Solve for the used variables, (N, K), from solutions for fewer of them."""
        rows, out = self._rows[used], np.zeros_like(x)
        gram, products = self._gram[np.ix_(used, used)], multiply(self._wanted, rows.T)
        lower, upper = self._map.lower[used], self._map.upper[used]
        out[:, used] = bounded_least_squares(gram, products, lower, upper, x[:, used])
        return out

    def _left(self, x: FloatArray) -> FloatArray:
        return np.asarray(self._wanted - multiply(x, self._rows))

    def _missed(self, x: FloatArray) -> float:
        return float(np.square(self._left(x)).sum())

    def _promises(self, x: FloatArray, groups: Sequence[Sequence[str]]) -> FloatArray:
        """How much each group would remove if each of its variables were used alone, per control."""
        along = multiply(self._left(x), self._rows.T)
        sizes = np.diag(self._gram)
        steps = np.clip(along / sizes, self._map.lower, self._map.upper)
        gains = (steps * (2.0 * along - steps * sizes)).sum(axis=0)
        return np.array([gains[self._variables(group)].sum() / len(group) for group in groups])

    def _error(self, x: FloatArray) -> float:
        """Mean distance from the motion, if only the stronger direction of each channel is used, as in a bake."""
        opposite, sizes = self._map.opposite, np.abs(x * self._map.scale)
        weaker = (opposite >= 0) & (x > 0.0) & (x[:, opposite] > 0.0) & (sizes < sizes[:, opposite])
        left = self._left(np.where(weaker, 0.0, x)).reshape(len(x), -1, 3)
        size = self._wanted.reshape(left.shape)
        return float(np.linalg.norm(left, axis=2).mean() / max(np.linalg.norm(size, axis=2).mean(), 1e-30))


def face_units(unit: float) -> FloatArray:
    """Displacements (52, 66, 3) of the landmarks in ARKit's expressions, for an eye distance of `unit`."""
    head = load_head()
    size = unit / outer_eye_distance(head.vertices[head.landmarks])
    return np.asarray(size * head.units[:, head.landmarks].astype(np.float64))


def _paired(controls: Sequence[str]) -> list[list[str]]:
    """Put each control together with its mirror image."""
    groups: dict[str, list[str]] = {}
    for name in controls:
        other = mirrored(name)
        groups.setdefault(other if other in groups else name, []).append(name)
    return list(groups.values())

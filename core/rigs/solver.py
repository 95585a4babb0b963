"""Values of a rig's controls that show a face (method.md, section 9.7)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..face.landmarks import JAW, LOWER_LIDS, LOWER_LIPS, N_LANDMARKS, UPPER_LIDS, UPPER_LIPS, outer_eye_distance
from ..heads.built_in import load_head
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_minimum
from ..numeric.linalg import multiply
from .rig_map import RigMap

_SKIN = 0.35
"""Weight of all vertices that are no landmarks, relative to that of the landmarks."""
_CONTOUR = 0.5
"""Weight of the jaw line."""
_LIDS = 2.0
"""Weight of the openings of the eyes."""
_LIPS = 2.0
"""Weight of the opening of the lips."""
_PRIOR = 2.5e-3
"""Weight of the squares of the variables, relative to the mean square of their effects. Chosen on the sample clip; from
3.5e-3 to 1e-3 takes are shown nearly alike, and random poses of a rig better and better, but skin creases."""
_NARROW = 0.1
"""Motion by a control, relative to the median of all, below which it is not made heavier still."""
_DOUBT = 10.0
"""Factor of that weight for what is not linear, for each square of its doubt."""
_CORRECTING = 0.03
"""The same weight of what a correction changes: it mends what the rig is known to do there, which is less certain the
weaker a control is. Chosen on the sample clip; with 0.1 lids are shown better still, but random poses worse."""
_NEARER = 0.98
"""Square of the distance after a correction, relative to that before, below which it is taken: of two that are about
as near, rounding would choose, and another one in the mirror."""
_STEADY = 5e-4
"""Weight of the squares of their changes from frame to frame, in the same unit."""

Evaluate = Callable[[FloatArray], FloatArray]
"""Takes changes of the channels (C,), and returns how the rig itself moves the sampled vertices, (S, 3)."""


class RigSolver:
    """Solves for the controls of a rig, frame by frame: a quadratic program within bounds, from the last solution.

    Controls that move more of the face are preferred, as an animator would. Of two directions of a channel, only one is
    used at a time.
    """

    def __init__(self, rig_map: RigMap) -> None:
        self.map = rig_map
        self._weights = _weights(len(rig_map.sample))
        self._rows = self._features(rig_map.effects)
        gram = multiply(self._rows, self._rows.T)
        count = max(len(gram), 1)
        size = float(np.trace(gram)) / count or 1.0
        breadth = np.sqrt(np.square(rig_map.effects).sum(axis=(1, 2)))
        usual = float(np.median(breadth[breadth > 0.0])) if breadth.any() else 1.0
        prior = np.square(usual / np.maximum(breadth, _NARROW * usual))
        prior = prior * (1.0 + _DOUBT * np.square(rig_map.doubt))
        self._steady = _STEADY * size
        self._gram = gram + np.diag(_PRIOR * size * prior + self._steady)
        self._held = _CORRECTING * size * prior
        self._correcting = self._gram + np.diag(self._held)
        self._opposite = rig_map.opposite
        self.reset()

    def _features(self, moved: FloatArray) -> FloatArray:
        """Weighted rows that are compared, (..., R), of displacements (..., S, 3), in eye distances."""
        flat = (moved * self._weights[:, None]).reshape(*moved.shape[:-2], 3 * len(self._weights))
        lids = _LIDS * (moved[..., UPPER_LIDS, 1] - moved[..., LOWER_LIDS, 1])
        lips = _LIPS * (moved[..., UPPER_LIPS, 1] - moved[..., LOWER_LIPS, 1])
        return np.asarray(np.concatenate([flat, lids, lips], axis=-1) / self.map.unit)

    def reset(self) -> None:
        """Forget the last frame."""
        self._last = self._again = np.zeros(len(self._gram))
        self._asked: tuple[FloatArray, ...] = ()

    def solve(self, target: FloatArray) -> FloatArray:
        """Return the changes of the channels from rest, (C,), for displacements (S, 3) of the sampled vertices."""
        return self.map.values(self.variables(target))

    def variables(self, target: FloatArray) -> FloatArray:
        """Return the variables of the map, (K,), as `solve`: the same again for the same target."""
        if not self._was_asked(target):
            self._last = self._bounded(multiply(self._rows, self._features(target)))
        return self._last

    def corrected(self, target: FloatArray, evaluate: Evaluate, corrections: int) -> tuple[FloatArray, FloatArray]:
        """Return the changes of the channels, (C,), and how the rig itself then moves the sampled vertices, (S, 3).

        What the linear model misses is added to the target up to `corrections` times; the solution that comes nearest
        is taken, as a model that is far off may lead away.
        """
        wanted = self._features(target)
        x, nearest = self._last, np.inf
        shifted, found, shown = wanted, x, np.zeros_like(target)
        for number in range(corrections + 1):
            x = self._bounded(multiply(self._rows, shifted), x if number else None)
            moved = evaluate(self.map.values(x))
            features = self._features(moved)
            off = float(np.square(features - wanted).sum())
            if off < _NEARER * nearest:
                nearest, found, shown = off, x, moved
            shifted = wanted + multiply(self._rows.T, x) - features
        self._last, self._asked = found, ()
        return self.map.values(found), shown

    def again(self, target: FloatArray, variables: FloatArray, moved: FloatArray) -> FloatArray:
        """Return variables (K,) corrected by how the rig itself moves the sampled vertices, (S, 3), at others.

        If the rig moves more than the model says, the correction is as much smaller, so that it does not overshoot. It
        is the same again if nothing has changed.
        """
        if self._was_asked(target, variables, moved):
            return self._again
        foreseen, seen = multiply(self._rows.T, variables), self._features(moved)
        self._last = self._bounded(multiply(self._rows, self._features(target) + foreseen - seen), variables)
        gain = float(foreseen @ seen) / max(float(foreseen @ foreseen), 1e-30)
        self._again = np.asarray(variables + (self._last - variables) / max(gain, 1.0))
        return self._again

    def _was_asked(self, *question: FloatArray) -> bool:
        """Return whether the last question was the same, and note this one: a frame that stays is shown alike."""
        before, self._asked = self._asked, tuple(map(np.array, question))
        return len(before) == len(question) and all(map(np.array_equal, before, question))

    def _bounded(self, products: FloatArray, before: FloatArray | None = None) -> FloatArray:
        """Solve within the bounds, (K,), one direction of each channel at a time; near the solution `before`, if it is
        corrected.
        """
        products = products + self._steady * self._last
        gram, start = self._gram, self._last
        if before is not None:
            gram, start, products = self._correcting, before, products + self._held * before
        return bounded_minimum(gram, products, self.map.lower, self.map.upper, start, self._opposite)


def share_shown(rig_map: RigMap) -> float:
    """Return how much of the motion of the landmarks in ARKit's expressions a rig can show, 0 to 1."""
    head = load_head()
    size = rig_map.unit / outer_eye_distance(head.vertices[head.landmarks])
    expressions = size * head.units[:, head.landmarks].astype(np.float64)
    solver = RigSolver(landmarks := rig_map.of_landmarks())
    off = []
    for wanted in expressions:
        solver.reset()
        off.append(wanted - np.einsum("k,ksc->sc", solver.variables(wanted), landmarks.effects))
    missed, size = (float(np.linalg.norm(each, axis=2).sum()) for each in (np.array(off), expressions))
    return max(1.0 - missed / size, 0.0)


def _weights(count: int) -> FloatArray:
    """Weights of the sampled vertices, (S,)."""
    others = max(count - N_LANDMARKS, 0)
    weights = np.ones(count)
    weights[JAW] = _CONTOUR
    weights[N_LANDMARKS:] = _SKIN * np.sqrt(N_LANDMARKS / max(others, 1))
    return weights

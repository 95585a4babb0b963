"""Identity and expression of faces as linear spaces (method.md, section 4.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import BROWS, JAW, LIPS, N_LANDMARKS
from ..files.archives import open_shipped
from ..files.assets import ASSETS
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply

FORMAT = "facemime-face-space-1"
FACE_SPACE_FILE = ASSETS / "expressions" / "face_space.npz"

_NOISE = 0.012
"""Standard deviation of tracked landmarks about the model, in eye distances."""
_UNIQUE = 0.01
"""Standard deviation of each coordinate of a person's face that the modes do not explain, in eye distances."""
_SPARSITY = 1.0
"""Weight of the sum of the activations in equation 4.1."""
_RIDGE = 0.5
"""Weight of half the sum of their squares."""
_MAX_ACTIVATION = 2.0
"""Largest activation."""
_LASTING = 0.8
"""Standard deviation of the activation of an expression that lasts for a whole take. Chosen on one half of the
strangers' clips; from 0.4 to 2 frames of different people compare alike."""
_ACTS = -21.0
"""Logarithm of the likelihood ratio of lips that act and lips at rest, at which either is as probable. The Gaussian
prior of expressions has no rest, so it is not 0. Chosen on every other person of the London set: at rest they have -25
to -20, and in the median of the smiles -15."""
_INDEPENDENT = 12.0
"""Largest number of frames that count as independent. Neighbouring frames err alike, so more would outvote the
prior."""
_CALM = 0.1
"""Amount of expression, in eye distances over all landmarks, below which frames count alike."""
_ROUNDS = 12
"""Alternations between the person and the activations."""
_SWEEPS = 25
"""Sweeps of coordinate descent over the activations in each of them."""
_DEPTH = 0.3
"""Weight of depths, which a camera hardly sees."""
_CONTOUR = 0.3
"""Weight of the jaw line, whose points slide along it."""


_LIPS = (3 * LIPS[:, None] + (0, 1)).reshape(-1)
"""Coordinates of the lips across and down among the 198."""


@dataclass(frozen=True)
class FaceSpace:
    """Linear model of a face, ``s = m + I a + E b``.

    ``a ~ N(0, 1)`` describes the person and ``b >= 0``, mostly 0, the moment. Expressions only push: no unit makes a
    face more neutral than the neutral one. This, and the fact that a person stays the same from frame to frame,
    distinguishes a broad mouth from a smile.

    Attributes
    ----------
    mean : (66, 3) float64
        Neutral face: head frame, outer-eye distances.
    identity : (K, 66, 3) float64
        Displacements by one standard deviation of each mode.
    units : (U, 66, 3) float64
        Displacements of expressions at full activation. Like the modes, they leave position, rotation and size of the
        whole face unchanged.
    """

    mean: FloatArray
    identity: FloatArray
    units: FloatArray

    def explain(self, shapes: FloatArray, weights: FloatArray) -> FloatArray:
        """Estimate the units' activations (N, U) in frames of one person (equation 4.1); 300 frames take 0.05 s."""
        *_, activations = self.sweeps(shapes, weights)
        return activations

    def sweeps(self, shapes: FloatArray, weights: FloatArray) -> Iterator[FloatArray]:
        """Compute `explain` step by step, and yield its array after each sweep.

        `shapes` (N, 66, 3) are pose-free, in the head frame and outer-eye distances; `weights` (N,) are the relative
        ones of the frames, positive. Steps alternate between the identity, a ridge regression, and the activations, by
        coordinate descent over all frames at once (Friedman et al. 2010). A sweep takes 0.2 ms, the regression less:
        with the covariance ``C = V diag(l) V^T`` of people's faces, the face that `n` frames with the mean `x` suggest
        is ``V diag(n l / (n l + 1)) V^T x``.
        """
        away = without_similarity(shapes - self.mean, self.mean).reshape(len(shapes), -1) * TRUST / _NOISE
        shown, (spread, axes) = self._scaled_units, self._people
        gram, activations = shown @ shown.T, np.zeros((len(shown), len(shapes)))
        person, of_mean = np.zeros(away.shape[1]), multiply(shown, away.T)
        # Where its gradient is 0, a unit is a constant less its products with the other units.
        size, blas = gram.diagonal() + _RIDGE, linalg.blas
        others = (gram - np.diag(gram.diagonal())) / size[:, None]
        for _ in range(_ROUNDS):
            best = (of_mean - multiply(shown, person)[:, None] - _SPARSITY) / size[:, None]
            for _ in range(_SWEEPS):
                for unit, activation in enumerate(activations):
                    alone = blas.dgemv(-1.0, activations.T, others[unit], 1.0, best[unit])
                    np.minimum(np.maximum(alone, 0.0, out=alone), _MAX_ACTIVATION, out=activation)
                yield activations.T
            # Calm frames say most about the person, as they depend least on how well the units match the expression.
            share = weights / (_CALM**2 + np.square(self.amount(activations.T)))
            share *= min(_INDEPENDENT, len(shapes)) / share.sum()
            left_over = multiply(away.T, share) - multiply(multiply(activations, share), shown)
            along = multiply(left_over, axes)
            person = multiply(axes, along * spread / (share.sum() * spread + 1.0))

    def amount(self, activations: FloatArray) -> FloatArray:
        """Amount of expression of activations (N, U), (N,): length of all displacements in x and y in eye distances."""
        squared = (multiply(activations, self._across) * activations).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)))

    def expressed(self, displacement: FloatArray) -> FloatArray:
        """Estimate the part of a displacement (66, 3) from the mean face that is expression, and not the person.

        Both are Gaussian here, so it is the mean of the expression, given their sum (equation 4.7).
        """
        return np.asarray((self._expression @ (displacement.reshape(-1) * TRUST) / TRUST).reshape(N_LANDMARKS, 3))

    def acting_probability(self, displacement: FloatArray) -> float:
        """Probability that the lips of a face with a displacement (66, 3) from the mean act, and do not rest.

        Unlike in `expressed`, the moment either has an expression or none (equation 4.8).
        """
        precision, size = self._lips_at_rest
        lips = (displacement.reshape(-1) * TRUST)[_LIPS] / _NOISE
        likelier = 0.5 * (lips @ precision @ lips + size)
        return float(1.0 / (1.0 + np.exp(min(_ACTS - likelier, 100.0))))

    @cached_property
    def _lips_at_rest(self) -> tuple[FloatArray, float]:
        """By how much expressions lower the precision of the lips (36, 36), and the logarithm of its determinant."""
        shown, (spread, axes) = (_LASTING * self._scaled_units)[:, _LIPS], self._people
        resting = ((axes * spread) @ axes.T + np.eye(len(axes)))[np.ix_(_LIPS, _LIPS)]
        acting = resting + shown.T @ shown
        size = np.log(linalg.det(linalg.solve_definite(acting, resting)))
        return linalg.inverse_definite(resting) - linalg.inverse_definite(acting), float(size)

    @cached_property
    def _expression(self) -> FloatArray:
        """Matrix (198, 198) from weighted displacements to the part of them that is expression."""
        shown, (spread, axes) = _LASTING * self._scaled_units, self._people
        acted = shown.T @ shown
        both = acted + (axes * spread) @ axes.T + np.eye(len(axes))
        return linalg.solve_definite(both, acted).T

    @cached_property
    def _across(self) -> FloatArray:
        """Products of the units' displacements in x and y, (U, U)."""
        across = self.units[..., :2].reshape(len(self.units), -1)
        return np.asarray(across @ across.T)

    @cached_property
    def of_brows(self) -> NDArray[np.bool_]:
        """Whether each unit moves the brows more than everything else, (U,)."""
        moved = np.square(self.units).sum(axis=2)
        return np.asarray(moved[:, BROWS].sum(axis=1) > 0.5 * moved.sum(axis=1))

    @cached_property
    def _scaled_units(self) -> FloatArray:
        """Units as rows of weighted coordinates, (U, 198), in standard deviations of the noise."""
        return np.asarray(self.units.reshape(len(self.units), -1) * TRUST / _NOISE)

    @cached_property
    def _people(self) -> tuple[FloatArray, FloatArray]:
        """Variances (198,) and axes, as columns (198, 198), of people's faces in the same coordinates."""
        own = self.identity.reshape(len(self.identity), -1)
        own = np.concatenate([own, _UNIQUE * np.eye(own.shape[1])]) * TRUST / _NOISE
        spread, axes = linalg.eigh(own.T @ own)
        return np.maximum(spread, 0.0), axes


def without_similarity(displacements: FloatArray, mean: FloatArray) -> FloatArray:
    """Remove from displacements (N, 66, 3) of the face `mean` what moves, turns or scales it as a whole.

    That is the weighted least-squares fit of a similarity which is linearised about `mean`.
    """
    whole = np.stack(list(_similarities(mean))).reshape(7, -1)
    flat = displacements.reshape(len(displacements), -1)
    moved, *_ = linalg.lstsq((whole * TRUST).T, (flat * TRUST).T)
    return np.asarray(flat - moved.T @ whole).reshape(displacements.shape)


def _similarities(mean: FloatArray) -> Iterator[FloatArray]:
    """Yield the seven directions (66, 3) in which a face grows, moves and turns."""
    centred = mean - mean.mean(axis=0)
    yield centred
    for axis in np.eye(3):
        yield np.broadcast_to(axis, centred.shape)
        yield np.cross(axis, centred)


def _trust() -> FloatArray:
    trust = np.ones((N_LANDMARKS, 3))
    trust[:, 2] = _DEPTH
    trust[JAW] *= _CONTOUR
    return trust.reshape(-1)


TRUST = _trust()
"""Weight of each coordinate of the landmarks, (198,), by how well a camera shows it."""


@lru_cache(maxsize=1)
def load_face_space() -> FaceSpace:
    """Read the shipped face space, once; raises ModelError if it is missing, damaged, or of a different version."""
    with open_shipped(FACE_SPACE_FILE, FORMAT) as archive:
        return FaceSpace(
            mean=archive.floats("mean", (N_LANDMARKS, 3)),
            identity=archive.floats("identity", (None, N_LANDMARKS, 3)),
            units=archive.floats("units", (None, N_LANDMARKS, 3)),
        )

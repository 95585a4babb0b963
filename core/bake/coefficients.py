"""Coefficients from observed frames: a sparse fit with a learnt prior, corrected by a network (method, section 9.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import LOWER_LIPS, MIRROR, N_LANDMARKS, UPPER_LIPS
from ..face.names import ACTION_MIRROR, COEFFICIENT_INDEX, COEFFICIENT_MIRROR, EXCLUSIVE, FITTED, N_ACTIONS
from ..files.archives import Archive, open_shipped
from ..files.assets import ASSETS
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..numeric.least_squares import bounded_least_squares, bounded_minimum
from ..numeric.linalg import multiply

FORMAT = "facemime-coefficients-2"
_SPARSITY = 1.0
"""`lambda` of equation 9.3: weight of the sum of the coefficients in the first fit."""
_SHARPNESS = 0.6
"""`tau` of equation 9.4: weight of ``(a / (a_0 + s))^2`` in later fits."""
_SMALL = 0.05
"""`s` of equation 9.4: value below which a coefficient counts as absent."""
_TOGETHER = 0.5
"""`kappa` of equation 9.4: weight of the prior in later fits."""
_LEFT = 0.1
"""Share of the covariance of the neutral face's error that remains once the error was estimated."""
_ROUNDS = 4
"""Number of iterations of equation 9.5."""
_SAMPLE = 100
"""Largest number of frames of a take from which the neutral face's error is estimated."""
_INDEPENDENT = 40.0
"""`m` of equation 9.5: largest number of frames that count as independent, as neighbours err alike."""
_CALM = 0.3
"""Sum of coefficients below which frames count alike in equation 9.5."""
_EXCLUDED = 1e6
"""Penalty of the weaker coefficient of an exclusive pair, far above what an observation could outweigh."""


COEFFICIENT_FILE = ASSETS / "expressions" / "coefficients.npz"
N_OBSERVED = 3 * N_LANDMARKS + N_ACTIONS
"""Size of an observation: 66 displacements in the built-in head's outer-eye distances, and 15 activations."""
HIDDEN = (256, 128)
"""Widths of the hidden layers of the network that corrects the fit."""


@dataclass(frozen=True)
class Spread:
    """A covariance ``F^T F + diag(s)^2``.

    Attributes
    ----------
    modes : (K, 213) float64
        F, the directions of most of the variance.
    rest : (213,) float64
        s, standard deviations of the remainder.
    """

    modes: FloatArray
    rest: FloatArray

    def matrix(self) -> FloatArray:
        """Return the covariance matrix, (213, 213) float64."""
        return np.asarray(self.modes.T @ self.modes + np.diag(np.square(self.rest)))


@dataclass(frozen=True)
class Layer:
    """A layer of a network, ``y = x W + b``.

    Attributes
    ----------
    weights : (I, O) float64
        W.
    offsets : (O,) float64
        b.
    """

    weights: FloatArray
    offsets: FloatArray


@dataclass(frozen=True)
class CoefficientModel:
    """Model of observations, ``x = a R + e + n``, of coefficients a with the errors of a frame and of the neutral face.

    Attributes
    ----------
    responses : (44, 213) float64
        R, the observation of each of the coefficients `FITTED` at value 1.
    frame : Spread
        Covariance of e, which differs from frame to frame: the tracker's noise, and differences between people.
    neutral : Spread
        Covariance of n, which is the same for a whole take.
    together : (44, 44) float64
        P, the inverse of the mean product of any two coefficients: how they go together.
    gains : (44,) float64
        Factors that compensate for the shrinkage of the amplitudes by the prior.
    correction : tuple of Layer
        A network from an observation and its fitted coefficients, (213 + 44,), to what the fit lacks, (44,), with ramps
        between its layers. If it has no layers, the fit is not corrected.
    """

    responses: FloatArray
    frame: Spread
    neutral: Spread
    together: FloatArray
    gains: FloatArray
    correction: tuple[Layer, ...] = ()


@lru_cache(maxsize=1)
def load_coefficient_model(path: Path = COEFFICIENT_FILE) -> CoefficientModel:
    """Read the shipped model, once; raises ModelError if it is missing, damaged, or of a different version."""
    count = len(FITTED)
    with open_shipped(path, FORMAT) as archive:
        return CoefficientModel(
            responses=archive.floats("responses", (count, N_OBSERVED)),
            frame=_spread(archive, "frame"),
            neutral=_spread(archive, "neutral"),
            together=archive.floats("together", (count, count)),
            gains=archive.floats("gains", (count,)),
            correction=_correction(archive, (N_OBSERVED + count, *HIDDEN, count)),
        )


def _correction(archive: Archive, widths: tuple[int, ...]) -> tuple[Layer, ...]:
    return tuple(
        Layer(archive.floats(f"correction.{i}.weights", shape), archive.floats(f"correction.{i}.offsets", shape[1:]))
        for i, shape in enumerate(pairwise(widths))
    )


def _spread(archive: Archive, name: str) -> Spread:
    return Spread(archive.floats(f"{name}.modes", (None, N_OBSERVED)), archive.floats(f"{name}.rest", (N_OBSERVED,)))


_PLACES: NDArray[np.intp] = np.searchsorted(FITTED, EXCLUSIVE)
_ACROSS: NDArray[np.intp] = np.searchsorted(FITTED, COEFFICIENT_MIRROR[FITTED])
OPENS, CLOSES = (int(np.searchsorted(FITTED, COEFFICIENT_INDEX[name])) for name in ("jawOpen", "mouthClose"))
LIP_GAP = np.zeros((N_LANDMARKS, 3))
LIP_GAP[LOWER_LIPS, 1], LIP_GAP[UPPER_LIPS, 1] = 1.0 / len(LOWER_LIPS), -1.0 / len(UPPER_LIPS)
LIP_GAP = LIP_GAP.ravel()
"""Mean vertical gap of the inner lips as a function of observed displacements."""


@dataclass(frozen=True)
class _Fitting:
    """What fits with the same precision share: products with values (D, 44), and with each other (44, 44)."""

    readout: FloatArray
    gram: FloatArray


class CoefficientSolver:
    """Finds the 44 coefficients `FITTED` from observations.

    `actions` is whether the activations of actions are known. If not, only the landmarks count.
    """

    def __init__(self, model: CoefficientModel, *, actions: bool = True) -> None:
        known = np.arange(N_OBSERVED) < (N_OBSERVED if actions else 3 * N_LANDMARKS)
        self._known = known
        self._model = model
        self._responses = model.responses[:, known]
        # Precisions of equation 9.3: of a frame about its face, and of a neutral face about the true one. A single
        # frame bears both errors, a take that has found its neutral face only what is left of the second.
        frame, neutral = (spread.matrix()[np.ix_(known, known)] for spread in (model.frame, model.neutral))
        self._within, self._between = linalg.inv(frame), linalg.inv(neutral)
        self._single = self._fitting(linalg.inv(frame + neutral))
        self._calibrated = self._fitting(linalg.inv(frame + _LEFT * neutral))
        self._at_first = self._fitting(self._within)
        self._correction = model.correction
        self._at_rest = self._lacking(np.zeros((1, N_OBSERVED + len(FITTED)))) if model.correction else 0.0

    def frames(self, observed: FloatArray, near: FloatArray | None = None) -> FloatArray:
        """Find the coefficients (N, 44), 0 to 1, of single frames, as in a live performance; see `fitted_frames`."""
        return self.corrected(self.fitted_frames(observed, near))

    def take(self, observed: FloatArray) -> FloatArray:
        """Find the coefficients (N, 44), 0 to 1, of a take, corrected for the error of its neutral face."""
        return self.corrected(self.fitted_take(observed))

    def fitted_frames(self, observed: FloatArray, near: FloatArray | None = None) -> FloatArray:
        """Fit the coefficients of single frames to observations (N, 213) (equations 9.3 and 9.4).

        Returns the known part of the observations, and the fitted coefficients, 0 to 1: (N, D + 44). `near` (N, 44) is
        the start of the first fit, which is replaced by its result. Those of the previous frame save most of the time;
        the coefficients do not depend on them.
        """
        values = observed[:, self._known]
        return self._finished(self._fit(values, self._single, 2, near), values)

    def fitted_take(self, observed: FloatArray) -> FloatArray:
        """Fit the coefficients of a take as `fitted_frames` does, but without the error of its neutral face.

        Alternates between the coefficients of some frames and the error (equation 9.5).
        """
        values = observed[:, self._known]
        # Equation 9.5 in turns. The mean of n independent frames knows the error e of the neutral face with precision n
        # W, the prior with B: e = (n W + B)^-1 n W (mean of what the coefficients leave).
        some = values[np.unique(np.linspace(0, len(values) - 1, min(_SAMPLE, len(values))).astype(np.intp))]
        weighed = min(_INDEPENDENT, len(values)) * self._within
        correct, error = linalg.solve(weighed + self._between, weighed), np.zeros(values.shape[1])
        for _ in range(_ROUNDS):
            found = self._fit(some - error, self._at_first, 1)
            # Calm frames say most about the neutral face.
            trust = 1.0 / (_CALM + found.sum(axis=1))
            error = correct @ (trust @ (some - found @ self._responses) / trust.sum())
        return self._finished(self._fit(values - error, self._calibrated, 2), values - error)

    def corrected(self, fitted: FloatArray) -> FloatArray:
        """Add what a fit (N, D + 44) lacks (equation 9.6), if the actions are known: coefficients (N, 44), 0 to 1."""
        found = fitted[:, -len(FITTED) :]
        if not self._correction or not self._known.all():
            return found
        # What the network adds to a face at rest is subtracted, so that rest stays at 0.
        found = np.clip(found + self._lacking(fitted) - self._at_rest, 0.0, 1.0)
        # The sum may show both of a pair, such as the jaw to both sides, or lips shut further than the jaw is open.
        weaker = _PLACES[np.arange(len(_PLACES)), found[:, _PLACES].argmin(axis=2)]
        np.put_along_axis(found, weaker, 0.0, axis=1)
        found[:, CLOSES] = np.minimum(found[:, CLOSES], found[:, OPENS])
        return found

    def _lacking(self, fitted: FloatArray) -> FloatArray:
        """Output of the network, (N, 44), the same for both sides."""
        observed, found = fitted[:, :N_OBSERVED], fitted[:, N_OBSERVED:]
        flipped = np.concatenate([mirrored(observed), found[:, _ACROSS]], axis=1)
        return 0.5 * (_output(self._correction, fitted) + _output(self._correction, flipped)[:, _ACROSS])

    def _fitting(self, precision: FloatArray) -> _Fitting:
        """Prepare fits with a precision matrix (D, D) of the known values."""
        # R P y and R P R^T of the normal equations, for responses R and the precision P.
        readout = self._responses @ precision
        gram = readout @ self._responses.T
        return _Fitting(np.ascontiguousarray(readout.T), 0.5 * (gram + gram.T))

    def _fit(self, values: FloatArray, by: _Fitting, rounds: int, near: FloatArray | None = None) -> FloatArray:
        """Fit coefficients, (N, 44), to known values (N, D), reweighted `rounds` times (equations 9.3 and 9.4)."""
        gram, products = by.gram, multiply(values, by.readout)
        count = len(gram)
        lower, upper = np.zeros(count), np.ones(count)
        # Equation 9.3, whose penalty shrinks all coefficients; then rounds of equation 9.4, in which the result a_0 of
        # the last round sets the penalty (a / (a_0 + s))^2: it presses weak ones to 0 and hardly shrinks strong ones.
        found = bounded_least_squares(gram + self._model.together, products - _SPARSITY, lower, upper, near)
        if near is not None:
            near[:] = found
        gram = gram + _TOGETHER * self._model.together
        for _ in range(rounds):
            for a, product in zip(found, products, strict=True):
                penalty = _SHARPNESS / np.square(a + _SMALL)
                weaker = _weaker(a)
                penalty[weaker], a[weaker] = _EXCLUDED, 0.0
                a[:] = bounded_minimum(gram + np.diag(penalty), product, lower, upper, a)
        return found

    def _finished(self, found: FloatArray, values: FloatArray) -> FloatArray:
        """Let the lips be as far apart as observed, by mouthClose, which cannot exceed jawOpen; scale; append."""
        # The gap is linear in the coefficients, and mouthClose changes it by gap[CLOSES], which is negative.
        gap = LIP_GAP @ self._responses[:, : 3 * N_LANDMARKS].T
        apart = found @ gap - values[:, : 3 * N_LANDMARKS] @ LIP_GAP
        closed = found[:, CLOSES] + apart / -gap[CLOSES]
        found[:, CLOSES] = np.clip(closed, 0.0, found[:, OPENS])
        return np.concatenate([values, np.clip(found * self._model.gains, 0.0, 1.0)], axis=1)


def mirrored(observed: FloatArray) -> FloatArray:
    """Return the observations (N, 213) of faces that are flipped left to right."""
    shape, actions = observed[:, : 3 * N_LANDMARKS], observed[:, 3 * N_LANDMARKS :]
    shape = shape.reshape(-1, N_LANDMARKS, 3)[:, MIRROR] * [-1.0, 1.0, 1.0]
    return np.concatenate([shape.reshape(len(shape), -1), actions[:, ACTION_MIRROR]], axis=1)


def _output(layers: Sequence[Layer], x: FloatArray) -> FloatArray:
    """Output of a network for inputs (N, I)."""
    for layer in layers[:-1]:
        x = np.maximum(multiply(x, layer.weights) + layer.offsets, 0.0)
    return np.asarray(multiply(x, layers[-1].weights) + layers[-1].offsets)


def _weaker(found: FloatArray) -> NDArray[np.intp]:
    """Positions, among the coefficients (44,), of the weaker ones of exclusive pairs of which one is present."""
    present = _PLACES[found[_PLACES].max(axis=1) > 0.0]
    return np.asarray(present[np.arange(len(present)), np.argmin(found[present], axis=1)])


def has_actions(observed: FloatArray) -> NDArray[np.bool_]:
    """Whether the activations of observations (N, 213) are known, (N,); the landmarks always are."""
    return np.asarray(np.isfinite(observed[:, 3 * N_LANDMARKS :]).all(axis=1))

"""Learning of the model of `core.bake.coefficients` from observations, symmetric between left and right."""

from __future__ import annotations

import numpy as np

from facemime.core.bake.coefficients import FORMAT, N_OBSERVED, CoefficientModel, CoefficientSolver, Spread
from facemime.core.bake.coefficients import mirrored as mirrored_observations
from facemime.core.face.landmarks import N_LANDMARKS
from facemime.core.face.names import ACTIONS, COEFFICIENT_INDEX, COEFFICIENT_MIRROR, FITTED

from ..head.build import to_bytes
from .script import random_moment
from .simulate import Observed

_SHAPE = 3 * N_LANDMARKS
_EXPECTED = 0.8
"""Expected activation at coefficient 1 before any observation."""
_RIDGE, _LOYALTY = 3.0, 20.0
"""Ridge of the simulated responses, and number of frames that they count as, compared with rendered ones."""
_UNLIKENESS = 0.1
"""Weight of the differences between simulated faces in the covariance. Most of them occur in rendered faces already."""
_FLOORS = np.where(np.arange(N_OBSERVED) < _SHAPE, 0.003, 0.2)
"""Standard deviations that are added, as models are wrong, and activations of real faces vary more than rendered
ones."""
_NEUTRAL_FLOORS = np.where(np.arange(N_OBSERVED) < _SHAPE, 0.005, 0.2)
"""The same for the neutral face's error, as other people are mistaken for other expressions."""
_MODES, _NEUTRAL_MODES = 60, 30
_EXPRESSIONS, _RARE, _LASTING = 4000, 3e-4, 0.5
"""Number of random expressions that the prior is learnt from, mean square of coefficients that are never shown, and
share of the squares in a performance, which is often at rest."""
_MAX_GAIN = 1.5


def learn(rendered: list[Observed], simulated: list[Observed], rng: np.random.Generator) -> CoefficientModel:
    """Learn the model from rendered performances, one per person, and observations of families of simulated faces.

    The fit is not corrected yet; see `lab.training.coefficients.correction`.
    """
    takes = [side for take in rendered for side in (take, mirrored(take))]
    both = joined([side for family in simulated for side in (family, mirrored(family))])
    expected = np.zeros((len(FITTED), N_OBSERVED))
    expected[:, :_SHAPE] = shape_responses(both)
    for column, name in enumerate(ACTIONS):
        expected[np.flatnonzero(COEFFICIENT_INDEX[_coefficient(name)] == FITTED)[0], _SHAPE + column] = _EXPECTED
    seen = joined(takes)
    responses = expected + _regression(seen.keys, seen.values - seen.keys[:, FITTED] @ expected, _LOYALTY)
    errors = [take.values - take.keys[:, FITTED] @ responses for take in takes]
    means = np.array([each.mean(axis=0) for each in errors])
    within = np.concatenate([each - mean for each, mean in zip(errors, means, strict=True)])
    frame = within.T @ within / len(within)
    unlike = both.values[:, :_SHAPE] - both.keys[:, FITTED] @ responses[:, :_SHAPE]
    frame[:_SHAPE, :_SHAPE] += _UNLIKENESS * unlike.T @ unlike / len(unlike)
    frame += np.diag(np.square(_FLOORS))
    neutral = means.T @ means / len(means) + np.diag(np.square(_NEUTRAL_FLOORS))
    spreads = spread(frame, _MODES), spread(neutral, _NEUTRAL_MODES)
    model = CoefficientModel(responses, *spreads, _together(rng), np.ones(len(FITTED)))
    return CoefficientModel(responses, *spreads, model.together, _gains(model, takes))


def mirrored(observed: Observed) -> Observed:
    """Observations of the faces flipped left to right."""
    return Observed(mirrored_observations(observed.values), observed.keys[:, COEFFICIENT_MIRROR])


def shape_responses(simulated: Observed) -> np.ndarray:
    """Displacements (44, 198) of each coefficient, by regression on simulated faces."""
    return _regression(simulated.keys, simulated.values[:, :_SHAPE], _RIDGE)


def spread(covariance: np.ndarray, count: int) -> Spread:
    """Approximate a covariance by `count` modes, relative to the deviations, and the remainder of its diagonal."""
    deviations = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(deviations, deviations))
    values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    vectors = vectors * np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(count)])
    modes = (vectors * np.sqrt(np.maximum(values, 0.0))).T * deviations
    left = np.square(deviations) - np.square(modes).sum(axis=0)
    return Spread(modes, np.sqrt(np.maximum(left, 0.02 * np.square(deviations))))


def model_bytes(model: CoefficientModel) -> bytes:
    """Return the content of the file."""
    arrays = {
        "responses": model.responses,
        "frame.modes": model.frame.modes,
        "frame.rest": model.frame.rest,
        "neutral.modes": model.neutral.modes,
        "neutral.rest": model.neutral.rest,
        "together": model.together,
        "gains": model.gains,
        **{f"correction.{i}.weights": layer.weights for i, layer in enumerate(model.correction)},
        **{f"correction.{i}.offsets": layer.offsets for i, layer in enumerate(model.correction)},
    }
    return to_bytes({"format": np.array(FORMAT), **{name: array.astype(np.float32) for name, array in arrays.items()}})


def joined(parts: list[Observed]) -> Observed:
    """Observations of all parts, one after the other."""
    return Observed(np.concatenate([part.values for part in parts]), np.concatenate([part.keys for part in parts]))


def _regression(keys: np.ndarray, values: np.ndarray, ridge: float) -> np.ndarray:
    """Coefficients (44, D) of the regression of values (N, D) on the fitted ones of keys (N, 52)."""
    shown = keys[:, FITTED]
    return np.linalg.solve(shown.T @ shown + ridge * np.eye(len(FITTED)), shown.T @ values)


def _coefficient(action: str) -> str:
    if action in COEFFICIENT_INDEX:
        return action
    return action.removesuffix("Left").removesuffix("Right")


def _together(rng: np.random.Generator) -> np.ndarray:
    """Inverse of the mean products of two coefficients, (44, 44)."""
    keys = np.array([random_moment(rng) for _ in range(_EXPRESSIONS)])
    keys = np.concatenate([keys, keys[:, COEFFICIENT_MIRROR]])[:, FITTED]
    inverse = np.linalg.inv(_LASTING * keys.T @ keys / len(keys) + _RARE * np.eye(len(FITTED)))
    return 0.5 * (inverse + inverse.T)


def _gains(model: CoefficientModel, takes: list[Observed]) -> np.ndarray:
    """Factors from found to acted coefficients, (44,), by least squares over all frames."""
    solver = CoefficientSolver(model)
    found = np.concatenate([solver.take(take.values) for take in takes])
    acted = joined(takes).keys[:, FITTED]
    ratio = (found * acted).sum(axis=0) / np.maximum(np.square(found).sum(axis=0), 1e-6)
    return np.clip(ratio, 1.0, _MAX_GAIN)

"""The network that corrects the fit of coefficients learns what the fit lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed; `make coefficients` does it")

from facemime.core.bake.coefficients import N_OBSERVED, CoefficientSolver, load_coefficient_model
from facemime.core.face.landmarks import N_LANDMARKS
from facemime.core.face.names import FITTED
from lab.training.coefficients.correction import learn_correction
from lab.training.coefficients.script import random_expression
from lab.training.coefficients.simulate import Observed

FIT = replace(load_coefficient_model(), correction=())
KNOWN = np.random.default_rng(3).normal(0.0, 0.2, (N_OBSERVED, N_OBSERVED))


def warped(count: int, seed: int) -> Observed:
    """Observations that bend with the coefficients, which a fit of sums cannot follow."""
    rng = np.random.default_rng(seed)
    keys = np.array([random_expression(rng) for _ in range(count)])
    straight = keys[:, FITTED] @ FIT.responses
    return Observed(straight + 0.5 * np.tanh(straight @ KNOWN) + rng.normal(0.0, 0.004, straight.shape), keys)


def test_unseen_observations_that_bend_are_found_better_than_by_the_fit():
    performances = [warped(150, seed) for seed in range(12)]
    layers = learn_correction(FIT, performances, np.zeros((len(FITTED), 3 * N_LANDMARKS)), np.random.default_rng(1))
    unseen = warped(200, 99)
    errors = [
        np.abs(CoefficientSolver(model).frames(unseen.values) - unseen.keys[:, FITTED]).mean()
        for model in (replace(FIT, correction=layers), FIT)
    ]
    assert errors[0] < 0.8 * errors[1]

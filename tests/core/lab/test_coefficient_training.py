"""Training of the model of coefficients recovers a known model, equally on both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.coefficients import COEFFICIENT_FILE, HIDDEN, N_OBSERVED, load_coefficient_model
from facemime.core.face.landmarks import N_LANDMARKS, from_ibug
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, FITTED
from facemime.core.tracking.tracker import FaceTracker
from lab.training.coefficients.learn import learn, mirrored, model_bytes, spread
from lab.training.coefficients.script import random_expression
from lab.training.coefficients.simulate import Observed, built_in_face, simulate


def acted(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([random_expression(rng) for _ in range(count)])


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), modes=st.integers(1, N_OBSERVED))
def test_a_spread_keeps_the_variances_and_at_least_some_of_each(seed, modes):
    factors = np.random.default_rng(seed).normal(size=(300, N_OBSERVED)) * np.linspace(0.001, 1.0, N_OBSERVED)
    covariance = factors.T @ factors / len(factors)
    kept = np.diag(spread(covariance, modes).matrix())
    assert (kept >= 0.999 * np.diag(covariance)).all() and (kept <= 1.03 * np.diag(covariance)).all()


def test_mirroring_observations_twice_restores_them():
    rng = np.random.default_rng(1)
    observed = Observed(rng.normal(size=(5, N_OBSERVED)), rng.random((5, len(COEFFICIENTS))))
    twice = mirrored(mirrored(observed))
    np.testing.assert_allclose(twice.values, observed.values)
    np.testing.assert_array_equal(twice.keys, observed.keys)
    assert (
        mirrored(observed).keys[:, COEFFICIENT_INDEX["jawLeft"]] == observed.keys[:, COEFFICIENT_INDEX["jawRight"]]
    ).all()


@pytest.mark.thorough
def test_responses_of_a_known_model_are_learnt_and_read_back(tmp_path):
    known, rng = load_coefficient_model(), np.random.default_rng(4)
    parts = []
    for seed, count in enumerate((120, 120, 2000)):
        keys = acted(count, seed)
        parts.append(Observed(keys[:, FITTED] @ known.responses + rng.normal(0.0, 0.004, (count, N_OBSERVED)), keys))
    model = replace(learn(parts[:2], parts[2:], np.random.default_rng(2)), correction=known.correction)
    shapes = slice(0, 3 * N_LANDMARKS)  # for activations, what is expected of them counts as well
    away = np.linalg.norm((model.responses - known.responses)[:, shapes])
    assert away < 0.2 * np.linalg.norm(known.responses[:, shapes])
    (tmp_path / "model.npz").write_bytes(model_bytes(model))
    read = load_coefficient_model(tmp_path / "model.npz")
    np.testing.assert_allclose(read.responses, model.responses, atol=1e-6)
    assert model_bytes(read) == model_bytes(model)


def test_the_shipped_model_is_read_whole_and_written_as_it_was():
    assert len(load_coefficient_model().correction) == len(HIDDEN) + 1
    assert model_bytes(load_coefficient_model()) == COEFFICIENT_FILE.read_bytes()


def test_a_simulated_face_follows_its_script():
    rng = np.random.default_rng(0)
    observed = simulate([built_in_face(rng) for _ in range(2)], FaceTracker.load().pdm, 24, rng)
    assert observed.values.shape == (48, N_OBSERVED) and np.isnan(observed.values[:, 198:]).all()
    moved = observed.values[:, :198].reshape(-1, 66, 3)
    raised = -moved[:, from_ibug((21, 22)), 1].mean(axis=1)
    assert np.corrcoef(raised, observed.keys[:, COEFFICIENT_INDEX["browInnerUp"]])[0, 1] > 0.7
    assert observed.keys[::8].max() == pytest.approx(0.0)

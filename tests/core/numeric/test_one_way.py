"""Minima of which one of two opposite variables is 0."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.numeric.least_squares import bounded_minimum


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(0, 6), st.floats(0.0, 0.99))
def test_only_one_of_two_opposite_variables_is_used_and_no_variable_gains_by_moving(seed, pairs, single, alike):
    rng = np.random.default_rng(seed)
    count = 2 * pairs + single
    matrix = rng.normal(size=(count + 3, count)) + alike * 5.0 * rng.normal(size=(count + 3, 1))
    gram, product = matrix.T @ matrix + 1e-3 * np.eye(count), matrix.T @ rng.normal(size=count + 3)
    opposite = np.full(count, -1)
    opposite[: 2 * pairs] = np.arange(2 * pairs) ^ 1
    lower = np.where(opposite >= 0, 0.0, -rng.uniform(0.0, 0.5, count))
    upper = lower + rng.uniform(0.05, 2.0, count)
    x = bounded_minimum(gram, product, lower, upper, np.zeros(count), opposite)
    assert (x >= lower).all() and (x <= upper).all()
    used = (opposite >= 0) & (x[opposite] > 0.0)
    assert not (used & (x > 0.0)).any()
    slope = gram @ x - product
    gain = np.where(x < upper, -slope, 0.0), np.where(x > lower, slope, 0.0)
    gain[0][used] = 0.0
    assert np.max(gain) <= 1e-7 * (np.abs(gram).max() + np.abs(product).max())


@pytest.mark.parametrize("start", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
def test_the_direction_that_gains_is_taken_from_any_start(start):
    gram = np.array([[1.0, -0.9], [-0.9, 1.0]])
    x = bounded_minimum(gram, np.array([-0.2, 0.7]), np.zeros(2), np.full(2, np.inf), np.array(start), np.array([1, 0]))
    np.testing.assert_allclose(x, (0.0, 0.7), atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_variables_whose_bounds_are_equal_stay_and_the_others_are_at_the_minimum(seed, count):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(count + 3, count))
    gram, product = matrix.T @ matrix, matrix.T @ rng.normal(size=count + 3)
    fixed = rng.random(count) < 0.4
    lower = rng.uniform(-0.5, 0.5, count)
    upper = np.where(fixed, lower, lower + 1.0)
    x = bounded_minimum(gram, product, lower, upper, rng.uniform(-1.0, 1.0, count))
    rest = product[~fixed] - gram[np.ix_(~fixed, fixed)] @ lower[fixed]
    others = bounded_minimum(gram[np.ix_(~fixed, ~fixed)], rest, lower[~fixed], upper[~fixed], lower[~fixed])
    np.testing.assert_array_equal(x[fixed], lower[fixed])
    np.testing.assert_allclose(x[~fixed], others, atol=1e-6)

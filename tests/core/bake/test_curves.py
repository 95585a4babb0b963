"""Curves with few keyframes: within their error of the motion, with peaks where they are, inside their range."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.curves import _Fit, fit_curves, fit_key_curves, stops_of
from facemime.core.heads.built_in import load_head


def _wandering(seed: int, frames: int, keys: int) -> np.ndarray:
    """Smooth random curves (N, K) from 0 to 1, often at an end of that, with some noise."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(frames, keys)).cumsum(axis=0) / 6.0
    return np.clip(steps + 0.01 * rng.normal(size=steps.shape), 0.0, 1.0)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    frames=st.integers(1, 300),
    keys=st.integers(1, 6),
    tolerance=st.floats(1e-4, 0.2),
)
def test_curves_stay_within_the_error_of_the_mesh_and_their_range(seed, frames, keys, tolerance):
    values = _wandering(seed, frames, keys)
    offsets = np.random.default_rng(seed).normal(size=(keys, 7, 3))
    curves = fit_key_curves(values, offsets, tolerance, np.zeros(keys), np.ones(keys))
    rows = np.arange(frames, dtype=float)
    off = np.einsum("nk,kvc->nvc", np.column_stack([curve.at(rows) for curve in curves]) - values, offsets)
    assert np.linalg.norm(off, axis=2).max() <= tolerance * 1.0001
    between = np.linspace(0.0, frames - 1.0, 7 * frames)
    for curve in curves:
        assert curve.rows[0] == 0 and curve.rows[-1] == frames - 1 and (np.diff(curve.rows) > 0).all()
        assert curve.at(between).min() > -1e-9 and curve.at(between).max() < 1.0 + 1e-9


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(2, 200), tolerance=st.floats(1e-3, 0.2))
def test_peaks_are_keyframes_with_their_value(seed, frames, tolerance):
    values = _wandering(seed, frames, 1)
    stops = stops_of(values[:, 0], 3.0 * tolerance)
    (curve,) = fit_curves(values, np.array([tolerance]), [stops], np.zeros(1), np.ones(1))
    assert set(stops) <= set(curve.rows)
    assert np.allclose(curve.at(stops.astype(float)), values[stops, 0])


def test_a_blink_has_keyframes_where_it_starts_and_ends_and_shuts_in_its_frame():
    blink = np.zeros(60)
    blink[20:27] = [0.3, 0.8, 1.0, 1.0, 0.9, 0.5, 0.2]
    (curve,) = fit_key_curves(blink[:, None], np.full((1, 4, 3), 0.1), 0.005, [0.0], [1.0])
    assert {19, 22, 23, 27} <= set(curve.rows)
    assert curve.at(np.array([22.0, 23.0])).tolist() == [1.0, 1.0]
    assert np.abs(curve.at(np.arange(20.0))).max() < 1e-9


def test_a_flat_curve_has_two_keyframes_and_a_single_frame_one():
    flat, single = np.full((700, 1), 0.3), np.full((1, 1), 0.7)
    offsets = np.ones((1, 4, 3))
    (curve,) = fit_key_curves(flat, offsets, 0.01, [0.0], [1.0])
    assert curve.rows.tolist() == [0, 699] and curve.at(np.arange(700.0)).tolist() == [0.3] * 700
    (curve,) = fit_key_curves(single, offsets, 0.01, [0.0], [1.0])
    assert curve.rows.tolist() == [0] and curve.at(np.array([0.0])).tolist() == [0.7]


def test_a_key_that_moves_nothing_keeps_its_values_for_other_programs():
    swing = 0.5 + 0.5 * np.sin(np.linspace(0.0, 20.0, 200))
    (curve,) = fit_key_curves(swing[:, None], np.zeros((1, 4, 3)), 0.01, [0.0], [1.0])
    assert np.abs(curve.at(np.arange(200.0)) - swing).max() < 0.15


def test_handles_describe_the_same_curve_as_bezier_segments():
    values = _wandering(3, 120, 1)
    (curve,) = fit_key_curves(values, np.full((1, 4, 3), 0.2), 0.01, [0.0], [1.0])
    left, right = curve.handles()
    points = np.column_stack([curve.rows, curve.values])
    s = np.linspace(0.0, 1.0, 9)[:, None]
    for first in range(len(points) - 1):
        ends = points[first], right[first], left[first + 1], points[first + 1]
        drawn = sum(factor * end for factor, end in zip(_bernstein(s), ends, strict=True))
        assert np.allclose(curve.at(drawn[:, 0]), drawn[:, 1], atol=1e-9)


def _bernstein(s: np.ndarray) -> tuple[np.ndarray, ...]:
    return (1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3


@pytest.mark.parametrize("tolerance", [0.003, 0.01])
def test_a_smooth_performance_has_many_times_fewer_keyframes_than_frames(tolerance):
    head = load_head()
    times = np.arange(300.0)
    values = 0.5 + 0.5 * np.sin(times[:, None] / (8.0 + np.arange(52)) + np.arange(52))
    curves = fit_key_curves(values, head.units, tolerance * 0.09, np.zeros(52), np.ones(52))
    assert sum(len(curve.rows) for curve in curves) < 52 * 300 / 6


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 4))
def test_what_is_fitted_again_where_tolerances_shrink_is_the_same_as_from_the_start(seed, rounds):
    rng, values = np.random.default_rng(seed), _wandering(seed, 300, 3)
    stops = [stops_of(column, 0.2) for column in values.T]
    tolerances = np.full_like(values, 0.03)
    again = _Fit(values, stops, np.zeros(3), np.ones(3))
    again.renew(tolerances, np.ones(len(again.spans), dtype=bool))
    for _ in range(rounds):
        shrunk = rng.random(values.shape) < 0.01
        tolerances = np.where(shrunk, 0.3 * tolerances, tolerances)
        again.renew(tolerances, again.spans_with(shrunk))
    for one, other in zip(again.curves(), fit_curves(values, tolerances, stops, np.zeros(3), np.ones(3)), strict=True):
        np.testing.assert_array_equal(one.rows, other.rows)
        np.testing.assert_allclose(one.slopes, other.slopes, atol=1e-7)

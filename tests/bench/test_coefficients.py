"""The benchmark of coefficients: its measures and its random scripts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, EXCLUSIVE, FITTED
from lab.bench.coefficients import Performed, rows_of, summary
from lab.training.coefficients.script import random_expression, random_script, script_at

JAW, SMILE, LOOK = (COEFFICIENT_INDEX[name] for name in ("jawOpen", "mouthSmileLeft", "eyeLookUpLeft"))


def performed() -> Performed:
    """Ten frames of an opening jaw that is found by half, and four with a smile and a gaze that were not acted."""
    acted, found = (np.zeros((10, len(COEFFICIENTS))) for _ in range(2))
    acted[:, JAW] = np.arange(10) / 10.0
    found[:, JAW] = 0.5 * acted[:, JAW]
    found[6:, SMILE] = found[6:, LOOK] = 0.4
    return Performed(acted, found)


def test_measures_cover_acted_coefficients_and_frames_but_not_the_direction_of_the_eyes():
    name, frames, correlation, error, spurious = summary("clip", performed())
    assert (name, frames) == ("clip", 10)
    assert correlation == pytest.approx(1.0)
    assert error == pytest.approx(0.5 * np.mean(np.arange(1, 10) / 10.0))
    assert spurious == pytest.approx(0.4)


def test_each_coefficient_has_a_row_with_empty_cells_if_it_was_not_acted():
    rows = {row[0]: row[1:] for row in rows_of({"clip": performed()})}
    assert list(rows) == [COEFFICIENTS[k] for k in FITTED]
    assert rows["mouthSmileLeft"] == ["", "", pytest.approx(0.4)]
    assert rows["jawOpen"][2] == 0.0


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_expressions_are_possible(seed):
    keys = random_expression(np.random.default_rng(seed))
    assert keys.max() > 0.0 and keys.min() >= 0.0 and keys.max() <= 1.0
    assert not keys[EXCLUSIVE[:2]].min(axis=1).any()
    assert not (keys[COEFFICIENT_INDEX["cheekPuff"]] and keys[JAW])


def test_a_script_begins_at_rest_and_is_the_same_each_time():
    one, other = (random_script(8.0, np.random.default_rng(3)) for _ in range(2))
    assert not script_at(one, 0.9).any() and script_at(one, 0.5 * (one[0].start + one[0].end)).any()
    np.testing.assert_array_equal(script_at(one, 4.0), script_at(other, 4.0))

"""ARKit's keys are refined by takes: they move a head more as its performer does, and stay what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.bake.expression_keys import expression_keys, refined_keys
from facemime.core.bake.key_quality import findings, key_qualities
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import SourceError
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.neutral import calibrate
from tests.helpers.takes import performance

KEYS = KEY_SETS["arkit"]


@pytest.fixture(scope="module")
def made() -> np.ndarray:
    return expression_keys(built_in_head())[1]


@pytest.fixture(scope="module")
def refined() -> np.ndarray:
    take = performance()
    return expression_keys(built_in_head(), refine=lambda skin, made: refined_keys(skin, KEYS.names, made, [take]))[1]


def missed(keys: np.ndarray) -> float:
    """Mean distance of the vertices moved by keys from those of the driven head, over all frames of a take."""
    take, rig = performance(), built_in_head()
    neutral = calibrate(take)
    amounts = arkit_coefficients(take, neutral)[:, [COEFFICIENTS.index(name) for name in KEYS.names]]
    driver = HeadDriver(rig, neutral)
    frames = [driver.frame(take.result(int(row))).vertices - driver.rest for row in np.flatnonzero(take.found)]
    shown = np.tensordot(amounts, keys.astype(np.float64), 1)
    return float(np.linalg.norm(shown - np.array(frames), axis=2).mean())


def test_refined_keys_reproduce_the_motion_of_a_take_better(made, refined):
    assert missed(refined) < 0.85 * missed(made)


def test_blinks_gaze_and_still_keys_stay_as_they_were(made, refined):
    kept = [name.startswith(("eyeBlink", "eyeLook")) for name in KEYS.names]
    still = ~made.any(axis=(1, 2))
    assert sum(kept) == 10 and still.any()
    np.testing.assert_array_equal(refined[kept | still], made[kept | still])
    assert np.abs(refined - made).max() > 0.001


def test_lids_and_lips_of_refined_keys_still_meet_without_passing_through_each_other(refined):
    qualities = key_qualities(built_in_head(), KEYS, refined)
    assert max(quality.crossing for quality in qualities) <= 8, findings(qualities)
    assert max(quality.eyes for quality in qualities if not np.isnan(quality.eyes)) < 0.05
    assert max(quality.lips for quality in qualities if not np.isnan(quality.lips)) < 0.03


def test_without_takes_the_keys_stay_as_they_were(made):
    np.testing.assert_array_equal(refined_keys(built_in_head(), KEYS.names, made, []), made)


def test_a_take_without_a_face_cannot_refine_keys(made):
    take = performance()
    with pytest.raises(SourceError, match="No face"):
        refined_keys(built_in_head(), KEYS.names, made, [replace(take, found=np.zeros(len(take), bool))])

"""Takes at other times stay in sync with the media, and no motion is invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.errors import SourceError
from facemime.core.face.rotation import euler_to_matrix, mix_rotations
from facemime.core.takes.take import FIELDS, Take, check_take
from facemime.core.takes.timing import mix, project, punch_in, resample, sample, shift_time, trim
from tests.helpers.takes import make_take, performance

ANGLES = st.tuples(*[st.floats(-1.2, 1.2)] * 3).map(np.array)


def moving(times: np.ndarray) -> Take:
    """A face that moves to the right by 10 pixels per second and turns by 0.01 per second, at `times`."""
    rest = performance(2).shape[0].astype(float)
    count = len(times)
    pose = np.tile([100.0, 0.0, 0.0, 0.0, 320.0, 240.0], (count, 1))
    pose[:, 2], pose[:, 4] = 0.01 * times, 320.0 + 10.0 * times
    take = make_take(np.tile(rest, (count, 1, 1)), 30.0, pose)
    return replace(take, times=times, landmarks=project(take.shape, pose).astype(np.float32))


def equal(a: Take, b: Take) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@settings(max_examples=50)
@given(ANGLES, ANGLES, st.floats(0, 1))
def test_an_interpolated_rotation_has_its_share_of_the_angle(a, b, share):
    middle = mix_rotations(a[None], b[None], np.array([share]))[0]
    r0, r1, r = (euler_to_matrix(*angles) for angles in (a, b, middle))

    def angle(turn):
        return np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))

    whole = angle(r0.T @ r1)
    if whole < 3.0:  # half a turn away, the short way is either
        np.testing.assert_allclose(angle(r0.T @ r), share * whole, atol=1e-6)
        np.testing.assert_allclose(angle(r.T @ r1), (1.0 - share) * whole, atol=1e-6)


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 60.0, 24000 / 1001])
def test_a_clip_of_3841_frames_at_2997_stays_in_sync_to_the_last_frame(rate):
    take = moving(np.arange(3841) * 1001 / 30000)
    even = resample(take, rate)
    np.testing.assert_allclose(np.diff(even.times), 1.0 / rate)
    assert 0.0 <= take.times[-1] - even.times[-1] < 1.0 / rate + 1e-6
    np.testing.assert_allclose(even.pose[:, 4], 320.0 + 10.0 * even.times, atol=1e-6)
    np.testing.assert_allclose(even.pose[:, 2], 0.01 * even.times, atol=1e-9)
    expected = project(even.shape, even.pose)
    np.testing.assert_allclose(even.landmarks, expected, atol=2e-3)
    assert even.found.all() and even.info["fps"] == rate
    check_take(even)


@settings(max_examples=40)
@given(st.integers(0, 1000), st.floats(5.0, 120.0), st.floats(-1.0, 0.5))
def test_frames_at_a_variable_rate_are_placed_by_their_times(seed, rate, start):
    times = np.cumsum(np.random.default_rng(seed).uniform(0.03, 0.05, 60))
    even = resample(moving(times), rate, start)
    inside = (even.times >= times[0]) & (even.times <= times[-1])
    assert even.times[0] == start and even.found[inside].all()
    np.testing.assert_allclose(even.pose[inside, 4], 320.0 + 10.0 * even.times[inside], atol=1e-6)
    assert not even.found[even.times < times[0] - 0.03].any()


def test_sampling_a_take_at_its_own_times_changes_nothing():
    take = performance()
    equal(sample(take, take.times), take)


def test_lost_frames_stay_lost_and_missing_ones_are_not_interpolated():
    take = performance()
    dense = resample(take, 100.0)
    lost = dense.times[~dense.found]
    np.testing.assert_allclose([lost.min(), lost.max()], [1.19, 1.22])
    whole = moving(np.arange(100) / 25.0)
    holed = whole.part((np.arange(100) < 40) | (np.arange(100) >= 60))
    lost = (even := resample(holed, 25.0)).times[~even.found]
    np.testing.assert_allclose([lost.min(), lost.max()], [1.6, 2.36])


def test_impossible_rates_and_starts_are_refused():
    for rate in (0.0, -5.0, np.nan, 1e6):
        with pytest.raises(SourceError, match="cannot be"):
            resample(performance(), rate)
    with pytest.raises(SourceError, match="earlier start"):
        resample(performance(), 25.0, 99.0)


def test_shifting_back_and_forth_and_trimming_to_length_change_nothing():
    take = performance()
    np.testing.assert_allclose(shift_time(shift_time(take, 2.5), -2.5).times, take.times, atol=1e-12)
    equal(trim(take), take)
    part = trim(take, 0.4, 0.8)
    assert (part.times[0], part.times[-1], len(part)) == (0.4, 0.8, 11)
    with pytest.raises(SourceError, match=r"Use times from 0\.00 s to 2\.36 s"):
        trim(take, 5.0, 6.0)


def test_a_punched_in_part_replaces_its_span_and_blends_at_both_ends():
    take = moving(np.arange(100) / 25.0)
    other = shift_time(moving(np.arange(50) / 30.0), 1.0)
    other = replace(other, shape=other.shape + np.float32(0.1), landmarks=other.landmarks + 10)
    out = punch_in(take, other, 1.2, 2.4, blend=0.3)
    check_take(out)
    changed = np.abs(out.shape - take.shape[0]).max(axis=(1, 2))
    assert (changed[out.times < 1.2] == 0).all() and (changed[out.times > 2.4] == 0).all()
    inside = (out.times >= 1.5) & (out.times <= 2.1)
    np.testing.assert_allclose(changed[inside], 0.1, atol=1e-6)
    edge = (out.times >= 1.2) & (out.times <= 1.5)
    np.testing.assert_allclose(changed[edge], 0.1 * (out.times[edge] - 1.2) / 0.3, atol=1e-6)
    assert out.info["punched_in"] == [[1.2, 2.4]] and out.found.all()
    assert np.isfinite(out.shape_params).all()


def test_a_part_that_is_punched_in_without_a_blend_is_complete():
    take = moving(np.arange(90) / 30.0)
    other = replace(take, shape=take.shape + np.float32(0.1))
    out = punch_in(take, other, float(take.times[30]), float(take.times[50]), blend=0.0)
    changed = np.abs(out.shape - take.shape).max(axis=(1, 2)) > 0.05
    np.testing.assert_array_equal(np.flatnonzero(changed), np.arange(30, 51))


def test_punching_in_uses_the_take_that_has_a_face():
    take, other = performance(), performance()
    for array in (other.shape, other.pose, other.landmarks):
        array[10] = np.nan
    other.found[10] = False
    out = punch_in(take, other, 0.2, 2.0, blend=0.4)
    assert out.found.tolist() == [i != 30 for i in range(60)]
    of_another_model = replace(other, shape_params=np.zeros((60, 9), np.float32))
    assert np.isnan(punch_in(take, of_another_model, 0.2, 2.0).shape_params[20]).all()


def test_mixing_by_zero_or_one_keeps_a_frame_even_if_the_other_is_lost():
    take = performance()
    gone = take.part(np.full(60, 30))
    equal(mix(take, gone, np.zeros(60)), take)
    equal(replace(mix(gone, take, np.ones(60)), times=take.times), take)
    assert not mix(take, gone, np.full(60, 0.5)).found.any()

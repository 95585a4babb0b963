"""Motion on whole frames: in its range, with its peaks, and turned on the sphere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.whole_frames import curves_at, motion_at, whole_frames
from facemime.core.drive.driver import HeadMotion
from facemime.core.face.rotation import euler_to_matrix


def test_whole_frames_contain_the_take():
    assert whole_frames(np.array([1.0, 1.96, 2.92])).tolist() == [1.0, 2.0, 3.0]
    assert whole_frames(np.array([0.5, 1.5, 2.5, 3.0000000001])).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert whole_frames(np.array([4.0])).tolist() == [4.0]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 80), rate=st.floats(0.3, 3.0))
def test_curves_stay_within_their_values(seed, count, rate):
    rng = np.random.default_rng(seed)
    frames, values = 1.0 + rate * np.arange(count), rng.uniform(size=(count, 3))
    found = curves_at(frames, values, whole_frames(frames))
    assert found.shape == (len(whole_frames(frames)), 3)
    assert (found >= values.min(axis=0) - 1e-12).all() and (found <= values.max(axis=0) + 1e-12).all()


def test_frames_that_are_whole_already_stay_exact():
    values = np.random.default_rng(1).uniform(size=(30, 4))
    frames = np.arange(5.0, 35.0)
    assert np.allclose(curves_at(frames, values, whole_frames(frames)), values, atol=1e-12)


def test_a_blink_between_frames_shuts_in_the_nearest_one():
    """A clip of 25 frames per second in a scene of 24; the eye is shut in a single frame of the clip."""
    frames = 1.0 + np.arange(100) * 24.0 / 25.0
    blink = np.zeros((100, 1))
    blink[49:52, 0] = [0.5, 1.0, 0.5]
    found = curves_at(frames, blink, whole_frames(frames))[:, 0]
    assert found.max() == 1.0 and found.argmax() == round(frames[50]) - 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
@settings(max_examples=60)
@given(
    rate=st.floats(0.1, 1.5),
    phase=st.floats(0.0, 1.0),
    before=st.integers(1, 5),
    after=st.integers(1, 5),
    held=st.integers(1, 3),
)
def test_a_short_blink_shuts_in_a_frame_whatever_its_rate_and_phase(sign, rate, phase, before, after, held):
    """So does a short opening between two shut eyes, the other way round."""
    blink = np.zeros(80)
    shape = [*np.linspace(0.0, 1.0, before + 1), *np.ones(held - 1), *np.linspace(1.0, 0.0, after + 1)[1:]]
    blink[30 : 30 + len(shape)] = shape
    frames = 1.0 + rate * (np.arange(80) + phase)
    found = curves_at(frames, sign * blink[:, None], whole_frames(frames))[:, 0]
    assert np.abs(found).max() == 1.0 and found[0] == found[-1] == 0.0


def test_rotations_are_interpolated_on_the_sphere_and_lost_frames_are_bridged():
    frames = np.array([1.0, 1.5, 6.5])
    angles = np.array([0.0, 0.1, 0.6])
    turns = np.array([euler_to_matrix(0.0, angle, 0.0) for angle in angles])
    motion = HeadMotion(
        times=(frames - 1.0) / 24.0,
        vertices=np.zeros((3, 2, 3), np.float32),
        rotation=turns,
        translation=np.zeros((3, 3)),
        jaw=turns,
        gaze=np.stack([turns, turns], axis=1),
        actions=np.zeros((3, 15)),
    )
    at = whole_frames(frames)
    found = motion_at(frames, motion, at)
    expected = np.array([euler_to_matrix(0.0, angle, 0.0) for angle in np.interp(at, frames, angles)])
    assert len(found.times) == len(at) == 7
    for part in (found.rotation, found.jaw, found.gaze[:, 1]):
        assert np.allclose(part, expected, atol=1e-9)

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.face.landmarks import LOWER_LIDS, MIRROR, UPPER_LIDS, eye_apertures
from facemime.core.tracking.lids import pair_lids
from facemime.core.tracking.tracker import FaceTracker

LARGE, SMALL = 150.0, 25.0
"""Eye distances in pixels of a face near a webcam, and of one far away."""


@pytest.fixture(scope="module")
def mean():
    return FaceTracker.load().pdm.mean_shape


def opened(mean, right, left):
    """The mean face with eyes open by shares of its own opening."""
    shape = mean.copy()
    share = np.repeat([right, left], 2)
    shape[UPPER_LIDS] = mean[LOWER_LIDS] + share[:, None] * (mean[UPPER_LIDS] - mean[LOWER_LIDS])
    return shape


def paired(shape, scale=LARGE, yaw=0.0):
    return pair_lids(np.array([scale, 0.0, yaw, 0.0, 320.0, 240.0]), shape)


def shares(shape, mean):
    return eye_apertures(shape) / eye_apertures(mean)


@pytest.mark.parametrize("shut", [0, 1])
def test_a_wink_stays(shut, mean):
    wanted = np.ones(2)
    wanted[shut] = 0.0
    assert shares(paired(opened(mean, *wanted)), mean) == pytest.approx(wanted, abs=0.04)


def test_eyes_of_a_small_face_that_differ_a_little_are_open_alike(mean):
    right, left = shares(paired(opened(mean, 0.5, 0.3), SMALL), mean)
    assert abs(right - left) < 0.06
    assert right + left == pytest.approx(0.8, abs=0.02)


@given(st.floats(-0.2, 1.5), st.floats(-0.2, 1.5), st.sampled_from([SMALL, LARGE]), st.floats(-0.6, 0.6))
def test_eyes_come_nearer_and_neither_opens_beyond_the_other(mean, right, left, scale, yaw):
    before, after = opened(mean, right, left), paired(opened(mean, right, left), scale, yaw)
    was, now = (eye_apertures(shape) for shape in (before, after))
    assert abs(now[0] - now[1]) <= abs(was[0] - was[1]) + 1e-4
    assert was.min() - 1e-4 <= now.min() <= now.max() <= was.max() + 1e-4
    still = np.setdiff1d(np.arange(66), UPPER_LIDS)
    assert (after[still] == before[still]).all()


def test_the_eye_that_is_hidden_by_the_nose_follows_the_other(mean):
    right, left = shares(paired(opened(mean, 0.6, 0.2), yaw=0.9), mean)  # the nose is on the viewer's left
    assert abs(left - 0.2) < abs(right - 0.6)


def test_a_mirrored_face_has_mirrored_lids(mean):
    flip = np.array([-1.0, 1.0, 1.0])
    shape = opened(mean, 0.9, 0.4)
    mirrored = paired((shape * flip)[MIRROR], yaw=-0.4)
    assert (mirrored * flip)[MIRROR] == pytest.approx(paired(shape, yaw=0.4))

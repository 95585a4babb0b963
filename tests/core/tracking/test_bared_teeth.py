"""Inner rims of lips that bare the teeth, and shut teeth, on painted mouths whose rims are known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.face.landmarks import LOWER_LIPS, UPPER_LIPS, mouth_aperture
from facemime.core.tracking.result import project_shape
from facemime.core.tracking.teeth import bare_teeth
from facemime.core.tracking.tracker import FaceTracker

SKIN, LIPS, TEETH = (130, 160, 205), (95, 90, 180), (190, 205, 215)
VIEWS = (st.floats(50.0, 160.0), st.floats(-0.6, 0.6), st.floats(-0.3, 0.3))
"""Scales, rolls and yaws of a head."""
DARK, TONGUE = (25, 20, 30), (90, 90, 175)
"""BGR."""
SHAPE = FaceTracker.load().pdm.mean_shape.copy()
MIDDLE = 0.5 * float(SHAPE[UPPER_LIPS, 1].mean() + SHAPE[LOWER_LIPS, 1].mean())
SHAPE[UPPER_LIPS, 1] = MIDDLE - 0.01
SHAPE[LOWER_LIPS, 1] = MIDDLE + 0.01
SHAPE[[49, 50, 51, 52, 53], 1] = MIDDLE - 0.14
SHAPE[[55, 56, 57, 58, 59], 1] = MIDDLE + 0.16


def mouth(
    top: float, bottom: float, pose: np.ndarray, between: tuple[int, int, int] = TEETH, gap: float = 0.0
) -> np.ndarray:
    """A face with lips, and teeth from `top` to `bottom`, in eye distances from the middle of the tracked mouth.

    In the middle of the teeth there is a dark `gap`.
    """
    # Painted four times as large, as a filled polygon covers the pixels that its border touches.
    image = np.full((1600, 1600, 3), SKIN, np.uint8)

    def fill(first: float, last: float, colour: tuple[int, int, int]) -> None:
        box = np.array([(x, MIDDLE + y, SHAPE[LOWER_LIPS, 2].mean()) for x, y in ((-0.3, first), (0.3, first))])
        box = np.concatenate([box, box[::-1] + (0.0, last - first, 0.0)])
        corners = np.round(((project_shape(box, pose) + 0.5) * 4.0 - 0.5) * 16.0).astype(np.int32)
        cv2.fillConvexPoly(image, corners, colour, cv2.LINE_AA, 4)

    fill(-0.14, 0.16, LIPS)
    fill(top, bottom, between)
    if gap:
        fill(0.5 * (top + bottom - gap), 0.5 * (top + bottom + gap), DARK)
    return np.asarray(cv2.resize(image, (400, 400), interpolation=cv2.INTER_AREA))


def bared(image: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return bare_teeth(image, pose, project_shape(SHAPE, pose), SHAPE)[0]


def shut(image: np.ndarray, pose: np.ndarray, top: float, bottom: float) -> float:
    """How surely teeth are shut between lips whose inner rims are tracked at `top` and `bottom`."""
    parted = SHAPE.copy()
    parted[UPPER_LIPS, 1], parted[LOWER_LIPS, 1] = MIDDLE + top, MIDDLE + bottom
    return bare_teeth(image, pose, project_shape(parted, pose), parted)[1]


@given(
    st.floats(-0.1, -0.02),
    st.floats(0.02, 0.11),
    *VIEWS,
)
def test_inner_rims_move_to_the_ends_of_the_teeth(
    top: float, bottom: float, scale: float, roll: float, yaw: float
) -> None:
    pose = np.array([scale, 0.0, yaw, roll, 200.0, 200.0])
    found = bared(mouth(top, bottom, pose), pose)
    assert found[UPPER_LIPS, 1] == pytest.approx(MIDDLE + top, abs=0.012)
    assert found[LOWER_LIPS, 1] == pytest.approx(MIDDLE + bottom, abs=0.012)
    others = np.setdiff1d(np.arange(66), [*UPPER_LIPS, *LOWER_LIPS])
    assert (found[others] == SHAPE[others]).all()


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(mouth(0.0, 0.0, np.array([80.0, 0, 0, 0, 200, 200]), LIPS), id="shut lips"),
        pytest.param(mouth(-0.1, 0.1, np.array([80.0, 0, 0, 0, 200, 200]), TONGUE), id="a tongue"),
        pytest.param(mouth(0.06, 0.1, np.array([80.0, 0, 0, 0, 200, 200])), id="a highlight on the lower lip"),
        pytest.param(np.full((400, 400, 3), SKIN, np.uint8), id="no lips at all"),
        pytest.param(np.full((400, 400, 3), 128, np.uint8), id="grey"),
        pytest.param(np.zeros((2, 2, 3), np.uint8), id="the mouth is outside the image"),
    ],
)
def test_without_teeth_between_them_lips_stay_as_they_are(image: np.ndarray) -> None:
    pose = np.array([80.0, 0.0, 0.0, 0.0, 200.0, 200.0])
    assert bared(image, pose) is SHAPE


def test_rims_never_move_closer_and_something_is_left_of_each_lip() -> None:
    pose = np.array([80.0, 0.0, 0.0, 0.0, 200.0, 200.0])
    wide = SHAPE.copy()
    wide[UPPER_LIPS, 1] -= 0.07
    wide[LOWER_LIPS, 1] += 0.07
    assert bare_teeth(mouth(-0.03, 0.03, pose), pose, project_shape(wide, pose), wide)[0] is wide
    found = bared(mouth(-0.125, 0.145, pose), pose)
    assert 0.15 < mouth_aperture(found) <= 0.30 - 0.04 + 1e-9


def test_a_head_that_is_turned_to_the_side_is_left_as_it_is() -> None:
    pose = np.array([80.0, 0.0, 0.9, 0.0, 200.0, 200.0])
    assert bared(mouth(-0.1, 0.1, pose), pose) is SHAPE


def test_the_less_the_teeth_differ_from_lips_the_less_rims_move() -> None:
    pose = np.array([80.0, 0.0, 0.0, 0.0, 200.0, 200.0])
    paler = [
        tuple(int(v) for v in np.add(np.multiply(LIPS, 1 - t), np.multiply(TEETH, t))) for t in (0.5, 0.65, 0.75, 1)
    ]
    gaps = [float(mouth_aperture(bared(mouth(-0.08, 0.08, pose, colour), pose))) for colour in paler]
    assert gaps == sorted(gaps) and gaps[0] < 0.04 and gaps[-1] > 0.14


@settings(max_examples=20, deadline=None)
@given(
    st.floats(-0.1, -0.06),
    st.floats(0.06, 0.11),
    *VIEWS,
)
def test_teeth_without_a_dark_gap_are_shut_and_others_are_not(
    top: float, bottom: float, scale: float, roll: float, yaw: float
) -> None:
    pose = np.array([scale, 0.0, yaw, roll, 200.0, 200.0])
    assert shut(mouth(top, bottom, pose), pose, top, bottom) > 0.9
    assert shut(mouth(top, bottom, pose, gap=0.05), pose, top, bottom) < 0.1
    assert shut(mouth(top, bottom, pose, TONGUE), pose, top, bottom) == 0.0
    assert shut(mouth(top, bottom, pose, DARK), pose, top, bottom) == 0.0


def test_the_less_lips_are_parted_the_less_surely_teeth_are_shut_and_not_at_all_between_shut_lips() -> None:
    pose = np.array([80.0, 0.0, 0.0, 0.0, 200.0, 200.0])
    found = [shut(mouth(-half, half, pose), pose, -half, half) for half in (0.002, 0.02, 0.035, 0.045, 0.06)]
    assert found[:2] == [0.0, 0.0] and found == sorted(found) and 0.0 < found[3] < found[4]


def test_it_is_unknown_in_grey_and_on_a_turned_head_whether_teeth_are_shut() -> None:
    pose = np.array([80.0, 0.0, 0.0, 0.0, 200.0, 200.0])
    grey = cv2.cvtColor(cv2.cvtColor(mouth(-0.08, 0.08, pose), cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert np.isnan(shut(grey, pose, -0.08, 0.08))
    turned = np.array([80.0, 0.0, 0.9, 0.0, 200.0, 200.0])
    assert np.isnan(shut(mouth(-0.08, 0.08, turned), turned, -0.08, 0.08))

"""Lower teeth and gums stay behind the skin when the lip is drawn back."""

import numpy as np
import pytest

from facemime.core.drive.parts import PartDriver
from facemime.core.heads.rig import HeadRig, Part
from tests.helpers.built_in import UNIT
from tests.helpers.parted_heads import GUM_COLUMNS, GUM_ROWS, with_gums

STRAIGHT = np.tile(np.eye(3), (2, 1, 1))


def teeth_of(rig: HeadRig, back: float) -> tuple[np.ndarray, np.ndarray]:
    """Teeth (6, 9, 3) at rest, and with all skin drawn back, in outer-eye distances."""
    alone, skin = rig.skin()
    assert skin is not None
    driver = PartDriver(rig, skin, alone)
    drawn = np.asarray(alone.vertices, dtype=np.float32) + np.float32([0.0, 0.0, back * UNIT])
    posed = driver.pose(drawn, np.eye(3), STRAIGHT)
    rest, moved = (
        places[rig.kinds == Part.TEETH_LOWER].reshape(GUM_ROWS, GUM_COLUMNS, 3) for places in (driver.rest, posed)
    )
    return rest, moved


def test_gums_behind_a_lip_that_is_drawn_back_move_back_with_it():
    rest, moved = teeth_of(with_gums(0.12), 0.15)
    back = (moved - rest) / UNIT
    assert (back[2:, :, 2] > 0.03).all() and (back[2:, :, 2] < 0.15 + 1e-5).all()
    np.testing.assert_array_equal(back[:, :, :2], 0.0)


def test_teeth_behind_the_upper_lip_stay():
    rest, moved = teeth_of(with_gums(0.12), 0.15)
    np.testing.assert_array_equal(moved[0], rest[0])


def test_gums_move_back_as_skin_that_is_deeper_slides_up_before_them():
    rig = with_gums(0.12)
    alone, skin = rig.skin()
    assert skin is not None
    driver, rest = PartDriver(rig, skin, alone), np.asarray(alone.vertices, dtype=np.float32)
    rows = driver.gums.rows
    assert len(rows)

    def back(up: float) -> np.ndarray:
        posed = driver.pose(rest - np.float32([0.0, up * UNIT, 0.0]), np.eye(3), STRAIGHT)
        return (posed - driver.rest)[rows, 2] / UNIT

    # Below the lip, skin recedes towards the chin.
    assert back(0.1).max() > 0.03
    assert back(0.1).mean() > back(0.05).mean() > 0.0


@pytest.mark.parametrize("back", [0.0, -0.1])
def test_gums_stay_where_they_are_if_the_skin_does_not_come_near(back):
    rest, moved = teeth_of(with_gums(0.12), back)
    np.testing.assert_allclose(moved, rest, atol=1e-6 * UNIT)


def test_what_lies_deep_in_the_mouth_stays():
    rest, moved = teeth_of(with_gums(0.6), 0.15)
    np.testing.assert_array_equal(moved, rest)

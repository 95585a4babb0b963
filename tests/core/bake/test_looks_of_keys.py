"""Keys of a head's own turn its eyes as far as the performer's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.bake.own_keys import look_factors
from facemime.core.face.names import COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import EYE_REACH, LOOKS
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.heads.rig import Part
from tests.helpers.parted_heads import with_parts

NAMES = [COEFFICIENTS[column] for column in LOOKS.tolist()]
TABLE = KeyMap("Mine", tuple(KeyRow(name, name) for name in NAMES))
WAYS = {"Up": (-1.0, 0.0), "Down": (1.0, 0.0), "InLeft": (0.0, 1.0), "OutLeft": (0.0, -1.0)}
WAYS |= {"InRight": (0.0, -1.0), "OutRight": (0.0, 1.0)}
"""Pitch and yaw of a direction."""


@pytest.fixture(scope="module")
def rig():
    return with_parts()


def turned(rig, angle: float) -> dict[str, np.ndarray]:
    """Keys that turn the eyes by an angle in degrees, and move the skin a little."""
    keys = {}
    for name in NAMES:
        ((pitch, yaw),) = (way for end, way in WAYS.items() if name.removeprefix("eyeLook").startswith(end))
        motion = np.zeros((len(rig.all_vertices), 3), dtype=np.float32)
        motion[rig.kinds == Part.SKIN] = 0.001 * rig.eye_distance
        rows = rig.kinds == (Part.EYE_LEFT if name.endswith("Left") else Part.EYE_RIGHT)
        rest = rig.all_vertices[rows] - rig.all_vertices[rows].mean(axis=0)
        motion[rows] = rest @ euler_to_matrix(*np.radians((pitch * angle, yaw * angle)), 0.0).T - rest
        keys[name] = motion
    return keys


@given(angle=st.floats(12.0, 60.0))
def test_keys_are_set_by_the_angle_at_which_they_turn_an_eye(rig, angle):
    factors = look_factors(rig, TABLE, turned(rig, angle))
    reach = [np.degrees(EYE_REACH[0 if "Up" in name or "Down" in name else 1]) for name in NAMES]
    np.testing.assert_allclose(factors, np.array(reach) / angle, rtol=0.02)


def test_keys_that_turn_no_eyeball_are_set_as_a_phone_means(rig):
    still = {name: np.zeros((len(rig.all_vertices), 3), dtype=np.float32) for name in NAMES}
    np.testing.assert_array_equal(look_factors(rig, TABLE, still), 1.0)
    np.testing.assert_array_equal(look_factors(rig, TABLE, {}), 1.0)
    stretched = {name: 1.3 * np.maximum(key, 0.0) for name, key in turned(rig, 25.0).items()}
    np.testing.assert_array_equal(look_factors(rig, TABLE, stretched), 1.0)
    np.testing.assert_array_equal(look_factors(replace(rig, parts=None), TABLE, {}), 1.0)


def test_a_gain_that_the_user_chose_stays(rig):
    table = KeyMap("Mine", tuple(KeyRow(name, name, gain=0.7) for name in NAMES))
    np.testing.assert_array_equal(look_factors(rig, table, turned(rig, 20.0)), 1.0)

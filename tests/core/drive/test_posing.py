"""Strength and limits of the motion of head and eyes."""

from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.drive.drive_settings import DriveSettings, PosingSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import SourceError
from facemime.core.face.rotation import euler_to_matrix, limit_rotation, limit_vector
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.tracking.result import mirror_result
from tests.helpers.takes import performance

angles = st.tuples(*[st.floats(-1.2, 1.2)] * 3)


def angle(rotation: np.ndarray) -> float:
    """Angle of `rotation` in radians."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))


@given(angles, st.floats(0.0, 2.0), st.floats(0.0, 3.0))
def test_a_rotation_keeps_its_axis_and_stops_at_its_limit(euler, strength, limit):
    rotation = euler_to_matrix(*euler)
    turned = limit_rotation(rotation, strength, limit)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
    assert angle(turned) == pytest.approx(min(strength * angle(rotation), limit, 2 * pi), abs=1e-5) or strength > 1
    assert angle(turned) <= limit + 1e-5
    if angle(rotation) > 1e-3 and angle(turned) > 1e-3:
        axis = np.linalg.eigh(rotation + rotation.T)[1][:, -1]
        np.testing.assert_allclose(turned @ axis, axis, atol=1e-5)


@given(angles)
def test_full_strength_without_a_limit_changes_nothing(euler):
    rotation = euler_to_matrix(*euler)
    np.testing.assert_array_equal(limit_rotation(rotation, 1.0, pi), rotation)
    np.testing.assert_array_equal(limit_vector(np.array(euler), 1.0, inf), euler)


def test_strength_and_limit_apply_to_head_eyes_and_position():
    take, rig = performance(), built_in_head()
    neutral, result = calibrate(take), take.result(len(take) - 1)
    plain = HeadDriver(rig, neutral).frame(result)
    still = HeadDriver(
        rig,
        neutral,
        DriveSettings(posing=PosingSettings(rotation_strength=0.0, location_strength=0.0, eyes_strength=0.0)),
    ).frame(result)
    assert angle(still.rotation) < 1e-9 and max(map(angle, still.gaze)) < 1e-9 and not still.translation.any()
    short = HeadDriver(
        rig, neutral, DriveSettings(posing=PosingSettings(rotation_limit=0.01, location_limit=0.01))
    ).frame(result)
    assert angle(plain.rotation) > 0.02 and angle(short.rotation) == pytest.approx(0.01, abs=1e-6)
    unit = np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[[36, 45]]]))
    assert np.linalg.norm(short.translation) == pytest.approx(0.01 * unit, rel=1e-5)
    np.testing.assert_array_equal(short.vertices, plain.vertices)


def test_a_mirrored_head_moves_as_for_a_mirrored_image():
    take, rig = performance(), built_in_head()
    neutral = calibrate(take)
    mirrored = HeadDriver(rig, neutral, DriveSettings(mirror=True))
    straight = HeadDriver(rig, neutral.mirrored())
    for index in (3, 40, 59):
        result = take.result(index)
        one, other = mirrored.frame(result), straight.frame(mirror_result(result, 1.0))
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.rotation, other.rotation)
        np.testing.assert_array_equal(one.translation, other.translation)
    turned = HeadDriver(rig, neutral).frame(take.result(40))
    assert np.sign(turned.rotation[0, 2]) == -np.sign(mirrored.frame(take.result(40)).rotation[0, 2])


def test_a_neutral_survives_storage_and_a_damaged_one_is_refused():
    neutral = calibrate(performance())
    stored = neutral.to_dict()
    again = Neutral.from_dict(stored)
    for name in ("shape", "rotation", "position", "gaze", "shut", "open_mouth", "start", "end"):
        np.testing.assert_array_equal(getattr(again, name), getattr(neutral, name))
    for name, value in (("shape", [[1.0]]), ("rotation", None), ("shut", "wide"), ("position", [1.0, None, 2.0])):
        with pytest.raises(SourceError, match="damaged"):
            Neutral.from_dict({**stored, name: value})
    with pytest.raises(SourceError, match="damaged"):
        Neutral.from_dict({})


def test_the_lower_face_is_amplified_for_a_mouth_that_opens_little():
    neutral = calibrate(performance())
    assert neutral.mouth_gain == 1.0
    wide, small = replace(neutral, open_mouth=0.6), replace(neutral, open_mouth=0.28)
    assert wide.mouth_gain == 1.0 and 1.2 < small.mouth_gain <= 1.4
    rig, result = built_in_head(), performance().result(50)
    moved = [HeadDriver(rig, n).frame(result).vertices - rig.vertices for n in (wide, small)]
    chin = rig.landmarks[8]
    assert moved[1][chin, 1] == pytest.approx(small.mouth_gain * moved[0][chin, 1], rel=0.05)

"""Keys of a head's own shut its eyes as far as the performer's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.own_keys import lid_factors, reaching
from facemime.core.face.names import COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.heads.rig import FaceParts, Part
from tests.helpers.parted_heads import with_parts

NAMES = ("eyeBlinkLeft", "eyeBlinkRight")
TABLE = KeyMap("Mine", tuple(KeyRow(name, name) for name in NAMES))
BOTH = KeyMap("Mine", tuple(KeyRow(name, "Blink", gain=0.5) for name in NAMES))


@pytest.fixture(scope="module")
def rig():
    return with_parts()


def factors(rig, table, keys) -> np.ndarray:
    """Factors of a head whose parts are all given."""
    return lid_factors(rig.all_vertices, rig.all_faces, table, keys)


def blinks(rig, share: float) -> dict[str, np.ndarray]:
    """Keys that move the lids by a share of what shuts them."""
    keys = {}
    for name in NAMES:
        keys[name] = np.zeros((len(rig.all_vertices), 3), dtype=np.float32)
        keys[name][: len(rig.vertices)] = share * load_head().units[COEFFICIENTS.index(name)]
    return keys


def both_by_one(rig, share: float) -> dict[str, np.ndarray]:
    """The key of both eyes."""
    return {"Blink": sum(blinks(rig, share).values())}


@pytest.mark.parametrize("table", [BOTH, pytest.param(TABLE, marks=pytest.mark.thorough)])
@settings(deadline=None, max_examples=2)
@given(share=st.floats(0.75, 0.95))
def test_keys_that_stop_short_are_taken_further_until_the_eyes_are_shut(rig, share, table):
    keys = blinks(rig, share) if table is TABLE else both_by_one(rig, share)
    found = factors(rig, table, keys)
    assert found[0] == found[1]
    assert share * found[0] == pytest.approx(1.0, abs=0.07)


@pytest.mark.parametrize("share", [1.0, *(pytest.param(share, marks=pytest.mark.thorough) for share in (1.1, 1.3))])
def test_keys_that_shut_the_eyes_are_left(rig, share):
    np.testing.assert_array_equal(factors(rig, TABLE, blinks(rig, share)), 1.0)
    np.testing.assert_array_equal(factors(rig, BOTH, both_by_one(rig, share)), 1.0)


def test_glasses_in_front_of_the_eyes_do_not_count(rig):
    low, high = rig.all_vertices.min(axis=0), rig.all_vertices.max(axis=0)
    z = low[2] - 0.01
    pane = np.array([[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]])
    count, faces = len(rig.all_vertices), np.full((1, rig.parts.faces.shape[1]), -1)
    faces[0, :4] = count + np.arange(4)
    parts = FaceParts(
        np.append(rig.kinds, [Part.ON_HEAD] * 4).astype(np.int8),
        np.concatenate([rig.parts.others, pane.astype(np.float32)]),
        np.concatenate([rig.parts.faces, faces]),
    )
    behind = replace(rig, parts=parts)
    for share in (0.8, 1.0):
        found = factors(behind, TABLE, blinks(behind, share))
        np.testing.assert_array_equal(found, factors(rig, TABLE, blinks(rig, share)))


def test_what_cannot_be_judged_is_left(rig):
    np.testing.assert_array_equal(factors(rig, TABLE, {}), 1.0)
    np.testing.assert_array_equal(factors(rig, TABLE, blinks(rig, 0.0)), 1.0)
    blind = replace(rig, parts=None)
    np.testing.assert_array_equal(factors(blind, TABLE, blinks(blind, 0.8)), 1.0)
    turned = {name: key @ euler_to_matrix(0.0, 0.0, np.pi).T for name, key in blinks(rig, 0.8).items()}
    np.testing.assert_array_equal(factors(rig, TABLE, turned), 1.0)  # a blink that opens the eyes further


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_not_finite_are_left_to_those_that_refuse_them(rig, value):
    keys = blinks(rig, 0.8)
    for key in keys.values():
        key[100] = value
    np.testing.assert_array_equal(factors(rig, TABLE, keys), 1.0)
    vertices = rig.all_vertices.copy()
    vertices[100] = value
    np.testing.assert_array_equal(lid_factors(vertices, rig.all_faces, TABLE, blinks(rig, 0.8)), 1.0)


def test_a_gain_that_the_user_chose_stays(rig):
    table = KeyMap("Mine", tuple(KeyRow(name, name, gain=0.9) for name in NAMES))
    np.testing.assert_array_equal(factors(rig, table, blinks(rig, 0.8)), 1.0)


def test_only_ranges_of_blinks_that_end_at_1_are_extended():
    table = KeyMap("Mine", (*TABLE.rows, KeyRow("jawOpen", "jawOpen")))
    ranges = {"eyeBlinkLeft": (0.0, 1.0), "eyeBlinkRight": (0.0, 0.6), "jawOpen": (0.0, 1.0)}
    wide = reaching(ranges, table, np.array([1.2, 1.2]))
    assert wide == {"eyeBlinkLeft": (0.0, 1.2), "eyeBlinkRight": (0.0, 0.6), "jawOpen": (0.0, 1.0)}
    assert reaching({}, table, np.array([1.2, 1.2])) == {}


@pytest.mark.parametrize(
    ("key", "gain", "before", "after"),
    [
        ("eCTRLBrowInnerUp-DownL", -0.7, (0.0, 1.0), (-1.0, 1.0)),
        ("brow_down_up", -1.0, (0.0, 1.0), (-1.0, 1.0)),
        ("MouthLeftRight", -1.0, (0.0, 1.0), (-1.0, 1.0)),
        ("MouthLeftRight", 1.0, (0.0, 1.0), (0.0, 1.0)),  # the mapping moves it one way
        ("MouthLeftRight", -1.0, (0.0, 0.5), (0.0, 0.5)),  # chosen by the user
        ("MouthLeftRight", -1.0, (-0.5, 1.0), (-0.5, 1.0)),
        ("MouthOpen", -1.0, (0.0, 1.0), (0.0, 1.0)),  # lips that close further would meet the teeth
        ("LookUpLeft", -1.0, (0.0, 1.0), (0.0, 1.0)),
    ],
)
def test_keys_that_are_named_after_two_directions_reach_below_0(key, gain, before, after):
    table = KeyMap("Mine", (KeyRow("browDownLeft", key, gain=gain), KeyRow("browInnerUp", key)))
    assert reaching({key: before}, table, np.ones(2)) == {key: after}

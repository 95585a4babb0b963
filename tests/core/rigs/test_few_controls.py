"""Which controls help most, what they do as arrows and on a sheet, and what their names say."""

import cv2
import numpy as np
import pytest

from facemime.core.face.landmarks import LIPS
from facemime.core.heads.rig import built_in_head
from facemime.core.rigs.control_names import REGION_OF, ROLES, mirrored, role_of
from facemime.core.rigs.display import SIDE, all_arrows, control_arrows, control_picture, directions_of, sheet_page
from facemime.core.rigs.few import ControlOrder, face_units
from facemime.core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, SCALE, Probe, RigChannel, map_of

UNIT = 0.1
SAMPLE = np.arange(90)


def effect(seed, size=0.1):
    random = np.random.default_rng(seed)
    moved = random.normal(size=(90, 3)) * np.exp(-np.abs(np.arange(90) - random.integers(0, 66)) / 6.0)[:, None]
    return size * UNIT * moved / np.linalg.norm(moved, axis=1).max()


def rig(*names):
    """A map of linear bones, each with an effect of its own."""
    channels = [RigChannel("Rig", name, LOCATION, 1, unit=UNIT) for name in names]
    return map_of(channels, [both(effect(seed)) for seed in range(len(names))], SAMPLE, UNIT)


def both(moved):
    return [Probe(0.02, moved), Probe(-0.02, -moved)]


def ordered(rig_map, motion):
    order = ControlOrder(rig_map, motion)
    shares = list(order.steps())
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    return order


def test_the_controls_that_made_a_motion_come_first():
    found = rig(*"abcdefgh")
    motion = np.einsum("nk,ksc->nsc", np.random.default_rng(1).uniform(-2.0, 2.0, (20, 3)), found.effects[[2, 5, 6]])
    order = ordered(found, motion)
    assert {name for group in order.groups[:3] for name in group} == {"c", "f", "g"}
    assert order.errors[2] < 0.05 and sorted(name for group in order.groups for name in group) == list("abcdefgh")


def test_the_error_falls_with_each_control():
    found = rig(*(f"c{number}" for number in range(12)))
    order = ordered(found, np.array([effect(100 + seed, 0.3) for seed in range(30)]))
    assert all(later <= before + 1e-3 for before, later in zip(order.errors, order.errors[1:], strict=False))


def test_both_sides_are_added_together():
    order = ordered(rig("lid.L", "jaw", "lid.R"), face_units(UNIT))
    assert sorted(map(len, order.groups)) == [1, 2] and ["lid.L", "lid.R"] in order.groups


def test_the_order_of_a_mirrored_list_of_controls_is_the_same():
    found, motion = rig(*"abcd"), np.array([effect(seed, 0.2) for seed in range(20)])
    again = map_of(found.channels[::-1], [both(each) for each in found.effects[::-1]], SAMPLE, UNIT)
    assert ordered(found, motion).groups == ordered(again, motion).groups


def test_arrows_of_a_control_are_where_it_moves_the_face_and_fit_on_it():
    moved = np.zeros((90, 3))
    moved[LIPS] = (0.0, 0.004, 0.0)
    channels = [
        RigChannel("Rig", "mouth", LOCATION, 2, unit=UNIT),
        RigChannel("Rig", "x", PROPERTY, name="x", high=1.0),
    ]
    found = map_of(channels, [both(moved), [Probe(0.5, effect(4))]], SAMPLE, UNIT)
    arrows = control_arrows(found, "mouth")
    assert set(arrows.vertices) == set(LIPS) and set(arrows.axes) == {2}
    np.testing.assert_allclose(np.linalg.norm(arrows.vectors, axis=1), 0.2 * UNIT)
    every = all_arrows(found)
    assert len(every.vertices) == 2 and sorted(every.axes) == [2, 3]
    assert not len(control_arrows(found, "nothing").vertices)


@pytest.mark.parametrize(
    ("name", "role"),
    [
        *(("jaw_master", "Jaw"), ("lips.R", "Lip Corner"), ("lid.T.L.002", "Upper Lid"), ("brow.B.R.003", "Brow")),
        *(("c_jawbone.x", "Jaw"), ("c_lips_smile.l", "Lip Corner"), ("c_lips_top_01.r", "Upper Lip")),
        *(("c_eyelid_top.l", "Upper Lid"), ("c_eyebrow_01_end.l", "Brow"), ("c_cheek_inflate.r", "Cheek")),
        *(("blink_ctrl_L", "Blink"), ("mouth_corner_R", "Lip Corner"), ("nose_frown_ctrl_L", "Nose")),
        *(("CTRL_L_eye_blink", "Blink"), ("CTRL_C_jaw", "Jaw"), ("CTRL_R_mouth_cornerPull", "Lip Corner")),
        *(("CTRL_L_mouth_lipsRollD", "Lower Lip"), ("CTRL_C_tongue_inOut", ""), ("eyeBlinkLeft", "Blink")),
        *(("mouthFrown_R", "Lip Corner"), ("c12", ""), ("Hinge", ""), ("lower", ""), ("", "")),
    ],
)
def test_names_of_known_rigs_say_what_a_control_is(name, role):
    assert role_of(name) == role
    assert not role or role in ROLES


@pytest.mark.parametrize(
    ("name", "other"),
    [
        *(("lid.T.L.002", "lid.T.R.002"), ("CTRL_C_jaw", "CTRL_C_jaw"), ("CTRL_L_nose", "CTRL_R_nose")),
        *(("left_brow", "right_brow"), ("eyeBlinkLeft", "eyeBlinkRight"), ("c_eyelid_top.l", "c_eyelid_top.r")),
        *(("lower", "lower"), ("browL", "browR"), ("roller", "roller"), ("LEFT lid", "RIGHT lid")),
    ],
)
def test_the_other_side_of_a_name(name, other):
    assert mirrored(name) == other and mirrored(other) == name


def test_what_a_control_moves_decides_its_region_and_its_name_only_what_is_close():
    lips, jaw = np.zeros((90, 3)), np.zeros((90, 3))
    lips[LIPS], jaw[LIPS], jaw[:17] = 0.01, 0.01, 0.008
    channels = [RigChannel("Rig", name, LOCATION, axis, unit=UNIT) for name in ("jaw_master", "chin") for axis in (0,)]
    found = map_of(channels, [both(jaw), both(lips)], SAMPLE, UNIT)
    assert found.regions == {"jaw_master": "Jaw", "chin": "Mouth"}
    assert set(REGION_OF) <= set(ROLES)


def test_the_sheet_says_what_each_direction_does_within_its_range():
    slider = RigChannel("Rig", "", PROPERTY, name="a <b>", low=0.0, high=1.0, rest=0.0)
    turn = RigChannel("Rig", "jaw_master", ROTATION, 0, low=-0.2, high=0.5)
    one_way = [Probe(0.5, effect(3))]
    kinked = [Probe(0.1, effect(1)), Probe(-0.1, effect(7))]
    found = map_of([slider, turn], [one_way, kinked], SAMPLE, UNIT)
    directions = directions_of(found)
    assert [each.channel.control for each in directions].count("jaw_master") == 2
    shown = next(each for each in directions if each.channel.kind == PROPERTY)
    assert shown.value == pytest.approx(1.0) and shown.moved == pytest.approx(0.2) and shown.linearity == "one way"
    down = next(each for each in directions if each.value < 0.0)
    assert down.value == pytest.approx(-0.2) and down.range == "-11° to +29°" and "not linear" in down.linearity
    page = sheet_page("Me & you", found, directions, [b"picture"] * len(directions))
    assert "a &lt;b&gt;" in page and "Me &amp; you" in page and page.count("<img") == 3
    assert "<small>Jaw</small>" in page


def test_the_sheet_names_the_axis_of_a_location_and_of_a_scale():
    channels = [RigChannel("Rig", "lip", kind, 1, rest=rest) for kind, rest in ((LOCATION, 0.0), (SCALE, 1.0))]
    directions = directions_of(map_of(channels, [[Probe(0.5, effect(seed))] for seed in (1, 2)], SAMPLE, UNIT))
    assert sorted(each.caption.split()[:2] for each in directions) == [["Location", "Y"], ["Scale", "Y"]]


def test_a_picture_of_a_control_has_arrows_where_the_face_moves():
    rig = built_in_head()
    rest = np.asarray(rig.vertices, dtype=np.float64)
    posed = rest.copy()
    posed[rig.landmarks[LIPS], 1] += 0.01
    still, moved = (
        cv2.imdecode(np.frombuffer(control_picture(rig, rig.landmarks, rest, each), np.uint8), cv2.IMREAD_COLOR)
        for each in (rest, posed)
    )
    red = [int((image[..., 2].astype(int) - image[..., 0] > 60).sum()) for image in (still, moved)]
    assert still.shape == (SIDE, SIDE, 3) and red[0] == 0 and red[1] > 30

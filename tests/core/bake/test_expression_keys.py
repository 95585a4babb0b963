"""Face units made on a head."""

from dataclasses import replace

import numpy as np
import pytest

from facemime.core.bake.expression_keys import expression_keys
from facemime.core.bake.key_quality import findings, key_qualities
from facemime.core.bake.key_sets import KEY_SETS, KeySet
from facemime.core.deform.lid_rims import lid_rims
from facemime.core.face.landmarks import BROWS, CHIN, EYE_LEFT, EYE_RIGHT, LIPS, LOWER_LIDS, NOSE, UPPER_LIDS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.eyeballs import part_eyeball
from facemime.core.heads.rig import Part, built_in_head
from facemime.core.heads.tongues import tongue_of
from tests.helpers.parted_heads import with_parts


@pytest.fixture(scope="module")
def made():
    return expression_keys(with_parts())


def test_keys_made_on_the_built_in_head_are_nearly_its_own(made):
    head = load_head()
    names, motions = made
    assert names == head.unit_names
    skin = motions[:, : len(head.vertices)]
    error = np.linalg.norm(skin - head.units, axis=2).mean(axis=1)
    size = np.linalg.norm(head.units, axis=2).mean(axis=1)
    assert error.sum() < 0.12 * size.sum()


def test_a_blink_shuts_the_lids_and_keeps_them_outside_the_eye(made):
    head = load_head()
    names, motions = made
    shut = head.vertices + motions[names.index("eyeBlinkLeft"), : len(head.vertices)]
    own = head.vertices + head.units[names.index("eyeBlinkLeft")]
    for upper, lower in zip(UPPER_LIDS[2:], LOWER_LIDS[2:], strict=True):
        a, b = head.landmarks[[upper, lower]]
        rest = np.linalg.norm(head.vertices[a] - head.vertices[b])
        wanted = np.linalg.norm(own[a] - own[b])
        assert abs(np.linalg.norm(shut[a] - shut[b]) - wanted) < 0.1 * rest


def test_the_jaw_carries_the_lower_teeth_and_looks_turn_the_eyes(made):
    rig = with_parts()
    names, motions = made
    kinds, rest = rig.kinds, rig.all_vertices
    jaw = motions[names.index("jawOpen")]
    assert np.linalg.norm(jaw[kinds == Part.TEETH_LOWER], axis=1).mean() > 0.05 * rig.eye_distance
    assert not jaw[kinds == Part.TEETH_UPPER].any()
    eye = kinds == Part.EYE_LEFT
    centre = part_eyeball(rest[eye])[0][:3]
    look = motions[names.index("eyeLookUpLeft")]
    before, after = rest[eye] - centre, rest[eye] + look[eye] - centre
    np.testing.assert_allclose(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1), rtol=1e-4)
    assert np.abs(look[eye]).max() > 0.02 * rig.eye_distance
    assert np.abs(motions[names.index("mouthSmileLeft")][eye]).max() < 1e-6


def test_a_head_without_parts_gets_keys_too():
    names, motions = expression_keys(built_in_head())
    assert motions.shape == (len(names), len(load_head().vertices), 3)
    assert np.isfinite(motions).all()


def test_a_tongue_that_is_a_part_leaves_the_mouth_in_its_own_key_only():
    rig = with_parts()
    tongue = tongue_of(rig)
    assert tongue.sum() == len(load_head().part("tongue").vertices)
    names, motions = expression_keys(rig)
    lips = rig.vertices[rig.landmarks[LIPS]]
    for name, out in (("tongueOut", True), ("mouthFunnel", False)):
        posed = (rig.all_vertices + motions[names.index(name)])[tongue]
        assert (posed[:, 2].min() < lips[:, 2].min() - 0.1 * rig.eye_distance) == out
    tip = (rig.all_vertices + motions[names.index("tongueOut")])[tongue]
    assert lips[:, 1].min() < tip[tip[:, 2].argmin(), 1] < lips[:, 1].max()


def test_a_key_that_moves_nothing_is_named():
    rig, keys = built_in_head(), KEY_SETS["arkit"]
    motions = np.zeros((len(keys.names), len(rig.vertices), 3), dtype=np.float32)
    motions[:-1, 0, 0] = 0.01 * rig.eye_distance
    assert findings(key_qualities(rig, keys, motions))[-1] == "Without motion: tongueOut"
    vrm = KEY_SETS["vrm"]
    moved = np.repeat(motions[:1], len(vrm.names), axis=0)
    moved[vrm.names.index("neutral")] = 0.0
    assert not [line for line in findings(key_qualities(rig, vrm, moved)) if line.startswith("Without motion")]


def test_made_blinks_shut_the_eyes_along_their_whole_rims():
    rig = built_in_head()
    places = np.array(rig.vertices, dtype=np.float64)
    for eye in (EYE_RIGHT, EYE_LEFT):
        # Eyes that rise to both corners, as no known head's do.
        middle = places[rig.landmarks[eye]].mean(axis=0)
        near = np.exp(-np.square((places - middle) / (0.3 * rig.eye_distance)).sum(axis=1))
        places[:, 1] -= 0.65 * near * np.abs(places[:, 0] - middle[0])
    rig = replace(rig, vertices=places)
    names, motions = expression_keys(rig)
    eyes = lid_rims(rig.vertices, rig.faces, rig.landmarks, rig.region_weights)
    for eye, name in zip(eyes, ("eyeBlinkRight", "eyeBlinkLeft"), strict=True):
        assert eye.open_share(places + motions[names.index(name)]) < 0.015


@pytest.mark.parametrize("size", [0.7, 1.3])
def test_a_small_mouth_moves_less_far_than_a_large_one(size):
    rig = built_in_head()
    keys = KeySet("Few", {name: {name: 1.0} for name in ("mouthSmileLeft", "jawOpen", "browInnerUp")})
    places = np.array(rig.vertices, dtype=np.float64)
    middle, unit = places[rig.landmarks[NOSE[4:]]].mean(axis=0), rig.eye_distance
    lower = np.clip((places[:, 1] - middle[1]) / (0.2 * unit), 0.0, 1.0)[:, None]
    places += lower * (size - 1.0) * (places - middle) * (1.0, 1.0, 0.0)
    other = replace(rig, vertices=places.astype(np.float32))
    moved = [
        np.linalg.norm(motions[:, one.landmarks], axis=2)
        for one in (rig, other)
        for _, motions in [expression_keys(one, keys)]
    ]
    ratios = [
        moved[1][row, chosen].mean() / moved[0][row, chosen].mean() for row, chosen in enumerate((LIPS, CHIN, BROWS))
    ]
    np.testing.assert_allclose(ratios, [size, size, 1.0], rtol=0.2)

"""Sets of shape keys made for a head, and their figures."""

import numpy as np
import pytest

from facemime.core.bake.expression_keys import expression_keys
from facemime.core.bake.key_quality import findings, key_qualities
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.face.landmarks import lid_gaps, lip_gaps
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_presets import ESSENTIAL, best_preset
from facemime.core.heads.rig import Part, built_in_head
from facemime.core.heads.slits import SlitContact
from facemime.core.mesh.triangles import crossing_pairs
from tests.helpers.parted_heads import with_parts
from tests.helpers.thorough import first_of

RIG = built_in_head()
LABELS = {
    "arkit": "ARKit 52, Rokoko, Faceit",
    "vrm": "VRM 1",
    "vrm0": "VRM 0",
    "oculus": "Oculus",
    "facegen": "FaceGen",
}


@pytest.fixture(scope="module", params=first_of(KEY_SETS))
def made(request):
    keys = KEY_SETS[request.param]
    _, motions = expression_keys(RIG, keys)
    return keys, motions, {quality.name: quality for quality in key_qualities(RIG, keys, motions)}


@pytest.mark.parametrize("name", list(KEY_SETS))
def test_the_mapping_of_each_set_is_recognised_by_its_keys(name):
    keys = KEY_SETS[name]
    found = best_preset(keys.names)
    assert found.name == LABELS[name] and set(found.keys) <= set(keys.names)
    assert found.sources >= ESSENTIAL or name == "oculus"  # visemes have no lids


def test_arkits_set_consists_of_single_units():
    assert KEY_SETS["arkit"].names == COEFFICIENTS
    np.testing.assert_array_equal(KEY_SETS["arkit"].mixtures, np.eye(len(COEFFICIENTS)))


def test_shut_means_shut_for_lids_and_lips(made):
    keys, motions, qualities = made
    shut = [name for name in keys.names if "blink" in name.lower()]
    points = RIG.vertices[RIG.landmarks]
    for name in shut:
        assert qualities[name].eyes < 0.05
        after = (RIG.vertices + motions[keys.names.index(name)])[RIG.landmarks]
        left = (lid_gaps(after) / lid_gaps(points))[slice(2, 4) if name.lower().endswith(("left", "_l")) else slice(2)]
        assert np.abs(left).max() < 0.05
    for name in keys.sealed:
        after = (RIG.vertices + motions[keys.names.index(name)])[RIG.landmarks]
        assert lip_gaps(after).max() < lip_gaps(points).min()
        assert qualities[name].lips < 0.016
    assert all(np.isnan(quality.eyes) for name, quality in qualities.items() if name not in shut)


def test_hardly_any_triangle_passes_through_another(made):
    _, _, qualities = made
    assert max(quality.crossing for quality in qualities.values()) <= 10


def test_every_key_but_those_of_rest_moves_something(made):
    _, _, qualities = made
    still = {name for name, quality in qualities.items() if quality.moved == 0.0}
    assert still <= {"neutral", "Neutral", "viseme_sil", "tongueOut"}
    assert all(quality.moved < 0.6 for quality in qualities.values())


def test_a_closed_mouth_on_an_open_jaw_seals_the_lips():
    keys = KEY_SETS["arkit"]
    _, motions = expression_keys(RIG, keys)
    both = motions[keys.names.index("jawOpen")] + motions[keys.names.index("mouthClose")]
    assert lip_gaps((RIG.vertices + both)[RIG.landmarks]).max() < 0.015 * RIG.eye_distance
    assert lip_gaps((RIG.vertices + both)[RIG.landmarks]).min() > 0.0


def test_mixtures_move_all_parts():
    rig = with_parts()
    keys = KEY_SETS["vrm"]
    names, motions = expression_keys(rig, keys)
    kinds = rig.kinds
    up, left = motions[names.index("lookUp")], motions[names.index("lookLeft")]
    for eye in (Part.EYE_RIGHT, Part.EYE_LEFT):
        front = np.argmin(rig.all_vertices[kinds == eye, 2])
        assert up[kinds == eye][front, 1] < 0.0  # y points down
        assert left[kinds == eye][front, 0] > 0.0  # to the performer's left, on the viewer's right
    assert np.abs(motions[names.index("aa")][kinds == Part.TEETH_LOWER]).max() > 0.05 * rig.eye_distance
    assert np.abs(motions[names.index("neutral")]).max() < 1e-6


@pytest.mark.thorough
def test_the_figures_of_a_key_report_openings_and_crossings():
    head, keys = load_head(), KEY_SETS["arkit"]
    qualities = {quality.name: quality for quality in key_qualities(RIG, keys, head.units)}
    assert qualities["mouthShrugLower"].crossing > 50 and qualities["browInnerUp"].crossing == 0
    assert qualities["jawOpen"].moved == pytest.approx(
        np.linalg.norm(head.units[head.unit_names.index("jawOpen")], axis=1).max() / RIG.eye_distance
    )
    half = key_qualities(RIG, keys, 0.5 * head.units)
    assert {q.name: q for q in half}["eyeBlinkLeft"].eyes == pytest.approx(0.5, abs=0.1)
    told = findings(half)
    assert told[0].startswith("Shut eyes stay open by") and told[1].startswith("Sealed lips stay apart by")
    assert findings([]) == []


def test_lips_that_cross_are_moved_apart_and_others_keep_their_shape():
    head = load_head()
    contact = SlitContact(RIG.vertices, RIG.faces, RIG.landmarks, RIG.region_weights)
    opened = head.vertices + head.units[head.unit_names.index("jawOpen")]
    same = opened.copy()
    contact.resolve(same)
    np.testing.assert_allclose(same, opened, atol=1e-3 * RIG.eye_distance)
    crossed = head.vertices + head.units[head.unit_names.index("mouthPucker")]
    parted = crossed.copy()
    contact.resolve(parted)
    triangles = RIG.faces[:, :3]
    assert len(crossing_pairs(crossed, triangles)) > 20 * max(len(crossing_pairs(parted, triangles)), 1)
    assert np.linalg.norm(parted - crossed, axis=1).max() < 0.05 * RIG.eye_distance

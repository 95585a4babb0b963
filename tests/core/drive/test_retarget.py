"""From a performer's landmarks to those of a head, and the motion of the head."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.retarget import Retargeter
from facemime.core.errors import HeadError, SourceError
from facemime.core.face.landmarks import (
    BROWS,
    CHIN,
    LIPS,
    LOWER_LIDS,
    LOWER_LIPS,
    MOUTH_CORNERS,
    UPPER_LIDS,
    UPPER_LIPS,
    from_ibug,
    lid_gaps,
)
from facemime.core.face.rotation import euler_to_matrix, fit_rotation, matrix_to_euler
from facemime.core.heads.built_in import load_head
from facemime.core.heads.eyeballs import EyeballContact
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.takes.neutral import Neutral, calibrate
from tests.helpers.built_in import performer
from tests.helpers.takes import make_take

ANGLES = st.floats(-1.2, 1.2)


@given(ANGLES, ANGLES, ANGLES)
def test_euler_angles_survive_conversion_to_a_matrix_and_back(pitch, yaw, roll):
    rotation = euler_to_matrix(pitch, yaw, roll)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix_to_euler(rotation), (pitch, yaw, roll), atol=1e-9)


@given(ANGLES, ANGLES, ANGLES)
def test_a_rotation_is_recovered_from_rotated_points(pitch, yaw, roll):
    rotation = euler_to_matrix(pitch, yaw, roll)
    points = np.random.default_rng(0).normal(size=(6, 3))
    np.testing.assert_allclose(fit_rotation(points, points @ rotation.T), rotation, atol=1e-9)


def test_the_neutral_face_moves_nothing(rig):
    face = performer(rig)
    retargeter = Retargeter(face, rig.vertices[rig.landmarks])
    assert np.abs(retargeter.displacements(face)).max() == 0.0


def test_a_performers_closed_eye_closes_the_heads(rig):
    face = performer(rig)
    closed = face.copy()
    upper, lower = from_ibug((37, 38, 43, 44)), from_ibug((41, 40, 47, 46))
    closed[upper, 1] = face[lower, 1]
    points = rig.vertices[rig.landmarks]
    moved = points + Retargeter(face, points).displacements(closed)
    opening = (points[lower, 1] - points[upper, 1]).mean()
    assert np.abs(moved[lower, 1] - moved[upper, 1]).max() < 0.1 * opening


@given(st.floats(-0.2, 0.2), st.floats(0.5, 2.0), st.floats(0.5, 2.0))
def test_a_shut_eye_shuts_both_pairs_of_lids_however_the_openings_of_the_two_eyes_are_shaped(uneven, outer, inner):
    rig = built_in_head()
    face, points = performer(rig), np.array(rig.vertices[rig.landmarks], dtype=float)
    for pair, factor in zip(zip(UPPER_LIDS, LOWER_LIDS, strict=True), (outer, inner, inner, outer), strict=True):
        points[pair[0], 1] += (1.0 - factor) * (points[pair[1], 1] - points[pair[0], 1])
    shut, gaps = face.copy(), face[LOWER_LIDS, 1] - face[UPPER_LIDS, 1]
    shut[UPPER_LIDS, 1] = face[LOWER_LIDS, 1] - uneven * np.array([1.0, -1.0, 1.0, -1.0]) * gaps.mean()
    moved = points + Retargeter(face, points, compensate=True).displacements(shut)
    eyes = np.repeat(lid_gaps(shut).reshape(2, 2).mean(axis=1) / lid_gaps(face).reshape(2, 2).mean(axis=1), 2)
    np.testing.assert_allclose(lid_gaps(moved), np.maximum(eyes, 0.0) * lid_gaps(points), atol=0.003 * rig.eye_distance)


@given(st.floats(0.05, 2.0))
def test_the_heads_eyes_are_open_by_the_same_share_as_the_performers(share):
    rig = built_in_head()
    face, points = performer(rig), np.array(rig.vertices[rig.landmarks], dtype=float)
    current = face.copy()
    current[UPPER_LIDS, 1] = face[LOWER_LIDS, 1] - share * (face[LOWER_LIDS, 1] - face[UPPER_LIDS, 1])
    moved = points + Retargeter(face, points).displacements(current)
    np.testing.assert_allclose(lid_gaps(moved) / lid_gaps(points), share, rtol=0.02, atol=0.005)


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_lips_meet_but_never_cross_and_lids_overlap_a_little_at_most(rig, seed):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    rng = np.random.default_rng(seed)
    moved = points + Retargeter(face, points).displacements(face + rng.normal(0.0, 0.1, face.shape))
    upper, lower = from_ibug((61, 62, 63)), from_ibug((67, 66, 65))
    crossed_at_rest = np.maximum(points[upper, 1] - points[lower, 1], 0.0)
    assert (moved[upper, 1] - moved[lower, 1] <= crossed_at_rest + 1e-9).all()
    assert (lid_gaps(moved) >= np.minimum(lid_gaps(points), 0.0) - 0.0201 * np.abs(lid_gaps(points))).all()


def test_a_closing_lid_rolls_over_the_eyeball(rig):
    rng = np.random.default_rng(0)
    skin = rng.normal(size=(500, 3))
    skin *= (rng.uniform(1.0, 1.3, 500) / np.linalg.norm(skin, axis=1))[:, None]
    contact = EyeballContact(skin, np.ones(500), np.array([[0.0, 0.0, 0.0, 1.1]]))
    moved = (skin * 0.8).astype(np.float32)
    contact.resolve(moved)
    distance, rest = np.linalg.norm(moved, axis=1), np.linalg.norm(skin, axis=1)
    assert (distance >= np.minimum(rest, 1.1) - 1e-5).all()
    # In front of the eyeball the lids keep their height, so that they meet there; above and below they move outwards.
    front = np.abs(skin[:, 1]) < 0.2 * rest
    np.testing.assert_allclose(moved[front, 1], 0.8 * skin[front, 1], atol=0.01)
    sideways = moved[:, [0, 2]] / np.linalg.norm(moved[:, [0, 2]], axis=1)[:, None]
    np.testing.assert_allclose(sideways, skin[:, [0, 2]] / np.linalg.norm(skin[:, [0, 2]], axis=1)[:, None], atol=1e-4)


def test_lids_that_the_tracker_leaves_a_little_open_still_shut_the_heads_eyes(rig):
    face = performer(rig)
    upper, lower = from_ibug((37, 38, 43, 44)), from_ibug((41, 40, 47, 46))
    shapes = np.tile(face, (100, 1, 1))
    shapes[60:64, upper, 1] += 0.75 * (face[lower, 1] - face[upper, 1])
    neutral = calibrate(make_take(shapes), start=0.0)
    assert abs(neutral.shut - 0.25) < 0.02
    points = rig.vertices[rig.landmarks]
    driver = HeadDriver(rig, neutral)
    moved = points + driver.retargeter.displacements(shapes[61])
    opening = (points[lower, 1] - points[upper, 1]).mean()
    assert np.abs(moved[lower, 1] - moved[upper, 1]).max() < 0.15 * opening
    assert calibrate(make_take(shapes[:50]), start=0.0).shut == 0.0


def test_eyes_that_open_wide_or_shut_are_shown_as_tracked(rig):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    wide, shut = face.copy(), face.copy()
    wide[UPPER_LIDS, 1] -= 0.03
    shut[UPPER_LIDS, 1] = face[LOWER_LIDS, 1]
    plain, more = (Retargeter(face, points, compensate=compensate) for compensate in (False, True))
    for shape in (wide, shut):
        np.testing.assert_allclose(
            more.displacements(shape)[UPPER_LIDS], plain.displacements(shape)[UPPER_LIDS], atol=1e-5
        )


@given(st.floats(-0.15, 0.15), st.floats(0.5, 2.0), st.booleans())
def test_shut_lips_that_move_together_stay_shut(away, stretched, compensate):
    rig = built_in_head()
    face, points = performer(rig), rig.vertices[rig.landmarks] * (1.0, stretched, 1.0)
    current = face.copy()
    current[LIPS, 1] += away
    moved = Retargeter(face, points, compensate=compensate).displacements(current)
    np.testing.assert_allclose(moved[LOWER_LIPS, 1], moved[UPPER_LIPS, 1], atol=1e-6)


def opened(rig: HeadRig, parted: float, *, compensate: bool = True, fitted: bool = False) -> float:
    """How much farther apart the head's inner lips are than at rest when the performer's are, by `parted`."""
    neutral = performer(rig)
    shape = neutral.copy()
    shape[LOWER_LIPS, 1] += parted
    retargeter = Retargeter(neutral, rig.vertices[rig.landmarks], compensate=compensate, fitted=fitted)
    moved = retargeter.displacements(shape)
    return float((moved[LOWER_LIPS, 1] - moved[UPPER_LIPS, 1]).mean() / rig.eye_distance)


@given(st.floats(0.0, 0.0099))
def test_tracked_lips_that_are_hardly_parted_are_shut(rig, parted):
    assert opened(rig, parted) == pytest.approx(0.0, abs=1e-9)
    assert opened(rig, parted, compensate=False) == pytest.approx(parted, rel=0.5, abs=1e-9)


@given(st.floats(0.0351, 0.12))
def test_tracked_lips_that_are_clearly_parted_are_as_far_apart_as_they_are_seen(rig, parted):
    assert opened(rig, parted) == pytest.approx(parted / 0.1 * opened(rig, 0.1), rel=1e-6)


@given(st.floats(-0.02, 0.1), st.floats(0.0, 0.05))
def test_lips_open_on_the_farther_they_are_parted_and_never_with_a_jump(rig, parted, further):
    first, second = opened(rig, parted), opened(rig, parted + further)
    assert -1e-9 <= second - first <= 4.0 * further + 1e-9


@given(st.floats(0.12, 0.4))
def test_wide_mouths_open_by_a_smaller_share_and_their_corners_follow_the_lower_lip(rig, parted):
    share = opened(rig, parted) / parted / (opened(rig, 0.1) / 0.1)
    assert share == pytest.approx((0.12 + 0.72 * (parted - 0.12)) / parted, abs=0.02)
    assert opened(rig, parted, fitted=True) == pytest.approx(parted / 0.1 * opened(rig, 0.1, fitted=True), rel=1e-6)


@given(st.floats(0.06, 0.4))
def test_the_lower_lip_of_an_open_mouth_is_rounder_than_it_is_tracked_and_its_sides_are_alike(rig, parted):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    shape = face.copy()
    shape[LOWER_LIPS, 1] += parted * np.array([0.8, 1.0, 0.8])
    shown, fitted = (
        Retargeter(face, points, compensate=True, fitted=fitted).displacements(shape) for fitted in (False, True)
    )
    left, middle, right = shown[LOWER_LIPS, 1]
    tracked = fitted[LOWER_LIPS, 1]
    assert left == pytest.approx(right, rel=1e-2)
    assert 0.9 < left / middle < 1.0
    assert left / middle > tracked[0] / tracked[1] + 0.05
    corners = shown[MOUTH_CORNERS, 0]
    assert corners[0] == pytest.approx(-corners[1], rel=1e-6) and corners[1] > 0.0


@pytest.mark.parametrize("teeth", [0.0, 0.4, 1.0, np.nan])
def test_the_chin_sinks_the_less_the_more_surely_teeth_are_shut_and_all_else_moves_as_before(rig, teeth):
    retargeter = Retargeter(performer(rig), rig.vertices[rig.landmarks], compensate=True)
    opened, raised = (performer(rig) + np.array([0.0, y, 0.0]) for y in (0.05, -0.05))
    known, shown = retargeter.displacements(opened), retargeter.displacements(opened, teeth)
    share = 1.0 if np.isnan(teeth) else 1.0 - teeth
    np.testing.assert_allclose(shown[CHIN, 1], share * known[CHIN, 1], atol=1e-12)
    others = np.setdiff1d(np.arange(66), CHIN)
    np.testing.assert_array_equal(shown[others], known[others])
    np.testing.assert_array_equal(shown[CHIN][:, [0, 2]], known[CHIN][:, [0, 2]])
    np.testing.assert_array_equal(retargeter.displacements(raised, teeth), retargeter.displacements(raised))
    both = retargeter.displacements(np.array([opened, raised]), [teeth, teeth])
    np.testing.assert_allclose(both[0], shown, atol=1e-12)


def test_a_mouth_that_moves_sideways_keeps_its_shape_and_moves_as_it_is_tracked(rig):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    aside = face.copy()
    aside[LIPS, 0] += 0.05
    plain, shown = (Retargeter(face, points, compensate=on).displacements(aside)[LIPS] for on in (False, True))
    np.testing.assert_allclose(shown, plain, atol=1e-9)


def test_a_round_mouth_is_narrowed_at_its_corners_alone_unless_keys_are_fitted_to_it(rig):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    narrow = face.copy()
    narrow[LIPS, 0] *= 0.8
    plain, shown, fitted = (
        Retargeter(face, points, compensate=compensate, fitted=fitted).displacements(narrow)
        for compensate, fitted in ((False, False), (True, False), (True, True))
    )
    between = np.setdiff1d(LIPS, MOUTH_CORNERS)
    np.testing.assert_allclose(shown[between, 0], plain[between, 0], atol=1e-9)
    np.testing.assert_allclose(shown[MOUTH_CORNERS, 0], fitted[MOUTH_CORNERS, 0], atol=1e-9)
    assert (np.abs(fitted[between, 0]) >= 1.3 * np.abs(plain[between, 0])).all()


def test_tracked_brows_move_farther_as_a_whole_and_their_inner_ends_less_than_the_outer_ones(rig):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    raised = face.copy()
    raised[BROWS, 1] -= np.linspace(0.02, 0.06, 10)
    plain, more = (Retargeter(face, points, compensate=on).displacements(raised)[BROWS, 1] for on in (False, True))
    for brow, outwards in ((slice(0, 5), -1.0), (slice(5, 10), 1.0)):
        assert 1.05 < more[brow].mean() / plain[brow].mean() < 1.2
        tilted = outwards * np.diff(more[brow] - plain[brow]) / plain[brow].mean()
        np.testing.assert_allclose(tilted, tilted[0], rtol=1e-9)
        assert 0.1 < 3.0 * tilted[0] < 0.2


def test_planar_mode_keeps_depth_and_strength_scales_a_region(rig):
    face, points = performer(rig), rig.vertices[rig.landmarks]
    other = face + np.random.default_rng(1).normal(0.0, 0.05, face.shape)
    full = Retargeter(face, points).displacements(other)
    planar = Retargeter(face, points, mode="planar").displacements(other)
    np.testing.assert_array_equal(planar[:, 2], 0.0)
    np.testing.assert_allclose(planar[:, :2], full[:, :2])
    half = Retargeter(face, points, strength=(1.0, 1.0, 0.5)).displacements(other)
    chin, brows = from_ibug(range(5, 12)), from_ibug(range(17, 27))
    np.testing.assert_allclose(half[chin], 0.5 * full[chin])
    np.testing.assert_allclose(half[brows], full[brows])


def test_a_wide_mouth_on_a_narrow_face_opens_as_far_relative_to_the_face(rig):
    points = rig.vertices[rig.landmarks]
    face = performer(rig)
    other = face + np.random.default_rng(2).normal(0.0, 0.05, face.shape)
    lower = from_ibug([57])
    once = Retargeter(face, points).displacements(other)[lower]
    twice = Retargeter(face, points * (1.0, 2.0, 1.0)).displacements(other)[lower]
    np.testing.assert_allclose(twice[:, 1], 2 * once[:, 1], rtol=1e-6)
    np.testing.assert_allclose(twice[:, 0], once[:, 0], rtol=1e-6)


def test_the_jaw_turns_with_the_chin_and_the_head_with_the_pose(rig):
    face = performer(rig)
    neutral = Neutral(face, np.eye(3), np.array([100.0, 320.0, 240.0]), 0.0, 1.0)
    driver = HeadDriver(rig, neutral)
    take = make_take(face[None])
    rest = driver.frame(take.result(0))
    np.testing.assert_allclose(rest.jaw, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(rest.vertices, rig.vertices, atol=1e-6)
    opened = face.copy()
    opened[from_ibug([*range(4, 13), *range(55, 60), *range(65, 68)]), 1] += 0.2
    take.pose[0, 1:4] = (0.1, 0.2, 0.05)
    frame = driver.frame(make_take(opened[None]).result(0))
    assert matrix_to_euler(frame.jaw)[0] > 0.05
    turned = driver.frame(take.result(0))
    np.testing.assert_allclose(matrix_to_euler(turned.rotation), (0.1, 0.2, 0.05), atol=1e-9)


def test_a_rig_whose_landmarks_do_not_fit_the_mesh_is_refused(rig):
    with pytest.raises(HeadError, match="no longer exist"):
        HeadRig(rig.vertices[:100], rig.landmarks, rig.region_weights[:, :100], rig.jaw_pivot)


def test_flat_performers_and_flat_heads_have_different_errors():
    head = load_head()
    landmarks = head.vertices[head.landmarks].astype(float)
    flat = landmarks * (1.0, 0.0, 1.0)
    with pytest.raises(SourceError, match="Choose another neutral"):
        Retargeter(flat, landmarks)
    with pytest.raises(HeadError, match="Bind them"):
        Retargeter(landmarks, flat)

"""Lids that meet along their whole rims (method.md, section 5.6)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from facemime.core.deform.lid_rims import LidRims, lid_rims
from facemime.core.deform.rbf import RBFDeformer
from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, LOWER_LIDS, N_LANDMARKS, UPPER_LIDS
from facemime.core.heads.regions import membership
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.numeric.arrays import FloatArray


@pytest.fixture(scope="module")
def rig() -> HeadRig:
    """The built-in head with tall eyes, whose lids are steep between the corners and the landmarks."""
    rig = built_in_head()
    places = np.array(rig.vertices, dtype=np.float64)
    for eye in (EYE_RIGHT, EYE_LEFT):
        middle = places[rig.landmarks[eye]].mean(axis=0)
        near = np.exp(-np.square((places - middle) / (0.25 * rig.eye_distance)).sum(axis=1))
        places[:, 1] += near * (places[:, 1] - middle[1])
    return replace(rig, vertices=places)


def rims_of(rig: HeadRig) -> list[LidRims]:
    return lid_rims(rig.vertices, rig.faces, rig.landmarks, rig.region_weights)


def deformer(rig: HeadRig, rims: list[LidRims]) -> RBFDeformer:
    points = np.asarray(rig.vertices)[rig.landmarks]
    return RBFDeformer(rig.vertices, points, rig.region_weights, membership(), sigma=0.12 * rig.eye_distance, rims=rims)


def shutting(rig: HeadRig) -> FloatArray:
    points, moved = np.asarray(rig.vertices)[rig.landmarks], np.zeros((N_LANDMARKS, 3))
    moved[UPPER_LIDS] = points[LOWER_LIDS] - points[UPPER_LIDS]
    return moved


def widest_gap(rims: list[LidRims], places: NDArray[np.floating]) -> float:
    """Largest distance down the face between the rims of both eyes."""
    gaps = []
    for rim in rims:
        lower = np.interp(rim.upper.at, rim.lower.at, places[rim.lower.vertices, 1])
        gaps.append(np.abs(lower - places[rim.upper.vertices, 1]).max())
    return float(max(gaps))


def test_lids_meet_along_their_whole_rims_when_their_landmarks_do(rig):
    rims = rims_of(rig)
    assert len(rims) == 2
    before, after = (widest_gap(rims, deformer(rig, used).deform(shutting(rig))) for used in ([], rims))
    assert before > 0.012 * rig.eye_distance
    assert after < 0.2 * before


def test_lids_that_rise_from_below_meet_the_upper_ones_too(rig):
    rims, moved = rims_of(rig), np.zeros((N_LANDMARKS, 3))
    points = np.asarray(rig.vertices)[rig.landmarks]
    moved[LOWER_LIDS] = points[UPPER_LIDS] - points[LOWER_LIDS]
    before, after = (widest_gap(rims, deformer(rig, used).deform(moved)) for used in ([], rims))
    assert after < 0.7 * before


def test_landmarks_and_skin_away_from_the_lids_move_as_without_rims(rig):
    moved = shutting(rig)
    without, found = (deformer(rig, used).deform(moved) for used in ([], rims_of(rig)))
    change = np.linalg.norm(found - without, axis=1) / rig.eye_distance
    assert change[rig.landmarks].max() < 1e-3
    points = np.asarray(rig.vertices)[rig.landmarks[np.concatenate([EYE_RIGHT, EYE_LEFT])]]
    away = np.linalg.norm(np.asarray(rig.vertices)[:, None] - points, axis=2).min(axis=1)
    assert change[away > 0.3 * rig.eye_distance].max() == 0.0
    nothing = deformer(rig, rims_of(rig)).deform(np.zeros((N_LANDMARKS, 3)))
    np.testing.assert_allclose(nothing, rig.vertices, atol=1e-6)


def test_eyes_that_are_shut_or_joined_to_their_lids_have_no_rims(rig):
    places = np.array(rig.vertices, dtype=np.float64)
    places[rig.landmarks[UPPER_LIDS[:2]]] = places[rig.landmarks[LOWER_LIDS[:2]]]
    assert [rim.slit.upper[0] for rim in rims_of(replace(rig, vertices=places))] == [EYE_LEFT[0]]
    rims, faces = rims_of(rig), np.array(rig.faces)
    for rim in rims:
        between = ~np.isin(rim.lower.vertices, rig.landmarks)
        for vertex, at in zip(rim.lower.vertices[between], rim.lower.at[between], strict=True):
            faces[faces == vertex] = rim.upper.vertices[np.abs(rim.upper.at - at).argmin()]
    assert rims_of(replace(rig, faces=faces)) == []


def test_a_rim_in_the_wrong_place_moves_no_more_than_half_the_opening(rig):
    rims = rims_of(rig)
    corner = rig.landmarks[0]
    astray = [replace(rim, lower=replace(rim.lower, vertices=np.full_like(rim.lower.vertices, corner))) for rim in rims]
    without, found = (deformer(rig, used).deform(shutting(rig)) for used in ([], astray))
    opening = np.linalg.norm(shutting(rig)[UPPER_LIDS], axis=1).max()
    assert np.linalg.norm(found - without, axis=1).max() < 0.75 * opening


def test_the_open_share_is_that_of_the_area_between_the_rims_and_none_where_they_overlap(rig):
    places = np.asarray(rig.vertices, dtype=np.float64)
    for eye in rims_of(rig):
        assert eye.open_share(places) == pytest.approx(1.0)
        halved, shut, past = places.copy(), places.copy(), places.copy()
        for posed, share in ((halved, 0.5), (shut, 1.0), (past, 1.2)):
            posed[eye.rows] += eye.lowered(share * eye.gaps(places))
        assert eye.open_share(halved) == pytest.approx(0.5, rel=0.05)
        np.testing.assert_allclose(eye.gaps(shut), 0.0, atol=0.01 * rig.eye_distance)
        assert eye.open_share(past) < 0.01

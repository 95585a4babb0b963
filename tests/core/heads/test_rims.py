"""The rims of lids and lips, and places along them that correspond on all heads (method.md, section 5.5)."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.face.landmarks import EYE_CORNERS, LOWER_LIPS, MOUTH_CORNERS, UPPER_LIPS
from facemime.core.heads.built_in import WOMAN_FILE, Head, load_head
from facemime.core.heads.rims import EYES, MOUTH, N_RIM_PLACES, corresponding, rim_places, rims_of

BETWEEN = np.concatenate([slit.between for slit in (*EYES, MOUTH)])


@pytest.fixture(params=[None, WOMAN_FILE], ids=["man", "woman"])
def head(request: pytest.FixtureRequest) -> Head:
    return load_head() if request.param is None else load_head(request.param)


def test_rims_lead_from_corner_to_corner_through_their_landmarks(head: Head) -> None:
    places = np.asarray(head.vertices, dtype=np.float64)
    for slit in (*EYES, MOUTH):
        rims = rims_of(places, head.faces, head.landmarks, slit)
        assert rims is not None
        for rim, line in zip(rims, (slit.upper, slit.lower), strict=True):
            at = {int(vertex): float(position) for vertex, position in zip(rim.vertices, rim.at, strict=True)}
            assert [at[int(v)] for v in head.landmarks[line]] == pytest.approx(range(len(line)))
            assert (np.diff(rim.at) > 0.0).all()


def test_landmarks_between_the_corners_are_those_of_lids_and_inner_lips_alone() -> None:
    assert len(BETWEEN) == len(set(BETWEEN.tolist())) == 12
    assert not np.isin(BETWEEN, [*EYE_CORNERS, *MOUTH_CORNERS, UPPER_LIPS[1], LOWER_LIPS[1]]).any()


def test_places_do_not_depend_on_where_between_the_corners_the_landmarks_are(head: Head) -> None:
    before = rim_places(head.vertices, head.faces, head.landmarks)
    assert before.shape == (N_RIM_PLACES, 3) and np.isfinite(before).all()
    rims = rims_of(np.asarray(head.vertices, dtype=np.float64), head.faces, head.landmarks, MOUTH)
    assert rims is not None
    moved = head.landmarks.copy()
    for rim, lip in zip(rims, (UPPER_LIPS, LOWER_LIPS), strict=True):
        for landmark, beside in ((lip[0], 1), (lip[2], -1)):
            moved[landmark] = rim.vertices[np.flatnonzero(rim.vertices == head.landmarks[landmark])[0] + beside]
    assert (moved != head.landmarks).sum() == 4
    np.testing.assert_allclose(rim_places(head.vertices, head.faces, moved), before, atol=1e-9)


def test_landmarks_are_kept_where_one_head_has_no_rim() -> None:
    man, woman = load_head(), load_head(WOMAN_FILE)
    rims = [rim_places(one.vertices, one.faces, one.landmarks) for one in (man, woman)]
    points = [one.vertices[one.landmarks].astype(np.float64) for one in (man, woman)]
    first, second = corresponding((points[0], rims[0]), (points[1], rims[1]))
    assert len(first) == len(second) == 66 - len(BETWEEN) + N_RIM_PLACES
    rims[1][-1] = np.nan  # the mouth
    first, second = corresponding((points[0], rims[0]), (points[1], rims[1]))
    assert len(first) == len(second) == 66 - len(np.concatenate([slit.between for slit in EYES])) + 44
    for lip in (*UPPER_LIPS, *LOWER_LIPS):
        row = np.flatnonzero((first == points[0][lip]).all(axis=1))
        np.testing.assert_array_equal(second[row], points[1][[lip]])
    unknown = rim_places(man.vertices, None, man.landmarks)
    assert np.isnan(unknown).all()
    np.testing.assert_array_equal(corresponding((points[0], unknown), (points[1], rims[1]))[1], points[1])


def test_a_path_that_goes_around_is_no_rim() -> None:
    head = load_head()
    places = np.array(head.vertices, dtype=np.float64)
    middle, side = places[head.landmarks[LOWER_LIPS[1:]]]
    assert rims_of(places, head.faces, head.landmarks, MOUTH) is not None
    # All skin between two landmarks lies farther out, so that each path climbs up and down again.
    between = (places[:, 0] > middle[0] + 1e-4) & (places[:, 0] < side[0] - 1e-4)
    places[between, 2] -= 0.9 * np.linalg.norm(side - middle)
    assert rims_of(places, head.faces, head.landmarks, MOUTH) is None

"""Greedy selection of control points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.control_points.difference import SkinDifference
from facemime.core.control_points.greedy import START, greedy_select
from facemime.core.control_points.select import parse_landmarks, select_control_points
from facemime.core.control_points.selection import from_json, to_json
from facemime.core.errors import HeadError, SourceError
from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.built_in import load_head
from facemime.core.heads.regions import DEFAULT_KERNEL, REGIONS, membership, region_sigmas
from facemime.core.heads.rig import built_in_head
from facemime.core.mesh.kernels import get_kernel
from tests.helpers.takes import performance

HEAD = load_head()
POINTS = HEAD.vertices[HEAD.landmarks].astype(float)
UNITS = HEAD.units[:, HEAD.landmarks].astype(float)


def test_a_loose_tolerance_needs_fewer_points_than_a_tight_one():
    loose, tight = (greedy_select(POINTS, UNITS, tolerance=t) for t in (0.05, 0.005))
    assert loose.reached and tight.reached
    assert len(loose.landmarks) < len(tight.landmarks)
    assert loose.steps[-1].error <= 0.05 and tight.steps[-1].error <= 0.005


@pytest.mark.thorough
@settings(max_examples=12)
@given(st.integers(0, 1000), st.integers(3, 66))
def test_the_number_of_points_is_limited_and_each_region_has_one(seed, count):
    motion = np.random.default_rng(seed).normal(0.0, 0.002, (4, 66, 3))
    selection = greedy_select(POINTS, motion, tolerance=1e-5, max_points=count)
    assert len(selection.landmarks) <= count
    assert selection.membership.any(axis=1).all()
    assert not (selection.membership & ~membership()).any()


def test_the_same_take_gives_the_same_steps():
    assert greedy_select(POINTS, UNITS, max_points=25).steps == greedy_select(POINTS, UNITS, max_points=25).steps


def test_the_last_step_states_the_true_worst_error_and_its_place():
    selection = greedy_select(POINTS, UNITS, tolerance=0.02)
    last = selection.steps[-1]
    assert 0 <= last.frame < len(UNITS) and last.points == len(selection.landmarks)
    width = np.linalg.norm(POINTS[0] - POINTS[16])
    # A landmark at rest is wrong where the points around it move it along.
    around = np.linalg.norm(POINTS - POINTS[last.worst], axis=1) < 0.2 * width
    assert np.linalg.norm(UNITS[last.frame, around], axis=1).max() / width >= last.error


def test_a_motionless_take_keeps_one_point_per_region():
    selection = greedy_select(POINTS, np.zeros((3, 66, 3)))
    assert selection.reached
    np.testing.assert_array_equal(selection.membership.sum(axis=1), [1, 1, 1])


def test_required_points_stay_and_excluded_ones_never_appear():
    always, never = from_ibug([33, 7]).tolist(), from_ibug([17, 57]).tolist()
    selection = greedy_select(POINTS, UNITS, tolerance=0.01, always=always, never=never)
    assert set(always) <= set(selection.landmarks.tolist())
    assert not set(never) & set(selection.landmarks.tolist())
    assert selection.reason(always[0]) == "added by hand"


def test_every_starting_point_names_its_muscle_and_belongs_to_its_region():
    for muscles, region in zip(START, REGIONS, strict=True):
        assert set(from_ibug(muscles)) <= set(region.landmarks)
        assert all(muscles.values())
    assert len(START[0]) == 12


def test_a_point_in_the_selection_has_a_reason():
    selection = greedy_select(POINTS, UNITS, max_points=30)
    assert all(selection.reason(int(landmark)) for landmark in selection.landmarks)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"max_points": 2}, "At least 3"), ({"never": range(66)}, "no landmarks left")],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(HeadError, match=message):
        greedy_select(POINTS, UNITS, **options)


def test_invalid_motion_is_refused():
    with pytest.raises(HeadError, match="displacements must be finite"):
        greedy_select(POINTS, np.full((1, 66, 3), np.nan))


def test_frames_are_numbered_as_in_the_take_lost_ones_included():
    take = performance()
    selection = select_control_points(built_in_head(), take, tolerance=0.003)
    assert all(take.found[step.frame] for step in selection.steps)


def test_a_selection_written_and_read_is_the_same():
    selection = greedy_select(POINTS, UNITS, max_points=20)
    again = from_json(to_json(selection))
    np.testing.assert_array_equal(again.membership, selection.membership)
    assert again.steps == selection.steps and again.tolerance == selection.tolerance


@pytest.mark.parametrize("text", ["", "{}", '{"format": "other"}', "[1, 2]", "[" * 100_000])
def test_invalid_selections_are_refused(text):
    with pytest.raises(SourceError, match="not a control point file"):
        from_json(text)


def test_landmarks_are_written_as_ibug_numbers_and_ranges():
    assert parse_landmarks("17, 19-21,61") == from_ibug([17, 19, 20, 21, 61]).tolist()
    assert parse_landmarks("") == []
    assert parse_landmarks("0-67") == list(range(66))
    for text in ("nose", "60", "99", "5-99", "3-1"):
        with pytest.raises(HeadError, match="not a list of landmarks"):
            parse_landmarks(text)


def difference() -> SkinDifference:
    kernel = get_kernel(DEFAULT_KERNEL)
    return SkinDifference(POINTS, kernel, region_sigmas(POINTS, kernel), UNITS, HEAD.vertices, HEAD.regions)


def test_the_skin_difference_is_zero_for_all_landmarks_and_positive_for_fewer():
    measure, chosen = difference(), membership()
    nothing = measure(chosen)
    chosen[:, from_ibug([62])] = False
    one = measure(chosen)
    chosen[:, from_ibug([51, 66])] = False
    assert abs(nothing) < 1e-9 * one and one < measure(chosen)
    chosen[2] = False
    assert measure(chosen) == np.inf


def test_when_points_run_out_they_are_exchanged_for_better_ones():
    measure = difference()
    selection = greedy_select(POINTS, UNITS, tolerance=1e-4, max_points=33, skin=(HEAD.vertices, HEAD.regions))
    assert len(selection.landmarks) == 33 and not selection.reached
    first = next(i for i, step in enumerate(selection.steps) if "exchanged" in step.reason)
    grown = np.zeros_like(selection.membership)
    for step in selection.steps[:first]:
        grown[step.region, step.landmark] = True
    assert measure(selection.membership) < 0.9 * measure(grown)

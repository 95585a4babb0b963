"""Control points as a table and a curve, and their selection by hand."""

import numpy as np
import pytest

from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.selection import from_json, to_json
from facemime.core.control_points.table import (
    add_by_hand,
    draw_curve,
    drop_by_hand,
    error_curve,
    point_rows,
    region_colours,
)
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import N_LANDMARKS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import HeadRig
from tests.helpers.takes import performance


@pytest.fixture(scope="module")
def selection():
    head = load_head()
    rig = HeadRig(
        vertices=head.vertices, landmarks=head.landmarks, region_weights=head.regions, jaw_pivot=head.jaw_pivot
    )
    return select_control_points(rig, performance(), max_points=14)


def test_every_landmark_has_a_row_and_chosen_ones_have_order_reason_and_error(selection):
    rows = point_rows(selection)
    chosen = [row for row in rows if row.regions]
    assert [row.landmark for row in rows] == list(range(N_LANDMARKS))
    assert [row.landmark for row in chosen] == selection.landmarks.tolist()
    assert sorted(row.order for row in chosen) == list(range(1, len(chosen) + 1))
    assert all(row.reason and row.error > 0.0 for row in chosen)
    assert all(row.order == 0 and not row.reason for row in rows if not row.regions)


def test_without_a_selection_all_landmarks_are_control_points():
    rows = point_rows(None)
    assert len(rows) == N_LANDMARKS and all(row.regions and row.order == 0 for row in rows)


def test_a_point_can_be_added_and_removed_by_hand_and_both_survive_the_file(selection):
    landmark = next(row.landmark for row in point_rows(selection) if not row.regions)
    more = from_json(to_json(add_by_hand(selection, landmark)))
    assert set(more.landmarks) == {*selection.landmarks.tolist(), landmark}
    assert point_rows(more)[landmark].reason == "added by hand"
    less = from_json(to_json(drop_by_hand(more, landmark)))
    np.testing.assert_array_equal(less.membership, selection.membership)
    assert not point_rows(less)[landmark].regions
    with pytest.raises(HeadError, match="already"):
        add_by_hand(more, landmark)
    with pytest.raises(HeadError, match="not a control point"):
        drop_by_hand(less, landmark)


def test_removing_one_of_all_landmarks_leaves_65_and_the_last_of_a_region_stays():
    left = drop_by_hand(None, 30)
    assert set(left.landmarks) == set(range(N_LANDMARKS)) - {30}
    with pytest.raises(HeadError, match="last control point of the region"):
        for landmark in range(N_LANDMARKS):
            left = drop_by_hand(left, landmark) if left.membership[:, landmark].any() else left


def test_the_error_curve_falls_and_is_drawn(selection):
    counts, errors = error_curve(selection)
    assert (np.diff(counts) > 0).all() and errors[-1] < errors[0]
    picture = draw_curve(selection)
    assert (
        picture.shape == (200, 320, 4) and picture.dtype == np.float32 and 0.0 <= picture.min() <= picture.max() <= 1.0
    )
    blue = (picture[..., 3] > 0.5) & (picture[..., 2] > picture[..., 0] + 0.3)
    columns = np.flatnonzero(blue.any(axis=0))
    heights = [np.flatnonzero(blue[:, column]).mean() for column in (columns[0], columns[-1])]
    assert heights[0] > heights[1], "rows count from the bottom"
    assert draw_curve(drop_by_hand(None, 30))[..., 3].any(), "axes alone where nothing was measured"


def test_regions_have_distinct_colours_that_mix_where_they_overlap():
    colours = region_colours(np.array([[1.0, 0.5, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]]), 0.6)
    np.testing.assert_allclose(colours[:, 3], [0.6, 0.6, 0.0], atol=1e-6)
    assert not np.allclose(colours[0], colours[1])

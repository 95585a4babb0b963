"""Landmarks and marks that are placed by hand."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from facemime.blender.heads.binding import propose_head_regions, read_marks
from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.placing import Placing, marks_to_ask, place_of_mark
from facemime.blender.meshes import read_landmarks, read_regions
from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.bind import MARKS

CORNER = int(from_ibug([48])[0])


@pytest.fixture
def head():
    return add_head(bpy.context)


def dragged(head: bpy.types.Object) -> Placing:
    """Drag the right mouth corner to a free vertex far away."""
    placing = Placing(head)
    placing.held = CORNER
    free = np.setdiff1d(np.arange(len(head.data.vertices)), read_landmarks(head))
    placing.drag(int(free[len(free) // 2]))
    return placing


def test_regions_that_were_proposed_follow_landmarks_that_are_moved(head):
    propose_head_regions(head)
    before = read_regions(head)
    dragged(head).accept()
    assert not np.allclose(read_regions(head), before)


def test_painted_regions_stay_when_landmarks_are_moved(head):
    propose_head_regions(head)
    head.vertex_groups["Facemime Lower"].add([0, 1, 2], 0.77, "REPLACE")
    before = read_regions(head)
    dragged(head).accept()
    np.testing.assert_array_equal(read_regions(head), before)


def test_discarding_restores_landmarks_and_marks(head):
    before = read_landmarks(head)
    placing = dragged(head)
    assert read_landmarks(head)[CORNER] != before[CORNER]
    placing.discard()
    np.testing.assert_array_equal(read_landmarks(head), before)
    marking = Placing(head, marks_to_ask())
    marking.mark(5)
    marking.discard()
    assert read_marks(head.data) == {}


def test_a_landmark_is_not_dragged_onto_another_one(head):
    placing, before = Placing(head), read_landmarks(head)
    placing.held = CORNER
    placing.drag(int(before[0]))
    np.testing.assert_array_equal(read_landmarks(head), before)


def test_the_most_helpful_marks_are_requested_and_otherwise_all():
    assert set(marks_to_ask()) == set(MARKS)
    assert marks_to_ask((54, 36)) == (36, 54)


def test_a_mark_can_be_undone(head):
    marking = Placing(head, marks_to_ask())
    for vertex in (10, 20, 30, 40):
        marking.mark(vertex)
    assert marking.enough
    marking.unmark()
    assert not marking.enough and marking.next_mark == marking.asked[3]
    assert list(read_marks(head.data).values()) == [10, 20, 30]


def test_a_mark_is_expected_where_the_search_has_put_it(head):
    assert place_of_mark(head, 48) == read_landmarks(head)[CORNER]


def test_placing_without_a_window_is_refused_with_an_alternative(head):
    with pytest.raises(RuntimeError, match="Set Landmark or Mark Point"):
        bpy.ops.facemime.adjust_landmarks()


def test_a_head_deleted_while_placing_is_left_alone(head):
    placing = dragged(head)
    bpy.data.objects.remove(head)
    placing.accept()
    placing.discard()
    assert placing.obj is None

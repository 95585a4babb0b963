"""Control points: the list, selecting landmarks, adding and removing."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.placing import landmark_places, nearest_landmark
from facemime.blender.meshes import read_landmarks, read_selection, write_selection
from facemime.blender.rigs import read_rig
from facemime.core.base.landmarks import from_ibug
from facemime.core.drive.select import select_control_points
from facemime.settings.panel_properties import list_landmarks
from facemime.ui.control_points import FACEMIME_UL_landmarks, shown_rows
from facemime.ui.overlays import dots
from tests.helpers.takes import performance

NOSE, EAR = from_ibug((30, 0))
FRONT = np.array([[5.0, 0.0, 0.0, 0.0], [0.0, 0.0, 5.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""An orthographic view from the front, numpad 1; depth grows away from the viewer."""
SIZE = (1000, 1000)


@pytest.fixture
def head():
    obj = add_head(bpy.context)
    write_selection(obj.data, select_control_points(read_rig(obj), performance(), max_points=12))
    return obj


def test_the_selected_landmark_is_added_and_removed_and_drives_the_head(head):
    steps = bpy.context.scene.facemime_steps
    before = read_selection(head.data)
    steps.landmark = next(row.landmark for row in shown_rows(head) if not row.regions)
    assert bpy.ops.facemime.add_control_point() == {"FINISHED"}
    assert read_rig(head).control_points[:, steps.landmark].any()
    with pytest.raises(RuntimeError, match="already a control point"):
        bpy.ops.facemime.add_control_point()
    assert bpy.ops.facemime.drop_control_point() == {"FINISHED"}
    np.testing.assert_array_equal(read_selection(head.data).membership, before.membership)


def test_adding_a_control_point_can_be_undone(head):
    steps, name = bpy.context.scene.facemime_steps, head.name
    steps.landmark = landmark = next(row.landmark for row in shown_rows(head) if not row.regions)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.facemime.add_control_point()
    bpy.ops.ed.undo_push(message="added")
    bpy.ops.ed.undo()
    assert not shown_rows(bpy.data.objects[name])[landmark].regions
    bpy.ops.ed.redo()
    assert shown_rows(bpy.data.objects[name])[landmark].regions


def test_nothing_can_be_added_to_all_landmarks_but_one_can_be_removed():
    obj = add_head(bpy.context)
    assert not bpy.ops.facemime.drop_control_point.poll()
    bpy.context.scene.facemime_steps.landmark = int(NOSE)
    with pytest.raises(RuntimeError, match="All landmarks are control points already"):
        bpy.ops.facemime.add_control_point()
    assert bpy.ops.facemime.drop_control_point() == {"FINISHED"}
    assert len(read_selection(obj.data).landmarks) == 65


def test_picking_requires_a_window():
    add_head(bpy.context)
    with pytest.raises(RuntimeError, match="no window to click in"):
        bpy.ops.facemime.pick_landmark()


def test_the_list_sorts_control_points_by_selection_and_shows_others_on_request(head):
    list_landmarks()
    lines = bpy.context.window_manager.facemime.landmarks
    assert len(lines) == 66 and lines[65].name == "67"
    listing = SimpleNamespace(bitflag_filter_item=1 << 30)
    flags, order = FACEMIME_UL_landmarks.filter_items(listing, bpy.context, None, "landmarks")
    rows = shown_rows(head)
    shown = [row for row, flag in zip(rows, flags, strict=True) if flag]
    assert [row.landmark for row in shown] == read_selection(head.data).landmarks.tolist()
    assert [row.order for row in sorted(shown, key=lambda row: order[row.landmark])] == list(range(1, len(shown) + 1))
    bpy.context.scene.facemime_steps.only_chosen = False
    flags, order = FACEMIME_UL_landmarks.filter_items(listing, bpy.context, None, "landmarks")
    assert all(flags) and sorted(order) == list(range(66))


def test_a_click_selects_a_landmark_even_if_the_head_is_moved_or_deformed(head):
    head.location.x = 0.02
    head.shape_key_add(name="Basis")
    key = head.shape_key_add(name="Nose")
    nose = int(read_landmarks(head)[NOSE])
    key.data[nose].co.z += 0.01
    key.value = 1.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    places = landmark_places(head, depsgraph, FRONT, SIZE)
    seen = head.evaluated_get(depsgraph).data.vertices[nose].co
    pixel = ((5.0 * (seen.x + 0.02) + 1.0) * 500.0, (5.0 * seen.z + 1.0) * 500.0)
    np.testing.assert_allclose(places.pixels[NOSE], pixel, atol=0.01)
    assert nearest_landmark(places, (pixel[0] + 3.0, pixel[1])) == NOSE
    assert nearest_landmark(places, (3.0, 3.0)) == -1


def test_landmarks_behind_the_head_are_neither_drawn_nor_selected(head):
    behind = FRONT * np.array([[-1.0], [1.0], [-1.0], [1.0]])
    places = landmark_places(head, bpy.context.evaluated_depsgraph_get(), behind, SIZE)
    assert not places.facing[NOSE]
    assert nearest_landmark(places, tuple(places.pixels[NOSE])) != NOSE
    drawn = dots(shown_rows(head), places.pixels, places.facing, -1, 1.0)
    assert len(drawn) == int(places.facing.sum()) * 2


def test_the_selected_landmark_is_drawn_largest(head):
    places = landmark_places(head, bpy.context.evaluated_depsgraph_get(), FRONT, SIZE)

    def reach(picked: int) -> float:
        drawn = dots(shown_rows(head), places.pixels, np.arange(66) == NOSE, picked, 1.0)
        return max(float(np.abs(corners - places.pixels[NOSE]).max()) for corners, _ in drawn)

    assert reach(int(NOSE)) > reach(-1)


def test_a_modifier_that_removes_vertices_is_reported(head):
    from facemime.core.base.errors import HeadError

    head.modifiers.new("Decimate", "DECIMATE").ratio = 0.2
    with pytest.raises(HeadError, match="removes vertices"):
        landmark_places(head, bpy.context.evaluated_depsgraph_get(), FRONT, SIZE)

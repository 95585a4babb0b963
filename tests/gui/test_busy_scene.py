"""What a user does besides while a puppet is running: undo, move, duplicate, other views and windows, sculpting."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import HEAD, add_head, start, stop
from tests.helpers.gui.window import MODULE, Blender

pytestmark = pytest.mark.thorough
_RUNNING = "Session.current is not None and not Session.current.closed"
_VIEWS = f"""
from {MODULE}.operators.preview_place import has_preview, preview_box
from {MODULE}.blender.viewports import free_box
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
views = [region for region in area.regions if region.type == "WINDOW"]
value = []
for view in views:
    if has_preview(bpy.context.window.screen, view):
        box, free = preview_box(area, view, Session.current.shown.preview.shape[:2]), free_box(area, view)
        inside = free.left <= box.left and box.left + box.width <= free.right + 1
        inside &= free.bottom <= box.bottom and box.bottom + box.height <= free.top + 1
        share = box.width * box.height / ((free.right - free.left) * (free.top - free.bottom))
        value.append([view.x, view.y, inside, share, free.bottom])
"""
"""Of each region with the preview: its place, whether that is clear of what covers it, its share, what is below."""


def hover(sidebar: Sidebar) -> None:
    """Move the mouse over the viewport."""
    sidebar.blender.move(*sidebar.view())
    sidebar.blender.redraw()


def test_undo_reverts_the_users_step_and_the_puppet_goes_on(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    hover(sidebar)
    place = blender.get(f"list({HEAD}.location)")
    blender.input("key", "g", "key", "x", "type", "3")
    blender.redraw()
    blender.key("Return")
    blender.wait_for(f"abs({HEAD}.location.x - {place[0]} - 3.0) < 1e-3")
    blender.key("ctrl+z")
    blender.wait_for(f"abs({HEAD}.location.x - {place[0]}) < 1e-3")
    assert blender.get(_RUNNING)
    blender.wait_for(f"moved({HEAD}) > 1e-3")
    blender.key("ctrl+shift+z")
    blender.wait_for(f"abs({HEAD}.location.x - {place[0]} - 3.0) < 1e-3")
    assert blender.get(_RUNNING)
    blender.wait_for(f"moved({HEAD}) > 1e-3")
    stop(sidebar)
    assert blender.get(f"moved({HEAD})") == 0.0


def test_undoing_the_start_of_the_puppet_stops_it_with_the_head_at_rest(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    hover(sidebar)
    blender.key("ctrl+z")
    blender.wait_for("Session.current is None and workers() == []")
    assert blender.get(f"moved({HEAD})") == 0.0
    blender.shot("undone")


def test_escape_cancels_a_move_first_and_stops_the_puppet_next(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    hover(sidebar)
    blender.do(f"from {MODULE}.operators.puppet import _is_busy")
    assert not blender.get("_is_busy(bpy.context.window)")
    blender.shot("keys-of-the-puppet")
    place = blender.get(f"list({HEAD}.location)")
    blender.input("key", "g", "key", "x", "type", "3")
    blender.wait_for("_is_busy(bpy.context.window)")
    blender.shot("keys-of-move")
    blender.key("Escape")
    blender.wait_for("not _is_busy(bpy.context.window)")
    assert blender.get(f"list({HEAD}.location)") == pytest.approx(place) and blender.get(_RUNNING)
    stop(sidebar)


def test_a_duplicate_is_at_rest(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    hover(sidebar)
    blender.key("shift+d")
    blender.wait_for("'Facemime Head.001' in bpy.data.objects")
    blender.key("Escape")
    copy = "bpy.data.objects['Facemime Head.001']"
    blender.wait_for(f"moved({copy}) == 0.0 and {_RUNNING}")
    assert blender.get(f"max(map(abs, {copy}.delta_rotation_euler))") == 0.0
    blender.shot("copy")
    stop(sidebar)


def test_quad_view_has_one_preview_of_at_most_a_quarter_clear_of_what_covers_it(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.wait_for("Session.current.shown.preview is not None")
    hover(sidebar)
    for quad in (True, False):
        blender.key("ctrl+alt+q")
        blender.redraw()
        ((*_, inside, share, _),) = blender.do(_VIEWS)
        assert blender.get("len(views)") == (4 if quad else 1)
        assert inside and share <= 0.26
        blender.shot("quad-view" if quad else "one-view")
    stop(sidebar)


def test_the_asset_shelf_of_sculpting_does_not_cover_the_preview(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.wait_for("Session.current.shown.preview is not None")
    blender.do("bpy.ops.object.mode_set(mode='SCULPT')")
    blender.do(_SHELF)
    blender.redraw()
    ((*_, inside, share, below),) = blender.do(_VIEWS)
    shelf = blender.do(_SHELF_HEIGHT)
    assert inside and share <= 0.26 and below >= shelf
    blender.shot("sculpting")
    blender.do("bpy.ops.object.mode_set(mode='OBJECT')")
    stop(sidebar)


def test_the_scene_is_evaluated_after_sculpting_in_a_file_that_was_closed(blender, sidebar):
    """Blender 4.3 then hands out a dependency graph of the scene that was sculpted in, which was freed."""
    add_head(sidebar)
    blender.do("bpy.ops.object.mode_set(mode='SCULPT')")
    blender.redraw()
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    assert blender.get("evaluated_depsgraph(bpy.context).id_data == bpy.context.scene")


_SHELF = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
if hasattr(area.spaces.active, "show_region_asset_shelf"):
    area.spaces.active.show_region_asset_shelf = True
"""
_SHELF_HEIGHT = """
shelves = [region for region in area.regions if region.type == "ASSET_SHELF" and region.height > 1]
view = next(region for region in area.regions if region.type == "WINDOW")
value = max([region.y + region.height - view.y for region in shelves], default=0)
"""


def test_escape_in_a_second_window_stops_the_puppet_and_nothing_stays_posed(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.do("bpy.ops.wm.window_new()")
    blender.wait_for("len(bpy.context.window_manager.windows) == 2")
    place = blender.do(_SECOND)
    blender.move(*place)
    blender.redraw()
    blender.shot("second-window")
    blender.key("Escape")
    blender.wait_for("Session.current is None and workers() == []")
    assert blender.get(f"moved({HEAD})") == 0.0 and blender.get(f"max(map(abs, {HEAD}.delta_rotation_euler))") == 0.0
    close_second(blender)


def test_closing_the_window_of_the_puppet_leaves_nothing_posed(blender, sidebar):
    add_head(sidebar)
    blender.do("bpy.ops.wm.window_new()")
    blender.wait_for("len(bpy.context.window_manager.windows) == 2")
    blender.do(_START_IN_SECOND)
    blender.wait_for(f"{_RUNNING} and moved({HEAD}) > 1e-3")
    close_second(blender)
    blender.wait_for("Session.current is None and workers() == []")
    assert blender.get(f"moved({HEAD})") == 0.0 and blender.get(f"max(map(abs, {HEAD}.delta_rotation_euler))") == 0.0


def close_second(blender: Blender) -> None:
    """Close the second window."""
    blender.do(
        "with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]): bpy.ops.wm.window_close()"
    )
    blender.wait_for("len(bpy.context.window_manager.windows) == 1")


_SECOND = """
window = bpy.context.window_manager.windows[-1]
area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
view = next(r for r in area.regions if r.type == "WINDOW")
value = [window.x + view.x + view.width * 0.5, window.parent is None]
height = bpy.context.window_manager.windows[0].height
value = [window.x + view.x + view.width * 0.5, height - window.y - view.y - view.height * 0.5]
"""
"""The middle of the viewport of the second window, pixels from the top left of the screen, as large as the first."""
_START_IN_SECOND = """
window = bpy.context.window_manager.windows[-1]
area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
view = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=view):
    bpy.ops.facemime.puppet("INVOKE_DEFAULT")
"""


def test_text_over_the_view_is_readable_in_the_light_theme(blender, sidebar):
    """The line with the delay above the preview is light on a dark plate, whatever is behind it."""
    add_head(sidebar)
    blender.do("theme = bpy.context.preferences.themes[0].view_3d.space.gradients.high_gradient")
    blender.do("before, bpy.context.preferences.themes[0].view_3d.space.gradients.high_gradient = theme[:], (1, 1, 1)")
    start(sidebar)
    blender.wait_for("Session.current.shown.preview is not None and Session.current.stopwatch.text != ''")
    blender.redraw()
    left, top = blender.do(_ABOVE_PREVIEW)
    picture = cv2.imread(str(blender.shot("light")))[round(top) - 16 : round(top), round(left) : round(left) + 90]
    assert np.median(picture) < 140 and picture.max() > 180
    blender.do("bpy.context.preferences.themes[0].view_3d.space.gradients.high_gradient = before")
    stop(sidebar)


_ABOVE_PREVIEW = f"""
from {MODULE}.operators.preview_place import preview_box
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
box = preview_box(area, region, Session.current.shown.preview.shape[:2])
value = [region.x + box.left, bpy.context.window.height - region.y - box.bottom - box.height]
"""

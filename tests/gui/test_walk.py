"""The workflow of a new user in the panel, by mouse."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pytest

from facemime.blender.frames import to_blender
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import OUTER_EYE_CORNERS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.neutral import Neutral
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import CLIP, HEAD, TOOLS, add_head, run_in_viewport, start, stop
from tests.helpers.gui.window import MODULE, wait

pytestmark = pytest.mark.thorough
_SNAPSHOT = f"""
session, obj = Session.current, {HEAD}
value = None
if session is not None and session.shown is not None and session.worker.first.neutral is not None:
    if session.shown.heads and session.shown.number == session._number and session.shown.time > 1.5:
        neutral = session.worker.first.neutral.to_dict()
        value = {{"time": session.shown.time, "neutral": neutral, "shown": shown(obj).tolist()}}
"""
"""The vertices on display and their frame; nothing if the next frame has arrived meanwhile."""


def test_a_head_is_added_by_a_click_and_undone_by_a_key(blender, sidebar):
    add_head(sidebar)
    assert blender.get(f"len({HEAD}.data.vertices)") == 1781
    blender.shot("head")
    blender.key("ctrl+z")
    blender.wait_for("sorted(obj.name for obj in bpy.data.objects) == ['Camera', 'Cube', 'Light']")


@pytest.mark.usefixtures("every_frame")
def test_the_sample_clip_moves_the_head_as_it_does_headless_until_escape(blender, sidebar):
    add_head(sidebar)
    blender.do("bpy.context.scene.facemime.smoothing = 0.0")
    start(sidebar)
    blender.shot("puppet")
    seen = wait(lambda: blender.do(_SNAPSHOT), "a frame to compare")
    blender.move(blender.size[0] - 60, 110)
    blender.redraw()
    blender.key("Escape")
    blender.redraw()
    assert blender.get("Session.current is not None"), "ESC over the outliner is none of the puppet's"
    stop(sidebar)
    assert blender.get(f"moved({HEAD})") == 0.0 and blender.get(f"{HEAD}.data.shape_keys") is None
    rig = built_in_head()
    unit = float(np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]])))
    expected = to_blender(headless_vertices(seen["time"], Neutral.from_dict(json.loads(json.dumps(seen["neutral"])))))
    away = np.linalg.norm(np.array(seen["shown"]) - expected, axis=1)
    assert away.max() < 0.05 * unit and away.mean() < 0.005 * unit, (away.max() / unit, away.mean() / unit)


def headless_vertices(time: float, neutral: Neutral) -> np.ndarray:
    """Return (V, 3) vertices of the built-in head at `time` of the sample clip, with every frame tracked."""
    video, tracker = cv2.VideoCapture(str(CLIP)), FaceTracker.load()
    for _ in range(round(time * video.get(cv2.CAP_PROP_FPS)) + 1):
        result = tracker.track(video.read()[1])
    return HeadDriver(built_in_head(), neutral).frame(result).vertices


_PREVIEW = f"""
from {MODULE}.settings.preferences import preferences
from {MODULE}.operators.preview_place import preview_box
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
from {MODULE}.blender.viewports import free_box
box, free = preview_box(area, region, Session.current.shown.preview.shape[:2]), free_box(area, region)
value = [region.x + box.left, bpy.context.window.height - region.y - box.bottom - box.height, box.width, box.height]
"""


_SPLIT = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(area=area, region=region):
    bpy.ops.screen.area_split(direction="VERTICAL", factor=0.3)
"""
_WITH_PREVIEW = f"""
from {MODULE}.operators.preview_place import has_preview
screen = bpy.context.window.screen
views = [area for area in screen.areas if area.type == "VIEW_3D"]
value = [has_preview(screen, region) for area in views for region in area.regions if region.type == "WINDOW"]
"""


def test_only_one_of_several_viewports_shows_the_preview(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.do(_SPLIT)
    blender.redraw()
    assert sorted(blender.do(_WITH_PREVIEW)) == [False, True]
    blender.shot("one-preview")
    stop(sidebar)


def test_the_preview_is_moved_and_sized_by_the_mouse_and_stays_sharp(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.wait_for("Session.current.shown.preview is not None")
    left, top, width, _ = blender.do(_PREVIEW)
    blender.drag((left + 60, top + 60), (left + 90, top + 20), (left + 120, top - 40))
    assert blender.do(_PREVIEW)[:2] == pytest.approx([left + 60, top - 100], abs=3)
    left, top = blender.do(_PREVIEW)[:2]
    blender.drag((left + width - 4, top + 4), (left + width + 30, top), (left + width + 76, top))
    wider = blender.do(_PREVIEW)[2]
    assert wider == pytest.approx(min(width + 80, blender.get("(free.right - free.left) / 2")), abs=4)
    blender.wait_for(f"Session.current.shown.preview.shape[1] > {wider} - 1")
    blender.shot("preview")
    assert blender.get(f"{HEAD}.select_get()"), "the clicks were the preview's"
    blender.do("preferences().property_unset('preview_size')")
    blender.do("preferences().property_unset('preview_place')")
    stop(sidebar)


def test_deleting_the_moving_head_stops_the_puppet_and_can_be_undone(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.move(*sidebar.view())
    blender.redraw()
    blender.key("Delete")
    blender.wait_for("Session.current is None and workers() == []")
    blender.shot("deleted")
    blender.key("Escape")  # the error popup receives all keys
    blender.redraw()
    blender.key("ctrl+z")
    blender.wait_for(f"len(bpy.data.objects) > 0 and {HEAD} is not None and moved({HEAD}) == 0.0")


def test_a_kept_pose_is_one_undo_step_and_is_saved(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_puppet")
    sidebar.press("keep_pose")
    start(sidebar)
    stop(sidebar)
    kept = blender.get(f"moved({HEAD})")
    assert kept > 1e-4
    blender.key("ctrl+z")
    blender.wait_for(f"moved({HEAD}) == 0.0")
    blender.key("ctrl+shift+z")
    blender.wait_for(f"moved({HEAD}) > 1e-4")
    path = str(blender.inside / "walk.blend")
    blender.do(f"bpy.ops.wm.save_as_mainfile(filepath={path!r})")
    blender.do(f"bpy.ops.wm.open_mainfile(filepath={path!r})")
    assert blender.get(f"moved({HEAD})") == pytest.approx(kept, rel=1e-3)
    again = Sidebar(blender)
    start(again)
    stop(again)


def test_a_performer_is_calibrated_by_a_click_and_stored_by_name(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    sidebar.open_panel("FACEMIME_PT_calibration")
    sidebar.press("bpy.ops.facemime.calibrate(")
    kept = "len(bpy.context.scene.facemime.performers) == 1"
    # The countdown uses wall-clock time; a busy machine may not draw a frame before it is over.
    blender.wait_for(f"Session.current.countdown is not None or {kept}")
    blender.shot("countdown")
    blender.wait_for(kept)
    assert blender.get("bpy.context.scene.facemime.performers[0].calibration") == ""
    blender.do("bpy.context.scene.facemime.keep_calibrations = True")
    blender.do(f"bpy.ops.wm.save_as_mainfile(filepath={str(blender.inside / 'kept.blend')!r}, copy=True)")
    assert blender.get("bpy.context.scene.facemime.performers[0].calibration").startswith("{")
    assert blender.get("Session.current.worker.first.quality.message")
    blender.shot("calibrated")
    stop(sidebar)


def test_a_video_is_tracked_in_the_background_and_escape_bakes_the_tracked_frames(blender, sidebar):
    add_head(sidebar)
    shutil.copy(CLIP, blender.folder / "mine.mp4")
    blender.do(f"bpy.ops.facemime.puppet_video(filepath={str(blender.inside / 'mine.mp4')!r})")
    blender.wait_for("Session.current is not None and Session.current.done > 20")
    blender.move(*sidebar.view())
    blender.redraw()
    blender.key("Escape")
    blender.wait_for(f"Session.current is None and {HEAD}.data.shape_keys is not None and workers() == []")
    assert blender.get(f"len({HEAD}.data.shape_keys.key_blocks)") > 1
    assert 20 <= blender.get("bpy.context.scene.frame_end") < 255
    blender.do("bpy.context.scene.frame_set(bpy.context.scene.frame_end)")
    blender.shot("baked")
    blender.key("ctrl+z")
    blender.wait_for(f"{HEAD}.data.shape_keys is None")


def test_a_take_is_recorded_shown_edited_and_baked_by_clicks(blender, sidebar):
    add_head(sidebar)
    choose_video(sidebar)
    start(sidebar)
    assert blender.get("Session.current.worker.source.name") == "mine.mp4"
    sidebar.open_panel("FACEMIME_PT_takes")
    blender.do(f"from {MODULE}.settings import takes_store as store")
    sidebar.press("bpy.ops.facemime.record_take")
    blender.wait_for("getattr(Session.current.recorder.recording, 'frames', 0) > 40")
    blender.shot("recording")
    sidebar.press("bpy.ops.facemime.record_take")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1")
    assert blender.get(f"{LINE}.length") > 0.5
    confirm(sidebar, "bpy.ops.facemime.rerecord_take")
    assert blender.get("bpy.context.screen.is_animation_playing")
    blender.wait_for("not bpy.context.screen.is_animation_playing")
    assert blender.get(f"len(store.read({LINE}).info['punched_in'])") == 1
    # A range that a slow machine does not finish before Escape is pressed.
    blender.do("s = bpy.context.scene; s.use_preview_range, s.frame_preview_start, s.frame_preview_end = True, 9, 9999")
    confirm(sidebar, "bpy.ops.facemime.rerecord_take")
    blender.wait_for("getattr(Session.current.recorder.recording, 'frames', 0) > 5")
    stop(sidebar)
    blender.do("bpy.context.scene.use_preview_range = False")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 2")
    assert not blender.get("bpy.context.screen.is_animation_playing")
    blender.shot("interrupted")
    blender.key("Escape")
    blender.do("bpy.context.scene.facemime_takes.index = 0")
    blender.redraw()
    sidebar.press("bpy.ops.facemime.show_take")
    blender.do("bpy.context.scene.frame_set(12)")
    blender.wait_for(f"moved({HEAD}) > 1e-4")
    blender.shot("take-shown")
    sidebar.press("bpy.ops.facemime.show_take")
    blender.wait_for(f"moved({HEAD}) == 0.0")
    for button in ("trim_take", "mend_take"):
        confirm(sidebar, f"bpy.ops.facemime.{button}")
    takes = "bpy.context.scene.facemime_takes"
    assert blender.get(f"store.read({takes}.items[{takes}.index]).info['smoothed']") == "zero-phase"
    run_in_viewport(blender, "add_reference")
    blender.wait_for("'mine Reference' in bpy.data.objects")
    sidebar.press("bpy.ops.facemime.bake_take")
    blender.wait_for(f"{HEAD}.data.shape_keys is not None and {HEAD}.data.shape_keys.animation_data is not None")
    blender.do("bpy.context.scene.frame_set(20)")
    assert blender.get(f"moved({HEAD})") > 1e-4
    blender.shot("take-baked")


LINE = "bpy.context.scene.facemime_takes.items[0]"


def choose_video(sidebar: Sidebar) -> None:
    """Choose Video in the menu of sources, and type the path of a clip."""
    blender = sidebar.blender
    shutil.copy(CLIP, blender.folder / "mine.mp4")
    sidebar.open_panel("FACEMIME_PT_source")
    sidebar.press("source.kind")
    blender.key("v")
    blender.wait_for("bpy.context.scene.facemime.source.kind == 'VIDEO'")
    blender.move(*sidebar.find("source.video"))
    blender.redraw()
    blender.input("click", "--repeat", 2, "--delay", 60, 1)
    blender.redraw()
    blender.input("type", str(blender.inside / "mine.mp4"))
    blender.redraw()
    blender.key("Return")
    blender.wait_for("bpy.context.scene.facemime.source.video.endswith('mine.mp4')")


def confirm(sidebar: Sidebar, button: str) -> None:
    """Click a button that opens a dialog and confirm; trimming and mending then add a take."""
    blender = sidebar.blender
    takes = "len(bpy.context.scene.facemime_takes.items)"
    before = blender.get(takes)
    sidebar.press(button)
    blender.key("Return")
    blender.redraw()
    if "rerecord" not in button:
        blender.wait_for(f"{takes} == {before + 1}")


def test_settings_are_saved_and_loaded_as_a_preset_by_clicks(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_expression")
    blender.do("bpy.context.scene.facemime.strength_lower = 1.5")
    blender.do(f"from {MODULE}.settings import user_presets as presets")
    sidebar.open_presets()
    blender.key("p")  # Blender's choice for Save Preset, as Strong has taken its first letter
    blender.redraw()
    blender.shot("preset")
    blender.key("Return")
    blender.wait_for("presets.names() == ['My Preset']")
    blender.do("bpy.context.scene.facemime.strength_lower = 1.0")
    sidebar.open_presets()
    blender.key("m")
    blender.wait_for("bpy.context.scene.facemime.strength_lower == 1.5")


def test_the_papers_preset_is_chosen_by_clicks_and_moves_the_head_live(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_expression", children=True)
    sidebar.open_presets()
    blender.key("y")
    blender.wait_for("bpy.context.scene.facemime.incremental")
    blender.redraw()
    blender.shot("paper")
    depth = "[round(v.co.y, 6) for v in {}.data.vertices]"
    rest = blender.get(depth.format(HEAD))
    start(sidebar)
    blender.wait_for(f"moved({HEAD}) > 0.0")
    shown = f"[round(p.co.y, 6) for p in {HEAD}.data.shape_keys.key_blocks[-1].points]"
    assert blender.get(shown) == rest
    stop(sidebar)


_IN_WINDOW = """
window = bpy.context.window_manager.windows[1]
area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=region):
    {code}
"""


def test_closing_a_second_window_stops_its_puppet(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.do("bpy.ops.wm.window_new()")
    blender.redraw()
    blender.do(_IN_WINDOW.format(code="bpy.ops.wm.window_close()"))
    blender.redraw()
    assert blender.get("Session.current is not None"), "the puppet is the first window's"
    stop(sidebar)
    blender.do("bpy.ops.wm.window_new()")
    blender.do(_IN_WINDOW.format(code="bpy.ops.facemime.puppet('INVOKE_DEFAULT')"))
    blender.wait_for(f"Session.current is not None and moved({HEAD}) > 1e-3")
    blender.shot("two-windows")
    blender.do(_IN_WINDOW.format(code="bpy.ops.wm.window_close()"))
    blender.wait_for(f"Session.current is None and workers() == [] and moved({HEAD}) == 0.0")


def test_the_extension_is_disabled_while_running_and_enabled_again_and_blender_quits(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.do(f"bpy.ops.preferences.addon_disable(module={MODULE!r})")
    assert blender.get("workers()") == [] and not blender.get("hasattr(bpy.types.Scene, 'facemime')")
    assert blender.get(f"{HEAD}.data.shape_keys") is None
    blender.do(f"bpy.ops.preferences.addon_enable(module={MODULE!r})")
    blender.do(TOOLS)
    again = Sidebar(blender)
    start(again)
    blender.move(*again.view())
    blender.redraw()
    blender.key("ctrl+q")
    assert blender.process.wait(60) == 0
    assert "Traceback" not in blender.printed()

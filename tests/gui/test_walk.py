"""The workflow of a new user in the panel, by mouse."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from scans import scanned

from conftest import MODULE
from facemime.blender.frames import to_blender
from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.rig import built_in_rig
from facemime.core.landmarks import OUTER_EYE_CORNERS
from facemime.core.takes.file import save_take
from facemime.core.takes.neutral import Neutral
from facemime.core.tracking.tracker import FaceTracker
from sidebar import Sidebar
from takes import performance
from window import ROOT, Blender, wait

CLIP = ROOT / "assets" / "sample" / "sample.mp4"
HEAD = "bpy.context.active_object"
_TOOLS = f"""
import sys, threading
import numpy as np
package = sys.modules[{MODULE!r}]
from {MODULE}.sessions.session import Session
from {MODULE}.core.landmarks import from_ibug
from {MODULE}.blender.meshes import read_landmarks, read_regions, read_selection
def shown(obj):
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)
def rest(obj):
    flat = np.empty(3 * len(obj.data.vertices), np.float32)
    keys = obj.data.shape_keys
    (keys.reference_key.points if keys else obj.data.vertices).foreach_get("co", flat)
    return flat.reshape(-1, 3)
def moved(obj):
    return float(np.abs(shown(obj) - rest(obj)).max())
def workers():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("facemime")]
"""
_SNAPSHOT = f"""
session, obj = Session.current, {HEAD}
value = None
if session is not None and session.shown is not None and session.worker.neutral is not None:
    if session.shown.heads and session.shown.number == session._number and session.shown.time > 1.5:
        neutral = session.worker.neutral.to_dict()
        value = {{"time": session.shown.time, "neutral": neutral, "shown": shown(obj).tolist()}}
"""
"""The vertices on display and their frame; nothing if the next frame has arrived meanwhile."""


_EVERY_FRAME = f"""
from {MODULE}.core.live import sources
class Patient(sources.Clock):
    time = 0.0
    def now(self):
        return self.time
    def wait_until(self, due, timeout, closed):
        ahead = due - self.time
        closed.wait(min(max(ahead, 0.0), timeout))
        self.time = max(self.time, due) if ahead <= timeout else self.time
        return ahead <= timeout
sources.PacedSource.pace = Patient()
"""
"""The clip plays at its own rate, or slower if the machine is busy, and no frame is dropped."""


@pytest.fixture
def every_frame(blender: Blender) -> Iterator[None]:
    """Use a clock that waits for slow frames."""
    blender.do(_EVERY_FRAME)
    yield
    blender.do("sources.PacedSource.pace = sources.Clock()")


@pytest.fixture
def sidebar(blender: Blender) -> Iterator[Sidebar]:
    """The sidebar with an empty scene; afterwards nothing may be running, and there must be no traceback."""
    before = len(blender.printed())
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    blender.do("[bpy.data.objects.remove(obj) for obj in list(bpy.data.objects)]")
    blender.do("bpy.ops.ed.undo_push(message='Empty')")
    blender.do(_TOOLS)
    blender.redraw()
    yield Sidebar(blender)
    if blender.process.poll() is None:
        blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
        assert blender.get("workers()") == []
    assert "Traceback" not in blender.printed()[before:]


def add_head(sidebar: Sidebar) -> None:
    """Click Add Head, and view the head from the front."""
    sidebar.press("bpy.ops.facemime.add_head")
    look_from_the_front(sidebar)


def look_from_the_front(sidebar: Sidebar) -> None:
    """View the selection from the front."""
    sidebar.blender.move(*sidebar.view())
    sidebar.blender.redraw()
    sidebar.blender.key("KP_1")
    sidebar.blender.key("KP_Decimal")
    sidebar.blender.redraw()


def start(sidebar: Sidebar) -> None:
    """Click Start Puppet and wait until the head moves."""
    sidebar.press("bpy.ops.facemime.puppet")
    sidebar.blender.wait_for(f"Session.current is not None and moved({HEAD}) > 1e-3")


def stop(sidebar: Sidebar) -> None:
    """Press Esc in the viewport and wait for the end."""
    sidebar.blender.move(*sidebar.view())
    sidebar.blender.redraw()
    sidebar.blender.key("Escape")
    sidebar.blender.wait_for("Session.current is None and workers() == []")


def test_a_head_is_added_by_a_click_and_undone_by_a_key(blender, sidebar):
    add_head(sidebar)
    assert blender.get(f"len({HEAD}.data.vertices)") == 1781
    blender.shot("head")
    blender.key("ctrl+z")
    blender.wait_for("len(bpy.data.objects) == 0")


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
    rig = built_in_rig()
    unit = float(np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]])))
    expected = to_blender(headless_vertices(seen["time"], Neutral.from_dict(json.loads(json.dumps(seen["neutral"])))))
    away = np.linalg.norm(np.array(seen["shown"]) - expected, axis=1)
    assert away.max() < 0.05 * unit and away.mean() < 0.005 * unit, (away.max() / unit, away.mean() / unit)


def headless_vertices(time: float, neutral: Neutral) -> np.ndarray:
    """Return (V, 3) vertices of the built-in head at `time` of the sample clip, with every frame tracked."""
    video, tracker = cv2.VideoCapture(str(CLIP)), FaceTracker.load()
    for _ in range(round(time * video.get(cv2.CAP_PROP_FPS)) + 1):
        result = tracker.track(video.read()[1])
    return HeadDriver(built_in_rig(), neutral).frame(result).vertices


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


@pytest.mark.thorough
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


@pytest.mark.thorough
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
    assert blender.get("bpy.context.scene.facemime.performers[0].calibration").startswith("{")
    assert blender.get("Session.current.worker.quality.message")
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


@pytest.mark.thorough
def test_a_take_is_recorded_shown_edited_and_baked_by_clicks(blender, sidebar):
    add_head(sidebar)
    choose_video(sidebar)
    start(sidebar)
    assert blender.get("Session.current.worker.source.name") == "mine.mp4"
    sidebar.open_panel("FACEMIME_PT_takes")
    sidebar.press("bpy.ops.facemime.record_take")
    blender.wait_for("Session.current.recording is not None and Session.current.recording.frames > 40")
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
    blender.wait_for("Session.current.recording is not None and Session.current.recording.frames > 5")
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


def run_in_viewport(blender: Blender, operator: str) -> None:
    """Run an operator of a menu as the menu does."""
    blender.do(
        "area = max((a for a in bpy.context.window.screen.areas if a.type == 'VIEW_3D'), key=lambda a: a.width)\n"
        "region = next(r for r in area.regions if r.type == 'WINDOW')\n"
        f"with bpy.context.temp_override(area=area, region=region): bpy.ops.facemime.{operator}('INVOKE_DEFAULT')"
    )


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
    """Click a button that opens a dialog and confirm; wait for the new file of the take."""
    blender = sidebar.blender
    blender.do(f"from {MODULE}.settings import takes_store as store")
    before = blender.get(f"{LINE}.path")
    sidebar.press(button)
    blender.key("Return")
    blender.redraw()
    if "rerecord" not in button:
        blender.wait_for(f"{LINE}.path != {before!r}")


def test_settings_are_saved_and_loaded_as_a_preset_by_clicks(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_expression")
    blender.do("bpy.context.scene.facemime.strength_lower = 1.5")
    blender.do(f"from {MODULE}.settings import presets")
    sidebar.open_presets()
    blender.key("s")
    blender.redraw()
    blender.shot("preset")
    blender.key("Return")
    blender.wait_for("presets.names() == ['My Preset']")
    blender.do("bpy.context.scene.facemime.strength_lower = 1.0")
    sidebar.open_presets()
    blender.key("m")
    blender.wait_for("bpy.context.scene.facemime.strength_lower == 1.5")


_IN_WINDOW = """
window = bpy.context.window_manager.windows[1]
area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=region):
    {code}
"""


@pytest.mark.thorough
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


def test_a_brush_stroke_takes_effect_while_the_puppet_is_running(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    sidebar.open_panel("FACEMIME_PT_regions")
    sidebar.press("bpy.ops.facemime.paint_region(region='LOWER')")
    blender.wait_for("bpy.context.mode == 'PAINT_WEIGHT'")
    blender.do(f"before = read_regions({HEAD})[2].copy()")
    forehead = blender.do(_PIXEL_OF_FOREHEAD)
    blender.drag(*[(forehead[0] + x, forehead[1]) for x in (-20, -10, 0, 10, 20)])
    blender.wait_for(f"(read_regions({HEAD})[2] > before + 0.2).any()")
    blender.shot("stroke")
    blender.do(f"painted = read_regions({HEAD})[2] > before + 0.2")
    blender.wait_for("(Session.current.worker.heads[0].rig.region_weights[2][painted] > 0.2).all()")
    blender.wait_for(f"np.abs(shown({HEAD}) - rest({HEAD}))[painted].max() > 1e-4")
    stop(sidebar)
    assert blender.get("bpy.context.mode") == "PAINT_WEIGHT"


_PIXEL_OF_FOREHEAD = f"""
from bpy_extras.view3d_utils import location_3d_to_region_2d
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
brow = {HEAD}.matrix_world @ {HEAD}.data.vertices[int(read_landmarks({HEAD})[from_ibug([27])[0]])].co
brow.z += 0.04
x, y = location_3d_to_region_2d(region, area.spaces.active.region_3d, brow)
value = [x + region.x, bpy.context.window.height - (y + region.y)]
"""


def test_regions_are_shown_edited_and_checked_by_clicks(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_regions")
    plain = cv2.imread(str(blender.shot("regions-hidden")))
    sidebar.press("show_regions")
    shown = cv2.imread(str(blender.shot("regions-shown")))
    x, y = (round(value) for value in blender.do(_PIXEL_OF_FOREHEAD))
    change = shown[y - 3 : y + 4, x - 3 : x + 4].astype(float).mean(axis=(0, 1)) - plain[y, x]
    assert change[0] > change[2] + 20, "the forehead turns blue"
    for button in ("mirror_regions(source='left')", "smooth_regions", "propose_regions", "check_head"):
        sidebar.press(f"bpy.ops.facemime.{button}")
    assert blender.get("bpy.context.window_manager.facemime.checked") == blender.get(f"{HEAD}.name")
    sidebar.press("bpy.ops.facemime.paint_region(region='MIDDLE')")
    blender.wait_for(f"{HEAD}.vertex_groups.active.name == 'Facemime Middle'")
    blender.shot("painting")
    sidebar.press("bpy.ops.facemime.leave_painting")
    blender.wait_for("bpy.context.mode == 'OBJECT'")


def import_scan(blender: Blender) -> int:
    """Import a scan as an OBJ file and make it active; returns the number of its vertices."""
    places, faces = scanned()
    lines = [f"v {x:.6f} {-y:.6f} {-z:.6f}" for x, y, z in places]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces.tolist()]
    (blender.folder / "scan.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    blender.do(f"bpy.ops.wm.obj_import(filepath={str(blender.inside / 'scan.obj')!r})")
    blender.do("bpy.context.view_layer.objects.active = bpy.data.objects['scan']")
    return len(places)


@pytest.mark.thorough
def test_an_imported_scan_becomes_a_head_with_open_mouth_and_eyes_by_clicks(blender, sidebar):
    count = import_scan(blender)
    blender.redraw()
    sidebar.open_panel("FACEMIME_PT_head")
    sidebar.press("bpy.ops.facemime.bind_landmarks")
    blender.wait_for("'facemime_landmarks' in bpy.data.objects['scan'].data")
    sidebar.press("bpy.ops.facemime.open_lips")
    blender.wait_for(f"len(bpy.data.objects['scan'].data.vertices) > {count}")
    sidebar.press("bpy.ops.facemime.open_eyes")
    blender.wait_for("'Facemime Eyes' in bpy.data.objects['scan'].vertex_groups")
    blender.wait_for("len(bpy.context.window_manager.facemime.findings) == 0")
    look_from_the_front(sidebar)
    blender.shot("scan")
    start(sidebar)
    sidebar.open_panel("FACEMIME_PT_puppet")
    sidebar.press("bpy.ops.facemime.next_face")
    gap = f"shown({HEAD})[read_landmarks({HEAD})[from_ibug([62, 66])], 2]"
    blender.wait_for(f"float(np.ptp({gap})) > 0.01")
    blender.shot("scan-speaks")
    stop(sidebar)


@pytest.mark.thorough
def test_control_points_are_selected_from_a_take_picked_on_the_head_removed_and_undone(blender, sidebar):
    add_head(sidebar)
    save_take(performance(), blender.folder / "take.facetake")
    sidebar.open_panel("FACEMIME_PT_control_points")
    sidebar.press("bpy.ops.facemime.select_control_points")
    choose_file(blender, str(blender.inside), "take.facetake")
    blender.wait_for(f"read_selection({HEAD}.data) is not None")
    count = blender.get(f"len(read_selection({HEAD}.data).landmarks)")
    sidebar.press("bpy.ops.facemime.pick_landmark")
    landmark = blender.get(f"int(read_selection({HEAD}.data).landmarks[0])")  # a brow, of which there are several
    blender.click(*blender.do(_PIXEL_OF_LANDMARK.format(landmark=landmark)))
    blender.wait_for(f"bpy.context.scene.facemime_steps.landmark == {landmark}")
    blender.shot("control-points")
    sidebar.press("bpy.ops.facemime.drop_control_point")
    blender.wait_for(f"len(read_selection({HEAD}.data).landmarks) == {count - 1}")
    blender.move(*sidebar.view())
    blender.key("ctrl+z")
    blender.wait_for(f"len(read_selection({HEAD}.data).landmarks) == {count}")


_PIXEL_OF_LANDMARK = _PIXEL_OF_FOREHEAD.replace("from_ibug([27])[0]", "{landmark}").replace("brow.z += 0.04\n", "")


def choose_file(blender: Blender, folder: str, name: str) -> None:
    """Choose a file in the file browser."""
    browser = "next((area for area in bpy.context.window.screen.areas if area.type == 'FILE_BROWSER'), None)"
    blender.wait_for(f"{browser} is not None and {browser}.spaces.active.params is not None")
    blender.do(f"params = {browser}.spaces.active.params")
    blender.do(f"params.directory = {folder.encode()!r}\nparams.filename = {name!r}")
    blender.move(blender.size[0] * 0.4, blender.size[1] * 0.6)
    blender.redraw()
    blender.key("Return")
    blender.wait_for(f"{browser} is None")
    blender.redraw()


def test_the_extension_is_disabled_while_running_and_enabled_again_and_blender_quits(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    blender.do(f"bpy.ops.preferences.addon_disable(module={MODULE!r})")
    assert blender.get("workers()") == [] and not blender.get("hasattr(bpy.types.Scene, 'facemime')")
    assert blender.get(f"{HEAD}.data.shape_keys") is None
    blender.do(f"bpy.ops.preferences.addon_enable(module={MODULE!r})")
    blender.do(_TOOLS)
    again = Sidebar(blender)
    start(again)
    blender.move(*again.view())
    blender.redraw()
    blender.key("ctrl+q")
    assert blender.process.wait(60) == 0
    assert "Traceback" not in blender.printed()

"""The pictures of the README and of docs/tutorials: each tutorial is walked by mouse from Blender's default scene.

Each test checks that a picture shows what the page says of it, and leaves it in build/gui/pictures; `make pictures`
runs them and copies the pictures to docs/tutorials/images. Only what Blender itself asks for, such as a frame rate, is
set without the mouse.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.gui.conftest import QUICK, installed
from tests.helpers.gui.studio import ASIDE, Studio, keep
from tests.helpers.gui.walking import CLIP, HEAD, SIZES, choose_file, choose_the_sample_clip, middle, skin
from tests.helpers.gui.window import MODULE, ROOT
from tests.helpers.scans import write_scan

pytestmark = pytest.mark.thorough

_HIGH = (1366, 1060)
"""Size of a window that has room for the whole panel Takes."""
_OPEN_MOUTH, _LENGTH = 2.76, 10.2
"""Time at which the mouth is open in the sample clip, and its length, seconds."""
_TURNS = 2
"""How often the clip is played for a picture with a frame rate; the fastest is kept, as other programs may run."""
_STOPPED = f"""
import time
from {MODULE}.sessions import calibrating as countdown
now = time.perf_counter()
countdown.perf_counter = lambda: now
"""
"""Stops the clock of a countdown, which is over before a busy machine has drawn it."""
_BORDER = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
value = [area.x + area.width, bpy.context.window.height - area.y - area.height // 2]
"""
"""Position of the border between the viewport and the editors on its right."""
_SHOW_KEYS = f"""
editor = next(a for a in bpy.context.window.screen.areas if a.type == "PROPERTIES")
editor.spaces.active.context = "DATA"
{HEAD}.active_shape_key_index = list({HEAD}.data.shape_keys.key_blocks.keys()).index("jawOpen")
"""


@pytest.fixture
def studio(request: pytest.FixtureRequest) -> Iterator[Studio]:
    """The window of a tutorial, whose name and size are the parameter; nothing may be printed as an error."""
    tutorial, size = request.param
    with installed(QUICK, f"pictures-{tutorial}", size=size) as blender:
        yield Studio(tutorial, blender)
        assert "Traceback" not in blender.printed()


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Return the share of pixels that differ."""
    return float((np.abs(one.astype(int) - other).max(axis=2) > 40).mean())


def white(picture: np.ndarray) -> float:
    """Return the share of white pixels, such as those of large text."""
    return float((picture.min(axis=2) > 200).mean())


def coloured(picture: np.ndarray, low: int, high: int) -> float:
    """Return the share of strongly coloured pixels whose hue is in a range, in half degrees."""
    hue, saturation, value = np.moveaxis(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV), -1, 0)
    return float(((hue >= low) & (hue < high) & (saturation > 110) & (value > 110)).mean())


@pytest.mark.parametrize("studio", [("webcam", SIZES[0])], indirect=True)
def test_the_first_tutorial_is_walked_and_each_picture_shows_its_step(studio):
    blender, sidebar = studio.blender, studio.sidebar
    studio.press("add_head")
    blender.wait_for(f"{HEAD}.name == 'Facemime Head'")
    studio.shows("puppet", "record_take")
    rest = studio.picture("head")
    assert skin(rest) > 0.15
    sidebar.open_panel("FACEMIME_PT_source")
    closed = studio.settled("source-closed")
    sidebar.press("source.kind")
    blender.redraw()
    opened = studio.shot("source")
    studio.picture("source", opened, height=500)
    assert changed(opened, closed) > 0.01
    blender.key("Escape")
    blender.redraw()
    choose_the_sample_clip(blender, sidebar)
    blender.do("bpy.context.preferences.system.viewport_aa = 'OFF'")  # drawn by the processor
    studio.start(0.4)
    shots = {}
    for turn in range(_TURNS):
        studio.play(_OPEN_MOUTH + turn * _LENGTH)
        rate = blender.get("Session.current.stopwatch.rate")
        shots[rate] = studio.shot("puppet")
    assert studio.shows_stop(shots[max(shots)])
    moving = studio.picture("puppet", shots[max(shots)])
    assert skin(moving) > 0.15 and changed(moving, rest) > 0.01
    studio.stop()
    sidebar.open_panel("FACEMIME_PT_calibration")
    studio.shows("calibrate(pose='NEUTRAL'", "calibrate(pose='RANGE'")
    studio.start()
    blender.do(_STOPPED)
    studio.press("calibrate(pose='NEUTRAL'")
    blender.wait_for("Session.current.countdown is not None")
    blender.do("countdown.perf_counter = lambda: now + 0.5")
    studio.shot("counting")  # the panel is drawn less often than the view
    counting = studio.shot("countdown")
    blender.do("countdown.perf_counter = time.perf_counter")
    counted = studio.picture("countdown", counting)
    assert white(counted) > white(rest) + 2e-3
    calibrated = "Session.current.countdown is None and Session.current.worker.first.quality is not None"
    blender.wait_for(calibrated)
    studio.press("calibrate(pose='RANGE'")
    blender.wait_for("Session.current.countdown is not None")
    blender.wait_for(calibrated)
    assert blender.get("len(bpy.context.scene.facemime.performers)") == 1
    sidebar.open_panel("FACEMIME_PT_expression")
    sidebar.find("strength_lower")
    blender.move(*sidebar.view(*ASIDE))
    studio.picture("expression", studio.shot("expression"))
    studio.stop()
    assert changed(middle(sidebar, studio.settled("stopped")), rest) < 0.01


@pytest.mark.parametrize("studio", [("own_head", SIZES[0])], indirect=True)
def test_the_second_tutorial_is_walked_and_each_picture_shows_its_step(studio):
    blender, sidebar = studio.blender, studio.sidebar
    blender.move(*sidebar.view(0.3))
    blender.redraw()
    blender.key("Delete")
    blender.wait_for("'Cube' not in bpy.data.objects")
    count = write_scan(blender.folder / "scan.obj")
    blender.do("bpy.ops.wm.obj_import('INVOKE_DEFAULT')")
    choose_file(blender, str(blender.inside), "scan.obj")
    blender.wait_for("'scan' in bpy.data.objects")
    blender.do("bpy.context.view_layer.objects.active = bpy.data.objects['scan']; bpy.ops.object.shade_smooth()")
    blender.move(*sidebar.view(0.3))
    blender.redraw()
    blender.key("KP_1")
    blender.key("KP_Decimal")
    sidebar.open_panel("FACEMIME_PT_head")
    studio.shows("bind_landmarks")
    plain = studio.picture("scan")
    assert (plain.min(axis=2) > 100).mean() > 0.1, "the scan is light"
    studio.press("bind_landmarks")
    blender.wait_for("'facemime_landmarks' in bpy.data.objects['scan'].data")
    sidebar.open_panel("FACEMIME_PT_control_points")
    studio.shows("accept_points", "discard_points")
    points = studio.picture("landmarks")
    for low, high in ((8, 28), (60, 90), (95, 125)):
        assert coloured(points, low, high) > 3e-4
    studio.press("accept_points")
    sidebar.open_panel("FACEMIME_PT_head")
    studio.shows("open_lips", "open_eyes")
    studio.picture("bound")
    studio.press("open_lips")
    blender.wait_for(f"len(bpy.data.objects['scan'].data.vertices) > {count}")
    studio.press("open_eyes")
    blender.wait_for("'Facemime Eyes' in bpy.data.objects['scan'].vertex_groups")
    sidebar.open_panel("FACEMIME_PT_regions")
    hidden = middle(sidebar, studio.settled("hidden"))
    sidebar.press("show_regions")
    regions = studio.picture("regions")
    for low, high in ((8, 28), (60, 90), (95, 125)):
        assert coloured(regions, low, high) > coloured(hidden, low, high) + 0.01
    sidebar.press("show_regions")
    studio.start(_OPEN_MOUTH)
    speaking = studio.picture("puppet", studio.shot("puppet"))
    assert changed(speaking, hidden) > 0.01 and blender.get(f"moved({HEAD})") > 1e-3
    studio.stop()


@pytest.mark.parametrize("studio", [("take", _HIGH)], indirect=True)
def test_the_third_tutorial_is_walked_and_each_picture_shows_its_step(studio):
    blender, sidebar = studio.blender, studio.sidebar
    add_head_with_keys(studio)
    blender.do("bpy.context.scene.render.fps = 25")
    save_project(studio)
    rest = middle(sidebar, studio.settled("rest"))
    assert skin(rest) > 0.15
    studio.start(0.6)
    sidebar.open_panel("FACEMIME_PT_takes")
    studio.press("record_take")
    studio.play(_OPEN_MOUTH)
    recording = studio.picture("recording", studio.shot("recording"))
    assert coloured(recording, 0, 3) > 1e-4 and changed(recording, rest) > 0.01
    studio.play(9.9)
    studio.press("record_take")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1")
    studio.stop()
    studio.press("show_take")
    blender.do("bpy.context.scene.frame_set(55)")
    blender.wait_for(f"moved({HEAD}) > 1e-4")
    assert changed(studio.picture("shown"), rest) > 0.01
    studio.press("show_take")
    blender.wait_for(f"moved({HEAD}) == 0.0")
    sidebar.press("bake.keys")
    blender.shot("keys")
    blender.key("s")  # Blender's choice for Existing Shape Keys by Mapping, as its other letters are taken
    blender.wait_for("bpy.context.scene.facemime_takes.bake.keys == 'mapped'", 10.0)
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    sidebar.scroll_down()
    studio.press("detect_key_map")
    rows = "[row.key for row in bpy.context.scene.facemime_takes.bake.rows]"
    blender.wait_for(f"'jawOpen' in {rows}")
    blender.do(f"bpy.context.scene.facemime_takes.bake.row = {rows}.index('jawOpen')")
    sidebar.scroll_down()
    studio.shows("detect_key_map")
    studio.picture("table")
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    studio.press("bake_take")
    keys = f"{HEAD}.data.shape_keys"
    blender.wait_for(f"{keys}.animation_data is not None and {keys}.animation_data.action is not None")
    border, centre = blender.do(_BORDER)
    blender.drag((border, centre), (border - 80, centre), (border - 160, centre))
    blender.do(_SHOW_KEYS)
    blender.do("bpy.context.scene.frame_set(55)")
    assert blender.get(f"{keys}.key_blocks['jawOpen'].value") > 0.2
    blender.move(*sidebar.view(0.3))
    blender.redraw()
    blender.key("KP_Decimal")
    blender.key("n")
    blender.redraw()
    studio.picture("baked", whole=True)


def save_project(studio: Studio) -> None:
    """Save the file with Ctrl-S, so that takes are stored beside it."""
    blender = studio.blender
    blender.move(*studio.sidebar.view(0.3))
    blender.redraw()
    blender.key("ctrl+s")
    choose_file(blender, str(blender.inside), "performance.blend")
    blender.wait_for("bpy.data.filepath.endswith('performance.blend')")


def add_head_with_keys(studio: Studio) -> None:
    """Choose Head with ARKit Keys > Man in the menu of the plus button."""
    blender, sidebar = studio.blender, studio.sidebar
    box = sidebar.box()
    x, y = box.x + box.width - 2.5 * sidebar.unit, box.y + 2.25 * sidebar.unit
    blender.click(x, y)
    blender.redraw()
    blender.click(x + sidebar.unit, y + 2.3 * sidebar.unit)
    blender.redraw()
    blender.shot("menu")
    blender.click(x - 2.0 * sidebar.unit, y + 2.3 * sidebar.unit)
    blender.wait_for(f"{HEAD}.data.shape_keys is not None and 'jawOpen' in {HEAD}.data.shape_keys.key_blocks", 10.0)
    blender.redraw()


@pytest.fixture
def shoot() -> Iterator[Path]:
    """A folder whose name can be seen in the report."""
    with tempfile.TemporaryDirectory(prefix="shoot-") as folder:
        yield Path(folder)


def test_the_fourth_tutorial_is_walked_and_its_picture_shows_the_report(shoot):
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("Chromium is missing: make programs")
    clips = shoot / "clips"
    clips.mkdir()
    cut(clips / "hello.mp4", 0, 100)
    cut(clips / "goodbye.mp4", 150, 255)
    (clips / "notes.mp4").write_bytes(b"Not a video.")
    command = [str(ROOT / ".venv" / "bin" / "facemime"), "batch", "clips", "-o", "out"]
    done = subprocess.run(command, cwd=shoot, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1 and "1 of 3 clips failed" in done.stderr
    assert "notes.mp4" in (shoot / "out" / "report.html").read_text(encoding="utf-8")
    shot = shoot / "report.png"
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=900,1100"]
    page = f"file://{shoot}/out/report.html"
    subprocess.run([browser, *options, f"--screenshot={shot}", page], check=True, capture_output=True, timeout=120)
    picture = cv2.imread(str(shot))
    assert picture.shape == (1100, 900, 3) and skin(picture) > 0.02, "the contact sheet shows a face"
    keep(picture, "batch-report")


def cut(path: Path, first: int, last: int) -> None:
    """Write frames `first` to `last` of the sample clip as a separate clip."""
    source = cv2.VideoCapture(str(CLIP))
    size = int(source.get(cv2.CAP_PROP_FRAME_WIDTH)), int(source.get(cv2.CAP_PROP_FRAME_HEIGHT))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), source.get(cv2.CAP_PROP_FPS), size)
    for number in range(last):
        image = source.read()[1]
        if number >= first:
            writer.write(image)
    writer.release()

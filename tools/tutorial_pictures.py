"""Make the pictures of `docs/tutorials` from Blender's window, driven by mouse, and from the output of commands.

Run it with `.venv/bin/python tools/tutorial_pictures.py [NAME ...]`, each NAME one of webcam, live, own_head, take,
batch; all by default. It needs what `make test-gui` sets up (`make build windows`) and, for the batch report, Chromium.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "gui"), str(ROOT / "tests")]

from test_own_head import import_scan  # noqa: E402
from walking import HEAD, TOOLS, drag  # noqa: E402

from conftest import install  # noqa: E402
from sidebar import Sidebar  # noqa: E402
from window import (  # noqa: E402
    MODULE,
    Blender,
    places,
)

PICTURES = ROOT / "docs" / "tutorials" / "images"
CLIP = ROOT / "assets" / "sample" / "sample.mp4"
SUITE = "sid"
_WIDE, _HIGH, _LIVE = (1200, 800), (1200, 1060), (960, 640)
"""Sizes of the window: the default one, one that has room for the whole panel Takes, and one that is drawn in time."""
_COLOURS = 256
_IN_TIME, _TRIES = 12.0, 6
"""Frames per second of the picture of a running puppet at least, and how often the clip is played for it."""
_HELD = f"""
import math
from {MODULE}.core.live import sources
class Held(sources.Clock):
    time, limit = 0.0, math.inf
    def now(self):
        return self.time
    def wait_until(self, due, timeout, closed):
        if due > self.limit:
            closed.wait(timeout)
            return False
        closed.wait(max(due - self.time, 0.0))
        self.time = max(self.time, due)
        return True
sources.PacedSource.pace = held = Held()
"""
"""A clock at the pace of the clip, or slower, that stops at `limit` seconds, so that a picture shows that frame."""


def main(names: list[str]) -> int:
    """Make the pictures of the given tutorials; return the exit status."""
    tutorials: dict[str, Callable[[], None]] = {
        "webcam": webcam,
        "live": live,
        "own_head": own_head,
        "take": take,
        "batch": batch,
    }
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names or list(tutorials):
        tutorials[name]()
    total = sum(path.stat().st_size for path in PICTURES.iterdir())
    print(f"{len(list(PICTURES.iterdir()))} pictures, {total / 1e6:.2f} MB")
    return 0


class Studio:
    """Context manager: a window of Blender with Facemime's tab, of which it takes pictures."""

    def __init__(self, tutorial: str, size: tuple[int, int] = _WIDE) -> None:
        self.tutorial = tutorial
        self.blender = Blender(places()[SUITE], f"tutorials/{tutorial}", size)

    def __enter__(self) -> Studio:
        self.blender.__enter__()
        install(self.blender)
        self.blender.do("[bpy.data.objects.remove(obj) for obj in list(bpy.data.objects)]")
        self.blender.do(TOOLS)
        self.blender.do(_HELD)
        self.blender.do(_QUIET)
        self.sidebar = Sidebar(self.blender)
        return self

    def __exit__(self, *_: object) -> None:
        self.blender.close()

    def add_head(self, **options: object) -> None:
        """Add the built-in head by its button, and view it from the front."""
        if options:
            given = ", ".join(f"{name}={value!r}" for name, value in options.items())
            self.blender.do(_IN_VIEW + f"    bpy.ops.facemime.add_head({given})")
        else:
            self.sidebar.press("bpy.ops.facemime.add_head")
        self.look()

    def look(self) -> None:
        """View the selection from the front, without its outline."""
        self.blender.move(*self.sidebar.view(0.3))
        self.blender.redraw()
        self.blender.key("KP_1")
        self.blender.key("KP_Decimal")
        self.blender.do("area.spaces.active.region_3d.view_distance *= 1.15")
        self.blender.redraw()

    def start(self, until: float, panel: str = "") -> None:
        """Start the puppet, optionally open a panel, and play to `until` seconds."""
        self.blender.do(f"sources.PacedSource.pace = held = Held(); held.limit = {until}")
        if panel:
            self.sidebar.open_panel(panel)
        self.sidebar.press("bpy.ops.facemime.puppet")
        self.play(until)

    def play(self, until: float) -> None:
        """Continue the puppet to `until` seconds."""
        self.blender.do(f"held.limit = {until}")
        self.blender.wait_for(f"Session.current.shown is not None and Session.current.shown.time > {until - 0.06}")
        self.blender.redraw()

    def stop(self) -> None:
        """Stop the puppet with Esc."""
        self.blender.do("held.limit = math.inf")
        self.blender.move(*self.sidebar.view(0.3))
        self.blender.redraw()
        self.blender.key("Escape")
        self.blender.wait_for("Session.current is None and workers() == []")

    def picture(self, name: str, height: int = 0, whole: bool = False) -> None:
        """Save a picture of the viewport with its sidebar, cropped to `height` pixels, or of the whole window."""
        self.blender.move(*self.sidebar.view(0.02, 0.98))
        self.blender.redraw()
        self.picture_as_it_is(name, height, whole)

    def picture_as_it_is(self, name: str, height: int = 0, whole: bool = False) -> None:
        """Save a picture as `picture` does, without moving the mouse, which would close a menu."""
        shot = cv2.imread(str(self.blender.shot(name)))
        if not whole:
            x, y, width, tall = self.blender.do(_AREA)
            shot = shot[y : y + tall, x : x + width]
        keep(shot[: height or None], f"{self.tutorial}-{name}")


_IN_VIEW = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(area=area, region=region):
"""

_AREA = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
value = [area.x, bpy.context.window.height - area.y - area.height, area.width, area.height]
"""
_QUIET = """
for area in bpy.context.window.screen.areas:
    if area.type == "VIEW_3D":
        overlay = area.spaces.active.overlay
        overlay.show_outline_selected = overlay.show_cursor = overlay.show_object_origins = False
"""


def keep(picture: cv2.typing.MatLike, name: str) -> None:
    """Write a BGR image as a small PNG with few colours."""
    image = Image.fromarray(picture[:, :, ::-1])
    few = image.quantize(_COLOURS, kmeans=2, dither=Image.Dither.NONE)
    few.save(PICTURES / f"{name}.png", optimize=True)


def webcam() -> None:
    """Make the pictures of the first tutorial: from an empty scene to a calibrated puppet."""
    with Studio("webcam") as studio:
        blender, sidebar = studio.blender, studio.sidebar
        studio.add_head()
        studio.picture("head")
        sidebar.open_panel("FACEMIME_PT_source")
        sidebar.press("source.kind")
        studio.picture_as_it_is("source", 500)
        blender.key("Escape")
        studio.start(0.4)
        sidebar.open_panel("FACEMIME_PT_calibration")
        sidebar.press("bpy.ops.facemime.calibrate(")
        blender.wait_for("Session.current.countdown is not None")
        blender.do("Session.current.calibrate(countdown=4.5)")  # drawing in software takes seconds
        studio.picture_as_it_is("countdown")
        blender.do("held.limit = math.inf")
        blender.wait_for("len(bpy.context.scene.facemime.performers) == 1")
        sidebar.open_panel("FACEMIME_PT_expression")
        studio.picture("expression", 640)
        studio.stop()


def live() -> None:
    """Make the picture of a running puppet, with the rate at which it runs."""
    with Studio("webcam", _LIVE) as studio:
        blender, sidebar = studio.blender, studio.sidebar
        blender.do("bpy.context.preferences.system.viewport_aa = 'OFF'")  # drawn by the processor
        blender.do(f"from {MODULE}.settings.preferences import preferences; preferences().preview_size = 150")
        studio.add_head()
        blender.do("sources.PacedSource.pace = sources.Clock()")
        sidebar.open_panel("FACEMIME_PT_source")
        sidebar.press("bpy.ops.facemime.puppet")
        blender.wait_for("Session.current is not None and Session.current.shown is not None")
        blender.move(*sidebar.view(0.02, 0.98))
        for _ in range(_TRIES):
            blender.wait_for("4.0 < Session.current.shown.time % 10.2 < 9.0")  # the clip runs for a while
            blender.wait_for("2.6 < Session.current.shown.time % 10.2 < 2.9")
            if blender.get("Session.current.stopwatch.rate") > _IN_TIME:
                studio.picture_as_it_is("puppet")
                break
        else:
            raise SystemExit(f"The window was not drawn at {_IN_TIME:g} frames per second. Let nothing else run.")
        studio.stop()


def own_head() -> None:
    """Make the pictures of the second tutorial: from a scan to a head."""
    with Studio("own_head") as studio:
        blender, sidebar = studio.blender, studio.sidebar
        count = import_scan(blender)
        blender.do(_IN_VIEW + "    bpy.ops.object.shade_smooth()")
        studio.look()
        sidebar.open_panel("FACEMIME_PT_head")
        studio.picture("scan")
        sidebar.press("bpy.ops.facemime.bind_landmarks")
        blender.wait_for("'facemime_landmarks' in bpy.data.objects['scan'].data")
        studio.picture("bound")
        sidebar.open_panel("FACEMIME_PT_control_points")
        studio.picture("landmarks")
        sidebar.press("show_points")
        sidebar.open_panel("FACEMIME_PT_head")
        sidebar.press("bpy.ops.facemime.open_lips")
        blender.wait_for(f"len(bpy.data.objects['scan'].data.vertices) > {count}")
        sidebar.press("bpy.ops.facemime.open_eyes")
        blender.wait_for("'Facemime Eyes' in bpy.data.objects['scan'].vertex_groups")
        sidebar.open_panel("FACEMIME_PT_regions")
        sidebar.press("show_regions")
        studio.picture("regions")
        sidebar.press("show_regions")
        studio.start(2.76)
        studio.picture("puppet")
        studio.stop()


def take() -> None:
    """Make the pictures of the third tutorial: record, show and bake a take to ARKit's shape keys."""
    with Studio("take", _HIGH) as studio:
        blender, sidebar = studio.blender, studio.sidebar
        studio.add_head(units=True)
        path = str(blender.inside / "performance.blend")
        blender.do("bpy.context.scene.render.fps = 25")
        blender.do(f"bpy.ops.wm.save_as_mainfile(filepath={path!r})")
        studio.start(0.6)
        sidebar.open_panel("FACEMIME_PT_takes")
        sidebar.press("bpy.ops.facemime.record_take")
        studio.play(2.76)
        studio.picture("recording")
        studio.play(9.9)
        sidebar.press("bpy.ops.facemime.record_take")
        blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1")
        studio.stop()
        sidebar.press("bpy.ops.facemime.show_take")
        blender.do("bpy.context.scene.frame_set(55)")
        blender.wait_for(f"moved({HEAD}) > 1e-4")
        studio.picture("shown")
        sidebar.press("bpy.ops.facemime.show_take")
        blender.do("bpy.context.scene.facemime_takes.bake.keys = 'mapped'")
        blender.do(_IN_VIEW + "    bpy.ops.facemime.detect_key_map()")
        blender.do("bpy.context.scene.facemime_takes.bake.row = 24")
        x, y = sidebar.find("bpy.ops.facemime.bake_take")
        blender.click(x, y + 1.6 * sidebar.unit)  # the header of Key Mapping, right below the button
        blender.redraw()
        box = sidebar.box()
        blender.input("mousemove", box.x + 60, box.y + 300, "click", "--repeat", 40, "--delay", 5, 5)
        studio.picture("table")
        blender.do(_IN_VIEW + "    bpy.ops.facemime.bake_take()")
        border, middle = blender.do(_BORDER)
        drag(blender, (border, middle), (border - 80, middle), (border - 160, middle))
        blender.do(f"{HEAD}.active_shape_key_index = list({HEAD}.data.shape_keys.key_blocks.keys()).index('jawOpen')")
        blender.do(_SHOW_KEYS)
        blender.do("bpy.context.scene.frame_set(55)")
        studio.look()
        blender.key("n")
        blender.redraw()
        studio.picture("baked", whole=True)


_BORDER = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
value = [area.x + area.width, bpy.context.window.height - area.y - area.height // 2]
"""
"""Position of the border between the viewport and the editors on its right."""
_SHOW_KEYS = """
editor = next(a for a in bpy.context.window.screen.areas if a.type == "PROPERTIES")
editor.spaces.active.context = "DATA"
"""


def batch() -> None:
    """Make the picture of the fourth tutorial: the report on three clips, one of them unreadable."""
    folder = Path(tempfile.gettempdir()) / "shoot"  # the name can be seen in the report
    shutil.rmtree(folder, ignore_errors=True)
    clips = folder / "clips"
    clips.mkdir(parents=True)
    try:
        _cut(clips / "hello.mp4", 0, 100)
        _cut(clips / "goodbye.mp4", 150, 255)
        (clips / "notes.mp4").write_bytes(b"Not a video.")
        command = [str(ROOT / ".venv" / "bin" / "facemime"), "batch", "clips", "-o", "out"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        print(done.stdout, done.stderr, f"exit status {done.returncode}", *sorted(os.listdir(folder / "out")), sep="\n")
        browser = shutil.which("chromium") or shutil.which("chromium-browser")
        if browser is None:
            raise SystemExit("Chromium is missing. Install it to photograph the report.")
        shot = folder / "report.png"
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                f"--screenshot={shot}",
                "--window-size=900,1100",
            ]
            + [f"file://{folder}/out/report.html"],
            check=True,
            capture_output=True,
        )
        keep(cv2.imread(str(shot)), "batch-report")
    finally:
        shutil.rmtree(folder)


def _cut(path: Path, first: int, last: int) -> None:
    """Write frames `first` to `last` of the sample clip as a separate clip."""
    source = cv2.VideoCapture(str(CLIP))
    size = int(source.get(cv2.CAP_PROP_FRAME_WIDTH)), int(source.get(cv2.CAP_PROP_FRAME_HEIGHT))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), source.get(cv2.CAP_PROP_FPS), size)
    for number in range(last):
        image = source.read()[1]
        if number >= first:
            writer.write(image)
    writer.release()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

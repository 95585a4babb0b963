"""The window in which the pictures of the README and of docs/tutorials are taken."""

from __future__ import annotations

import math

import cv2
import numpy as np
from PIL import Image

from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import TOOLS, middle, shows_stop
from tests.helpers.gui.window import MODULE, SHOTS, Blender

PICTURES = SHOTS / "pictures"
ASIDE = (0.3, 0.98)
"""Where the mouse waits: right, down, relative to the view."""
_COLOURS = 256
_TRIES = 6
_HELD = f"""
import math
from {MODULE}.core.puppet import sources
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
_OVERLAYS = """
bpy.context.preferences.system.use_overlay_smooth_wire = True
for area in bpy.context.window.screen.areas:
    if area.type == "VIEW_3D":
        overlay = area.spaces.active.overlay
        overlay.show_cursor = False
        overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = True
"""
"""Lines and the grid are drawn as in Blender; the 3D cursor would be in the middle of a mesh that is imported."""
_AREA = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
value = [area.x, bpy.context.window.height - area.y - area.height, area.width, area.height]
"""


class Studio:
    """A window with Blender's default scene and Facemime's tab, of which pictures are taken."""

    def __init__(self, tutorial: str, blender: Blender) -> None:
        self.tutorial, self.blender = tutorial, blender
        blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
        blender.redraw()
        assert blender.get("sorted(obj.name for obj in bpy.data.objects)") == ["Camera", "Cube", "Light"]
        blender.do(TOOLS)
        blender.do(_HELD)
        blender.do(_OVERLAYS)
        self.sidebar = Sidebar(blender)

    def press(self, operator: str) -> None:
        """Click a button of Facemime."""
        self.sidebar.press(f"bpy.ops.facemime.{operator}")

    def shows(self, *names: str) -> None:
        """Check that buttons of Facemime can be seen."""
        for name in names:
            self.sidebar.find(f"bpy.ops.facemime.{name}")

    def start(self, until: float = math.inf) -> None:
        """Start the puppet and play to `until` seconds of the clip; Stop can be seen."""
        self.blender.do(f"sources.PacedSource.pace = held = Held(); held.limit = {min(until, 0.4)}")
        self.press("puppet")
        self.play(0.4)
        assert self.shows_stop(cv2.imread(str(self.blender.shot("stop"))))
        self.play(until)

    def shows_stop(self, shot: np.ndarray) -> bool:
        """Return whether a window shows the button Stop, as one that is pressed."""
        return shows_stop(shot, self.sidebar.find("bpy.ops.facemime.stop_puppet"))

    def play(self, until: float) -> None:
        """Continue the puppet to `until` seconds of the clip; the mouse waits where nothing reacts to it."""
        self.blender.move(*self.sidebar.view(*ASIDE))
        self.blender.redraw()
        self.blender.do(f"held.limit = {'math.inf' if math.isinf(until) else until}")
        if not math.isinf(until):
            self.blender.wait_for(f"Session.current.shown is not None and Session.current.shown.time > {until - 0.06}")

    def stop(self) -> None:
        """Click Stop."""
        self.blender.do("held.limit = math.inf")
        self.press("stop_puppet")
        self.blender.wait_for("Session.current is None and workers() == []")

    def settled(self, name: str) -> np.ndarray:
        """Return the window as soon as it no longer changes, with the mouse where nothing reacts to it."""
        self.blender.move(*self.sidebar.view(*ASIDE))
        last = self.shot(name)
        for _ in range(_TRIES):
            shot = self.shot(name)
            if np.array_equal(shot, last):
                return shot
            last = shot
        raise AssertionError(f"The window of {name} does not come to rest.")

    def shot(self, name: str) -> np.ndarray:
        """Return the window as it is, such as one whose puppet is running."""
        return cv2.imread(str(self.blender.shot(name)))

    def picture(self, name: str, shot: np.ndarray | None = None, height: int = 0, whole: bool = False) -> np.ndarray:
        """Keep a picture of the viewport with its sidebar, or of the whole window; return the middle of the view."""
        shot = self.settled(name) if shot is None else shot
        x, y, width, tall = self.blender.do(_AREA)
        kept = shot if whole else shot[y : y + tall, x : x + width]
        keep(kept[: height or None], f"{self.tutorial}-{name}")
        return middle(self.sidebar, shot)


def keep(picture: np.ndarray, name: str) -> None:
    """Write a BGR image as a small PNG with few colours."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    few = Image.fromarray(picture[:, :, ::-1]).quantize(_COLOURS, kmeans=2, dither=Image.Dither.NONE)
    few.save(PICTURES / f"{name}.png", optimize=True)

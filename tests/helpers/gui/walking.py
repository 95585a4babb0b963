"""Steps of a user in the panel, by mouse, and the tools with which tests look into Blender."""

from __future__ import annotations

import cv2
import numpy as np

from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.window import MODULE, ROOT, Blender

SIZES = ((1366, 768), (1600, 1000))
"""Sizes of the screens on which a newcomer's steps are tested."""
CLIP = ROOT / "assets" / "sample" / "sample.mp4"
HEAD = "bpy.context.active_object"
TOOLS = f"""
import sys, threading
import numpy as np
package = sys.modules[{MODULE!r}]
from {MODULE}.sessions.session import Session
from {MODULE}.core.face.landmarks import from_ibug
from {MODULE}.blender.contexts import evaluated_depsgraph
from {MODULE}.blender.meshes import read_landmarks, read_regions, read_selection
def shown(obj):
    mesh = obj.evaluated_get(evaluated_depsgraph(bpy.context)).data
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
EVERY_FRAME = f"""
from {MODULE}.core.puppet import sources
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


def add_head(sidebar: Sidebar) -> None:
    """Click Add Head, and view the head from the front."""
    heads = "sum('facemime_parts' in obj for obj in bpy.data.objects)"
    before = sidebar.blender.get(heads)
    sidebar.press("bpy.ops.facemime.add_head")
    sidebar.blender.wait_for(f"{heads} == {before + 1}")
    sidebar.blender.redraw()
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
    sidebar.press("bpy.ops.facemime.puppet(")
    sidebar.blender.wait_for(f"Session.current is not None and moved({HEAD}) > 1e-3")


def stop(sidebar: Sidebar) -> None:
    """Press Esc in the viewport and wait for the end."""
    sidebar.blender.move(*sidebar.view())
    sidebar.blender.redraw()
    sidebar.blender.key("Escape")
    sidebar.blender.wait_for("Session.current is None and workers() == []")


def run_in_viewport(blender: Blender, operator: str) -> None:
    """Run an operator of a menu as the menu does."""
    blender.do(
        "area = max((a for a in bpy.context.window.screen.areas if a.type == 'VIEW_3D'), key=lambda a: a.width)\n"
        "region = next(r for r in area.regions if r.type == 'WINDOW')\n"
        f"with bpy.context.temp_override(area=area, region=region): bpy.ops.facemime.{operator}('INVOKE_DEFAULT')"
    )


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


def choose_the_sample_clip(blender: Blender, sidebar: Sidebar) -> None:
    """Choose the source, although it is the default, in its menu, which opens with it under the mouse."""
    place = sidebar.find("source.kind")
    blender.click(*place)
    blender.redraw()
    blender.click(*place)
    blender.redraw()
    assert blender.get("bpy.context.scene.facemime.source.kind") == "SAMPLE"


def shows_stop(window: np.ndarray, place: tuple[float, float]) -> bool:
    """Return whether a button in the colour of one that is pressed, a blue, is drawn at a place of the window."""
    x, y = map(round, place)
    blue, _, red = window[y - 12 : y + 12, x - 30 : x + 30].reshape(-1, 3).mean(axis=0)
    return bool(blue > red + 60)


def skin(picture: np.ndarray) -> float:
    """Return the share of a picture that has the colour of skin."""
    hue, saturation, value = np.moveaxis(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV), -1, 0)
    return float(((hue < 20) & (saturation > 60) & (value > 60)).mean())


def middle(sidebar: Sidebar, picture: np.ndarray) -> np.ndarray:
    """Return the middle of the viewport, between toolbar and sidebar, of a picture of the window."""
    box, edge = sidebar.box("WINDOW"), sidebar.box().x
    left = box.x + (edge - box.x) // 4
    return picture[box.y + 60 : box.y + box.height - 20, left:edge]


PIXEL_OF_FOREHEAD = f"""
from bpy_extras.view3d_utils import location_3d_to_region_2d
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
brow = {HEAD}.matrix_world @ {HEAD}.data.vertices[int(read_landmarks({HEAD})[from_ibug([27])[0]])].co
brow.z += 0.04
x, y = location_3d_to_region_2d(region, area.spaces.active.region_3d, brow)
value = [x + region.x, bpy.context.window.height - (y + region.y)]
"""
PIXEL_OF_LANDMARK = PIXEL_OF_FOREHEAD.replace("from_ibug([27])[0]", "{landmark}").replace("brow.z += 0.04\n", "")

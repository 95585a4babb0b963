"""The panel at other resolution scales, narrow, in each theme and language; screenshots are kept for review."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from tests.gui.conftest import installed
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import CLIP, TOOLS, run_in_viewport, start, stop
from tests.helpers.gui.window import Blender

pytestmark = pytest.mark.thorough

_LONG = ("FACEMIME_PT_puppet", "FACEMIME_PT_takes")
"""Panels that are higher than the window when all of their subpanels are expanded."""
_THEME = """
import os
folder = bpy.utils.preset_paths("interface_theme")[0]
bpy.ops.script.execute_preset(
    filepath=os.path.join(folder, "Blender_{theme}.xml"), menu_idname="USERPREF_MT_interface_theme_presets")
"""


@pytest.fixture(scope="module")
def blender() -> Iterator[Blender]:
    """Only the newest Blender, in a window that has room for all headers at twice the resolution scale."""
    with installed("sid", "looks", size=(1100, 1100)) as window:
        yield window


@pytest.fixture
def untouched(blender: Blender) -> Blender:
    """Blender's default scene, at the default resolution scale."""
    blender.do("bpy.context.preferences.view.ui_scale = 1.0")
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    blender.redraw()
    return blender


def tour(sidebar: Sidebar, name: str, children: bool = False) -> None:
    """Add a head and take a screenshot of every panel, optionally with its subpanels expanded."""
    sidebar.press("bpy.ops.facemime.add_head")
    for panel in sidebar.panels():
        sidebar.open_panel(panel, children)
        shown = f"{name}-{panel.removeprefix('FACEMIME_PT_')}"
        sidebar.blender.shot(shown)
        if children and panel in _LONG:
            sidebar.scroll_down()
            sidebar.blender.shot(f"{shown}-end")


@pytest.mark.parametrize("scale", [0.75, 2.0])
def test_the_panel_is_usable_at_other_resolution_scales(untouched, scale):
    untouched.do(f"bpy.context.preferences.view.ui_scale = {scale}")
    untouched.redraw()
    tour(Sidebar(untouched), f"scale-{scale}")
    assert untouched.get("len(bpy.context.active_object.data.vertices)") == 1781
    assert "Traceback" not in untouched.printed()


def test_the_panel_is_usable_when_narrow(untouched):
    sidebar = Sidebar(untouched)
    wide = sidebar.box().width
    sidebar.widen(-0.4 * wide)
    narrow = sidebar.box().width
    assert narrow < 0.75 * wide
    tour(sidebar, "narrow")
    assert untouched.get("len(bpy.context.active_object.data.vertices)") == 1781
    sidebar.widen(wide - narrow)  # the window is shared
    assert sidebar.box().width > 0.9 * wide


def test_the_panel_follows_the_light_theme(untouched):
    sidebar = Sidebar(untouched)
    sidebar.open_panel("FACEMIME_PT_head")
    dark = cv2.imread(str(untouched.shot("dark")))
    untouched.do(_THEME.format(theme="Light"))
    untouched.redraw()
    light = cv2.imread(str(untouched.shot("light")))
    x, y = map(round, sidebar.header(0))
    inside = np.s_[y - 8 : y + 8, x : x + 100]
    assert light[inside].mean() > dark[inside].mean() + 60


_SPEAK = """
view = bpy.context.preferences.view
view.language = {language!r}
view.use_translate_interface = view.use_translate_tooltips = view.language != "en_US"
"""


@pytest.fixture(params=["en_US", "zh_HANS"])
def language(untouched: Blender, request: pytest.FixtureRequest) -> Iterator[str]:
    """A language of Blender's own; afterwards English."""
    untouched.do(_SPEAK.format(language=request.param))
    yield request.param
    untouched.do(_SPEAK.format(language="en_US"))


@pytest.fixture(params=["Dark", "Light"])
def dressed(untouched: Blender, language: str, request: pytest.FixtureRequest) -> Sidebar:
    """The sidebar in a theme and a language."""
    untouched.do(_THEME.format(theme=request.param))
    untouched.do(TOOLS)
    shutil.copy(CLIP, untouched.folder / "mine.mp4")
    untouched.redraw()
    return Sidebar(untouched)


def test_every_state_of_the_panels_is_drawn_without_an_error(dressed, request):
    name, blender = request.node.callspec.id, dressed.blender

    def shot(state: str) -> None:
        blender.redraw()
        blender.shot(f"{name}-{state}")

    shot("untouched")
    tour(dressed, name, children=True)
    dressed.open_panel("FACEMIME_PT_regions")
    dressed.press("bpy.ops.facemime.check_head")
    shot("checked")
    blender.key("Escape")
    blender.redraw()
    run_in_viewport(blender, "adjust_landmarks")
    shot("adjusting")
    dressed.press("bpy.ops.facemime.discard_points")
    run_in_viewport(blender, "mark_face")
    blender.click(*dressed.view())
    shot("marking")
    dressed.press("bpy.ops.facemime.discard_points")
    blender.do("bpy.ops.object.mode_set(mode='EDIT')")
    dressed.open_panel("FACEMIME_PT_head")
    shot("edit-mode")
    blender.do("bpy.ops.object.mode_set(mode='OBJECT')")
    start(dressed)
    dressed.open_panel("FACEMIME_PT_puppet")
    shot("running")
    dressed.press("bpy.ops.facemime.record_take")
    blender.wait_for("getattr(Session.current.recorder.recording, 'frames', 0) > 10")
    shot("recording")
    dressed.press("bpy.ops.facemime.record_take")
    stop(dressed)
    dressed.open_panel("FACEMIME_PT_takes")
    shot("take")
    run_in_viewport(blender, "show_take")
    shot("shown")
    run_in_viewport(blender, "show_take")
    blender.do(f"bpy.ops.facemime.puppet_video(filepath={str(blender.inside / 'mine.mp4')!r})")
    blender.wait_for("Session.current is not None and Session.current.done > 3")
    shot("tracking")
    dressed.press("bpy.ops.facemime.stop_tracking")
    blender.wait_for("Session.current is None")
    shot("baked")
    assert "Traceback" not in blender.printed()

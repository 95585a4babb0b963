"""The first minute of a newcomer: from Blender's default scene to a face that moves, by mouse alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.gui.conftest import QUICK, SUITES, installed
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import SIZES, TOOLS, choose_the_sample_clip, middle, shows_stop, skin
from tests.helpers.gui.window import Blender

_POSES, _CALIBRATE = ("NEUTRAL", "RANGE"), "bpy.ops.facemime.calibrate(pose='{pose}'"
_LEAST_SHARE, _LEAST_MOTION = 0.15, 0.01
"""Shares of the view that the head fills at least, and whose pixels change at least when it moves."""
_TAB = 1
"""Clicks to the tab; the test itself clicks more often, as it looks for the place of the tab."""


@pytest.mark.parametrize(
    "size", [pytest.param(size, marks=[pytest.mark.thorough] * (size != SIZES[0])) for size in SIZES]
)
@pytest.mark.parametrize(
    "suite", [pytest.param(name, marks=[pytest.mark.thorough] * (name != QUICK)) for name in SUITES]
)
def test_three_clicks_lead_from_the_default_scene_to_a_moving_face_and_stop_stays_in_view(suite, size):
    slow = suite != QUICK or size != SIZES[0]
    with installed(suite, f"first-{size[0]}", size=size) as blender:
        blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
        blender.redraw()
        sidebar = Sidebar(blender)
        assert blender.get("'Cube' in bpy.data.objects")
        before, begun = view(blender, sidebar, "default"), blender.clicks
        sidebar.press("bpy.ops.facemime.add_head")
        blender.wait_for("bpy.context.active_object.name == 'Facemime Head'")
        blender.redraw()
        rest = view(blender, sidebar, "head")
        assert skin(rest) > _LEAST_SHARE > skin(before) + 0.1
        needed = blender.clicks - begun + _TAB
        choose_the_sample_clip(blender, sidebar)
        sidebar.open_panel("FACEMIME_PT_calibration")
        buttons = [_CALIBRATE.format(pose=pose) for pose in (_POSES if slow else _POSES[:1])]
        for button in buttons:  # they stay where they are, and looking for them takes longer while the head moves
            sidebar.find(button)
        begun = blender.clicks
        sidebar.press("bpy.ops.facemime.puppet(")
        assert needed + blender.clicks - begun == 3
        stop = sidebar.find("bpy.ops.facemime.stop_puppet")
        key = "bpy.context.active_object.data.shape_keys.key_blocks[-1]"
        moved = f"max((p.co - q.co).length for p, q in zip({key}.data, bpy.context.active_object.data.vertices))"
        blender.wait_for(f"bpy.context.active_object.data.shape_keys is not None and {moved} > 2e-3")
        blender.redraw()
        assert shows_stop(cv2.imread(str(blender.shot("stop"))), stop)
        shown = view(blender, sidebar, "moving")
        changed = np.abs(shown.astype(int) - rest).max(axis=2) > 40
        assert changed.mean() > _LEAST_MOTION and skin(shown) > _LEAST_SHARE
        calibrate(blender, sidebar, stop, buttons)
        blender.click(*stop)
        blender.wait_for("bpy.context.active_object.data.shape_keys is None")
        blender.redraw()
        assert np.abs(view(blender, sidebar, "stopped").astype(int) - rest).mean() < 2.0
        assert "Traceback" not in blender.printed()


def calibrate(blender: Blender, sidebar: Sidebar, stop: tuple[float, float], buttons: list[str]) -> None:
    """Calibrate by clicks; Stop stays where it is."""
    blender.do(TOOLS)
    for number, button in enumerate(buttons):
        sidebar.press(button)
        blender.wait_for("Session.current.countdown is not None")
        blender.shot(f"calibrating-{number}")
        blender.wait_for("Session.current.countdown is None and Session.current.worker.first.quality is not None")
        assert sidebar.find("bpy.ops.facemime.stop_puppet") == stop
        blender.move(*sidebar.view())
        blender.redraw()
        assert shows_stop(cv2.imread(str(blender.shot("stop"))), stop)
    assert blender.get("len(bpy.context.scene.facemime.performers)") == 1


def view(blender: Blender, sidebar: Sidebar, name: str) -> np.ndarray:
    """Take a screenshot, and return the middle of its viewport."""
    return middle(sidebar, cv2.imread(str(blender.shot(name))))

"""The viewer of the installed extension: a browser gets what a puppet in Blender's own window does."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from websockets.sync.client import connect

from tests.gui.conftest import installed
from tests.helpers.clocks import PATIENCE
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.window import Blender

_SETTINGS = """
bpy.context.preferences.system.use_online_access = True
viewer = bpy.context.scene.facemime.viewer
viewer.enabled, viewer.port, viewer.host = True, 0, "0.0.0.0"
panel = bpy.types.FACEMIME_PT_viewer
bpy.utils.unregister_class(panel)
del panel.bl_parent_id
panel.bl_options, panel.bl_order = set(), -1
bpy.utils.register_class(panel)
"""
"""Switches it on for the whole network, where the panel shows a code, and opens the panel on top."""
_SERVER = "__import__('bl_ext.user_default.facemime.operators.puppet', fromlist=['running']).running().displays.viewer"


@pytest.fixture(scope="module")
def blender() -> Iterator[Blender]:
    """The newest Blender with the extension."""
    with installed("sid", "viewer", size=(1100, 1300)) as window:
        yield window


@pytest.mark.thorough
def test_a_browser_finds_the_puppet_by_the_address_in_the_panel(blender):
    sidebar = Sidebar(blender)
    sidebar.press("bpy.ops.facemime.add_head")
    blender.do(_SETTINGS)
    sidebar.press("bpy.ops.facemime.puppet(")
    address = blender.wait_for(f"{_SERVER}.address")
    port = address.split(":")[2].split("/")[0]
    with connect(f"ws://127.0.0.1:{port}/{address.split('/')[3]}/stream", open_timeout=PATIENCE) as page:
        while not json.loads(page.recv(timeout=PATIENCE))["images"]:
            pass
        frames = {page.recv(timeout=PATIENCE) for _ in range(5)}
        assert len(frames) == 5
    blender.redraw()
    blender.shot("panel")
    blender.do("bpy.ops.facemime.copy_viewer_address()")
    assert blender.get("bpy.context.window_manager.clipboard") == address
    sidebar.press("bpy.ops.facemime.stop_puppet")
    assert "Traceback" not in blender.printed()

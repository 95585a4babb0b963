"""The way of a new user through the panel, step by step and by mouse."""

from __future__ import annotations

import pytest

from sidebar import Sidebar
from window import Blender

HEAD = "bpy.context.active_object"


@pytest.fixture
def sidebar(blender: Blender) -> Sidebar:
    """The sidebar over an empty scene."""
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    blender.do("[bpy.data.objects.remove(obj) for obj in list(bpy.data.objects)]")
    blender.redraw()
    return Sidebar(blender)


def add_head(sidebar: Sidebar) -> None:
    """Press the button that adds the head."""
    sidebar.open_panel("FACEMIME_PT_head")
    sidebar.press("bpy.ops.facemime.add_head")


def test_the_head_is_added_by_a_click(blender, sidebar):
    add_head(sidebar)
    assert blender.get(f"len({HEAD}.data.vertices)") == 1781
    blender.shot("head")

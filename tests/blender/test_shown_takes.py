"""A take that is shown keeps up with the scene: after Edit Mode, and until the scene is deleted."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.sessions.session import Session
from facemime.sessions.show import TakeShow, follow_settings
from tests.helpers.live_ticks import shown
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.mark.parametrize("part", [None, "Lashes"])
def test_a_frame_that_was_reached_in_edit_mode_is_shown_on_leaving_it(part):
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps = 25
    edited = next((child for child in head.children if child.name == part), head)
    session = TakeShow(scene, [head], performance())
    places = {}
    for frame in (50, 40):
        scene.frame_set(frame)
        places[frame] = shown(edited)
    bpy.context.view_layer.objects.active = edited
    bpy.ops.object.mode_set(mode="EDIT")
    scene.frame_set(50)
    follow_settings()
    bpy.ops.object.mode_set(mode="OBJECT")
    follow_settings()
    assert np.abs(places[50] - places[40]).max() > 1e-4
    np.testing.assert_allclose(shown(edited), places[50], atol=1e-7)
    session.close()


def test_a_take_is_no_longer_shown_once_its_scene_is_deleted():
    head = add_head(bpy.context)
    rest = shown(head)
    TakeShow(bpy.context.scene, [head], performance())
    scene = bpy.context.scene
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(head)
    bpy.context.window.scene = other
    bpy.data.scenes.remove(scene)
    assert follow_settings() is None and Session.current is None
    np.testing.assert_array_equal(shown(head), rest)

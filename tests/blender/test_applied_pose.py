"""Applying a pose that a session shows makes it part of the mesh or the bones at rest, which is said."""

from __future__ import annotations

import bpy
import pytest

from facemime.blender.characters import read_bones
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.operators.puppet import running
from facemime.sessions import session as sessions
from facemime.sessions import show
from facemime.sessions.show import TakeShow, follow_settings
from tests.helpers.characters import make_character
from tests.helpers.live_ticks import some_frames, start, ticks_until
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def said(monkeypatch):
    """The messages of sessions."""
    messages = []
    monkeypatch.setattr(sessions, "show_error", lambda message: messages.append(str(message)))
    monkeypatch.setattr(show, "show_error", lambda message: messages.append(str(message)))
    return messages


def turned(owner):
    """Whether a performance turns an object or a bone visibly."""
    angles = owner.delta_rotation_euler if isinstance(owner, bpy.types.Object) else owner.matrix_basis.to_euler()
    return max(map(abs, angles)) > 0.1


@pytest.mark.parametrize(
    ("change", "warned"),
    [
        (lambda: bpy.ops.object.transform_apply(location=True, rotation=True, scale=True), True),
        (lambda: bpy.ops.object.transform_apply(location=False, rotation=True, scale=False), True),
        (lambda: bpy.ops.object.transform_apply(location=False, rotation=False, scale=True), False),
        (lambda: bpy.ops.object.rotation_clear(clear_delta=True), False),
    ],
)
def test_applying_the_rotation_of_a_puppet_is_said_once(looping, said, change, warned):
    head = add_head(bpy.context)
    start()
    ticks_until(lambda: turned(head))
    change()
    some_frames()
    some_frames()
    assert [message.split(" was ")[0] for message in said] == [f"The pose of {head.name}"] * warned
    assert running() is not None
    bpy.ops.facemime.stop_puppet()


@pytest.mark.parametrize("name", ["Head", "Skull"])
def test_applying_the_pose_of_a_bone_as_its_rest_pose_is_said(looping, said, name):
    head, _ = bind_character(make_character(rig=True)["head"])
    bpy.context.view_layer.objects.active = head
    armature = read_bones(head)[0]
    start()
    armature.data.bones["Head"].name = name
    some_frames()
    ticks_until(lambda: turned(armature.pose.bones[name]))
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.armature_apply()
    bpy.ops.object.mode_set(mode="OBJECT")
    some_frames()
    assert len(said) == 1 and said[0].startswith(f"The pose of {name} was applied to the rest shape. Undo that")
    bpy.ops.facemime.stop_puppet()


def test_applying_the_rotation_of_a_shown_take_is_said_without_another_frame(said):
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps = 25
    session = TakeShow(scene, [head], performance())
    scene.frame_set(34)
    assert turned(head)
    bpy.ops.object.transform_apply()
    for _ in range(3):
        follow_settings()
    assert len(said) == 1
    session.close()

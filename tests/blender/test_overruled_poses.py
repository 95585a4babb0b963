"""A bake says what keeps its pose from being seen: Rest Position, and constraints over the pose."""

import bpy
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow
from tests.helpers.characters import make_character
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def warnings_of(head, **settings):
    report = puppet_head(bpy.context.scene, head, performance(), PuppetSettings(**settings))
    return [warning for warning in report.warnings if "pose" in warning]


@pytest.fixture
def rigged():
    """A character whose head is turned by a bone."""
    head, _ = bind_character(make_character(rig=True)["head"])
    return head, head.parent


def target():
    empty = bpy.data.objects.new("Target", None)
    bpy.context.scene.collection.objects.link(empty)
    return empty


def test_nothing_is_said_of_a_pose_that_is_seen(rigged):
    head, armature = rigged
    constraint = armature.pose.bones["Head"].constraints.new("COPY_LOCATION")
    constraint.target = target()
    assert warnings_of(head) == []
    assert any("Head (Copy Location)" in warning for warning in warnings_of(head, translation=True))


def test_rest_position_is_said(rigged):
    head, armature = rigged
    armature.data.pose_position = "REST"
    (warning,) = warnings_of(head)
    assert warning.startswith(f"{armature.name} is in Rest Position")


@pytest.mark.parametrize(
    "kind", first_of(["TRACK_TO", "COPY_ROTATION", "DAMPED_TRACK", "COPY_TRANSFORMS", "LIMIT_ROTATION"], 2)
)
@pytest.mark.parametrize("of_bone", first_of([True, False]))
def test_a_constraint_over_the_pose_is_named(kind, of_bone, rigged):
    head, owner = (rigged[0], rigged[1].pose.bones["Head"]) if of_bone else [add_head(bpy.context)] * 2
    constraint = owner.constraints.new(kind)
    if kind != "LIMIT_ROTATION":
        constraint.target = target()
    (warning,) = warnings_of(head)
    assert f"{owner.name} ({constraint.name})" in warning
    constraint.mute = True
    assert warnings_of(head) == []


def test_a_constraint_that_adds_to_the_pose_is_not_named(rigged):
    head, armature = rigged
    constraint = armature.pose.bones["Head"].constraints.new("COPY_ROTATION")
    constraint.target, constraint.mix_mode = target(), "AFTER"
    assert warnings_of(head) == []


def test_a_preview_says_it_too(rigged):
    head, armature = rigged
    armature.data.pose_position = "REST"
    show = TakeShow(bpy.context.scene, [head], performance())
    assert [warning for warning in show.warnings if "Rest Position" in warning]
    show.close()


@pytest.mark.usefixtures("looping", "nothing_left_over")
def test_a_live_puppet_says_it_too(rigged, capfd):
    head, armature = rigged
    armature.data.pose_position = "REST"
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    assert f"{armature.name} is in Rest Position" in capfd.readouterr().out
    bpy.ops.facemime.stop_puppet()


@pytest.mark.parametrize("how", ["eye", "excluded"])
def test_a_hidden_head_is_said(how):
    head, scene = add_head(bpy.context), bpy.context.scene
    assert not puppet_head(scene, head, performance()).warnings
    if how == "eye":
        head.hide_set(True)
    else:
        cast = bpy.data.collections.new("Cast")
        scene.collection.children.link(cast)
        head.users_collection[0].objects.unlink(head)
        cast.objects.link(head)
        bpy.context.view_layer.layer_collection.children["Cast"].exclude = True
    (warning,) = puppet_head(scene, head, performance()).warnings
    assert warning.startswith(f"Hidden: {head.name}")
    show = TakeShow(scene, [head], performance())
    assert any(text.startswith(f"Hidden: {head.name}") for text in show.warnings)
    show.close()

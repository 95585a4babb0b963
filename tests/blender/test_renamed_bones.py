"""Bones that turn a head are found again after they were renamed, as for an export, and missing ones are reported."""

from __future__ import annotations

from dataclasses import replace

import bpy
import pytest

from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import read_bones, write_bones
from facemime.blender.heads.binding import bind_character
from facemime.core.heads.part_names import FaceBones
from facemime.operators.puppet import running
from tests.helpers.characters import make_character
from tests.helpers.live_ticks import some_frames, start, ticks_until

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def character():
    """The head of a character with an armature, active, and the armature."""
    head, _ = bind_character(make_character(rig=True)["head"])
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = head
    head.select_set(True)
    return head, read_bones(head)[0]


def rename_in_edit_mode(armature, name, new):
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones[name].name = new
    bpy.ops.object.mode_set(mode="OBJECT")


def rename_in_object_mode(armature, name, new):
    armature.data.bones[name].name = new


@pytest.mark.parametrize("rename", [rename_in_edit_mode, rename_in_object_mode])
def test_a_bone_that_was_renamed_still_turns_the_head(character, rename):
    head, armature = character
    rename(armature, "Head", "mixamorig:Head")
    target = own_targets(head)["head"]
    assert (target.obj, target.bone) == (armature, "mixamorig:Head")


def test_a_new_bone_with_the_former_name_does_not_turn_the_head(character):
    head, armature = character
    armature.data.bones["Head"].name = "Skull"
    armature.data.bones["Spine"].name = "Head"
    assert own_targets(head)["head"].bone == "Skull"


def test_each_copy_of_a_character_has_the_bones_of_its_own_armature(character):
    head, armature = character
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.duplicate()
    copy = next(obj for obj in bpy.context.selected_objects if obj.name.startswith(head.name))
    own = read_bones(copy)[0]
    own.data.bones["Head"].name = "Twin"
    assert own != armature and read_bones(copy)[1].head == "Twin" and read_bones(head)[1].head == "Head"


def test_bones_that_two_heads_share_are_found_for_each(character):
    head, armature = character
    other = bpy.data.objects.new("Other", head.data.copy())
    write_bones(other, armature, FaceBones(head="Spine", jaw="Head"))
    for name in ("Spine", "Head"):
        armature.data.bones[name].name = f"DEF-{name}"
    assert read_bones(head)[1].head == "DEF-Head"
    assert read_bones(other)[1] == FaceBones(head="DEF-Spine", jaw="DEF-Head")


def test_a_bone_that_no_longer_is_chosen_loses_its_mark(character):
    head, armature = character
    write_bones(head, armature, replace(read_bones(head)[1], head="Spine"))
    armature.data.bones["Spine"].name = "Root"
    assert read_bones(head)[1].head == "Root"
    write_bones(head, armature, replace(read_bones(head)[1], head=""))
    assert not read_bones(head)[1].head and own_targets(head)["head"].obj == head


def test_bones_of_earlier_files_are_found_by_their_names(character):
    head, armature = character
    del armature.pose.bones["Head"]["facemime_bone"], head["facemime_bones"]["mark"]
    assert read_bones(head)[1].head == "Head"
    armature.data.bones["Head"].name = "Skull"
    assert not read_bones(head)[1].head


@pytest.mark.usefixtures("looping")
def test_a_bone_that_is_renamed_twice_while_it_is_posed_stays_posed_and_returns_to_rest(character):
    head, armature = character
    start()
    for name in ("Kopf", "Tete"):
        armature.data.bones[own_targets(head)["head"].bone].name = name
        some_frames()
        assert running() is not None
        ticks_until(lambda at=name: armature.pose.bones[at].matrix_basis.to_quaternion().angle > 0.1)
    bpy.ops.facemime.stop_puppet()
    assert armature.pose.bones["Tete"].matrix_basis.to_quaternion().angle < 1e-6


@pytest.mark.usefixtures("looping")
def test_a_head_whose_bone_was_deleted_is_not_turned_off_its_body(character):
    head, armature = character
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones.remove(armature.data.edit_bones["Head"])
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = head
    message = "The bone Head of Armature, which turns the head, is missing"
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.facemime.puppet()
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.facemime.puppet_video(filepath=bpy.context.scene.facemime.source.take)
    write_bones(head, armature, FaceBones())
    start()
    bpy.ops.facemime.stop_puppet()

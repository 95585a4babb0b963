"""Learnt controls serve a character that was renamed, duplicated or appended, whatever its objects are called then."""

import base64
import hashlib
import io
import json

import bpy
import numpy as np
import pytest

from facemime.blender.characters import members_of
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import read_controls, stored_map, write_controls
from facemime.blender.fcurves import curves_in, drivers_of
from facemime.blender.meshes import mesh_of, read_places
from facemime.core.errors import HeadError
from facemime.sessions.show import TakeShow, follow_settings
from tests.helpers.face_rigs import bake, make_face_rig, show, state
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def learnt(rigged):
    """A head with learnt controls, its armature, and the object of its slider."""
    head, armature = rigged
    write_controls(head, learn_controls(head))
    return head, armature, bpy.data.objects["Slider"]


def character(objects):
    """The head, the armature and the slider among some objects."""
    head = next(obj for obj in objects if obj.type == "MESH" and "facemime_landmarks" in mesh_of(obj))
    armature = next(obj for obj in objects if obj.type == "ARMATURE")
    return head, armature, next(obj for obj in objects if obj.name.startswith("Slider"))


def duplicated():
    """Duplicate all objects of the scene, and return the copy's."""
    before = set(bpy.data.objects)
    for obj in bpy.context.scene.objects:
        obj.select_set(True)
    bpy.ops.object.duplicate()
    return character([obj for obj in bpy.data.objects if obj not in before])


def appended(path):
    """Append all objects of a file, and return the character's."""
    with bpy.data.libraries.load(str(path)) as (stored, chosen):
        chosen.objects = stored.objects
    for obj in chosen.objects:
        bpy.context.scene.collection.objects.link(obj)
    return character(chosen.objects)


def poses(but):
    return {
        obj.name: [tuple(bone.location) for bone in obj.pose.bones]
        for obj in bpy.data.objects
        if obj.type == "ARMATURE" and obj != but
    }


def moved_by_its_controls(head, armature, slider):
    """Preview and bake a performance; return whether the armature and the slider of the character are moved by it."""
    bpy.context.view_layer.objects.active = head
    bpy.context.view_layer.update()
    others, before = poses(armature), tuple(armature.pose.bones["c5"].location)
    session = show(head)
    bpy.context.scene.frame_set(40)
    shown = tuple(armature.pose.bones["c5"].location) != before
    session.close()
    assert tuple(armature.pose.bones["c5"].location) == before and poses(armature) == others
    assert bake(head).controls == len(read_controls(head).controls)
    return shown and all(len(list(curves_in(obj.animation_data))) for obj in (armature, slider))


@pytest.mark.parametrize("which", first_of([0, 1, 2]))
def test_controls_of_a_renamed_character_are_found(learnt, which):
    learnt[which].name = "Anna"
    assert moved_by_its_controls(*learnt)


def test_a_duplicate_is_moved_by_its_own_controls_at_once(learnt):
    copy = duplicated()
    copy[1].name, learnt[1].name = "A Rig", "Z Rig"
    assert moved_by_its_controls(*copy)
    assert not learnt[1].animation_data
    assert moved_by_its_controls(*learnt)


def test_a_duplicated_head_on_the_same_armature_uses_its_controls(learnt):
    head, armature, slider = learnt
    for obj in bpy.context.scene.objects:
        obj.select_set(obj == head)
    bpy.ops.object.duplicate()
    assert moved_by_its_controls(bpy.context.view_layer.objects.active, armature, slider)


def test_an_appended_character_is_moved_by_its_own_controls(learnt, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "character.blend"), copy=True)
    copy = appended(tmp_path / "character.blend")
    assert copy[1].name != "Rig" and moved_by_its_controls(*copy)


def test_controls_that_are_not_used_stay_so_when_a_copy_is_learnt_again(learnt):
    learnt[0].facemime_rig.controls["Slider"].use = False
    head, _, slider = duplicated()
    slider.name = "Blink"
    write_controls(head, learn_controls(head))
    assert not head.facemime_rig.controls["Slider"].use and "Slider" not in read_controls(head).controls


def test_a_copy_shows_what_the_original_was_taught_on_sliders(learnt):
    head, armature, slider = learnt
    session = show(head)
    bpy.context.scene.frame_set(40)
    slider.location.z += 0.07
    armature["lift"] = 0.9
    armature.update_tag()
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    wanted = slider.location.z, armature["lift"]
    session.close()
    head, armature, slider = duplicated()
    slider.name = "Blink"
    for again in (False, True):
        if again:
            write_controls(head, learn_controls(head))
        session = show(head)
        bpy.context.scene.frame_set(40)
        assert (slider.location.z, armature["lift"]) == pytest.approx(wanted, abs=0.02)
        session.close()


@pytest.mark.parametrize("removed", [True, False])
def test_a_bone_that_is_missing_is_named(learnt, removed):
    head, armature, _ = learnt
    if removed:
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        armature.data.edit_bones.remove(armature.data.edit_bones["c7"])
        bpy.ops.object.mode_set(mode="OBJECT")
    else:
        armature.data.bones["c7"].name = "lip"
    with pytest.raises(HeadError, match=r"bone c7 of Rig was removed or renamed .* Restore it"):
        read_controls(head)


def test_the_only_bone_or_mesh_that_has_changed_is_named(learnt):
    head, armature, _ = learnt
    armature.pose.bones["c7"].lock_rotation[0] = True
    with pytest.raises(HeadError, match="bone c7 of Rig was added or changed"):
        read_controls(head)
    armature.pose.bones["c7"].lock_rotation[0] = False
    read_controls(head)
    head.modifiers.new("More", "SUBSURF")
    with pytest.raises(HeadError, match=f"drivers of {head.name} have changed"):
        read_controls(head)


@pytest.mark.parametrize("which", first_of([0, 1, 2]))
def test_a_preview_goes_on_when_the_character_is_renamed_and_restores_it(learnt, which):
    head, armature, slider = learnt
    before = state(armature)
    show(head)
    bpy.context.scene.frame_set(40)
    learnt[which].name = "Anna"
    bpy.context.scene.frame_set(41)
    follow_settings()
    assert TakeShow.running() is not None
    at = tuple(armature.pose.bones["c5"].location)
    bpy.context.scene.frame_set(44)
    assert tuple(armature.pose.bones["c5"].location) != at
    TakeShow.running().close()
    slider.name = "Slider"
    assert state(armature) == before


def store_as_earlier(head):
    """Store the learnt controls of a head as version 1.0 did: with the names of all its objects."""
    texts = [str(read_places(head).tolist())]
    for member in members_of(head):
        mesh = mesh_of(member.obj)
        texts.append(f"{member.obj.name} {len(mesh.vertices)}")
        texts += [f"{modifier.type} {modifier.name}" for modifier in member.obj.modifiers]
        texts += drivers(mesh.shape_keys)
    armature = bpy.data.objects["Rig"]
    texts += ["Rig", *drivers(armature)]
    for bone in armature.data.bones:
        matrix = [round(value, 5) + 0.0 for value in np.array(bone.matrix_local).ravel().tolist()]
        texts.append(f"{bone.name} {'' if bone.parent is None else bone.parent.name} {bone.use_connect} {matrix}")
    for posed in armature.pose.bones:
        texts.append(f"{posed.name} {posed.rotation_mode} {posed.lock_location[:]} {posed.lock_rotation[:]}")
        for limit in posed.constraints:
            values = [
                limit.influence,
                *(getattr(limit, f"{end}_{axis}", 0.0) for end in ("min", "max") for axis in "xyz"),
            ]
            texts.append(f"{limit.type} {limit.name} {limit.mute} {[round(value, 5) + 0.0 for value in values]}")
    group = head.facemime_rig
    with np.load(io.BytesIO(base64.b64decode(group.data))) as stored:
        arrays = {name: stored[name] for name in stored.files if name != "owners"}
    channels = json.loads(str(arrays["channels"]))
    for channel in channels:
        del channel["label"]
    arrays["channels"] = np.array(json.dumps(channels))
    arrays["format"] = np.array("facemime controls 1")
    arrays["rig"] = np.array(hashlib.sha256(b"".join(text.encode() + b"\0" for text in texts)).hexdigest())
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    group.data = base64.b64encode(stream.getvalue()).decode()


def drivers(owner):
    return [
        f"{curve.data_path} {curve.array_index} {curve.mute} {curve.driver.expression}" for curve in drivers_of(owner)
    ]


def test_controls_of_an_earlier_version_serve_copies(learnt):
    store_as_earlier(learnt[0])
    copy = duplicated()
    assert moved_by_its_controls(*copy) and moved_by_its_controls(*learnt)


@pytest.mark.thorough
def test_characters_of_earlier_files_can_be_renamed_once_opened(learnt, tmp_path):
    store_as_earlier(learnt[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "earlier.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "earlier.blend"))
    found = character(bpy.data.objects)
    for obj in found:
        obj.name = f"Anna's {obj.name}"
    assert moved_by_its_controls(*found)


def test_a_changed_rig_of_an_earlier_version_has_to_be_learnt_again(learnt):
    head, armature, _ = learnt
    store_as_earlier(head)
    read_controls(head)
    armature.pose.bones["c3"].lock_location[0] = True
    with pytest.raises(HeadError, match="Learn the controls again"):
        read_controls(head)
    assert stored_map(head) is not None


def test_objects_that_share_a_name_but_for_the_number_keep_it_as_their_label():
    bpy.context.scene.render.fps = 25
    head, _ = make_face_rig()
    slider = bpy.data.objects["Slider"]
    other = slider.copy()
    bpy.context.scene.collection.objects.link(other)
    driver = mesh_of(head).shape_keys.animation_data.drivers[0].driver
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = other, "location.x"
    bpy.context.view_layer.update()
    write_controls(head, learn_controls(head))
    other.name = "Else"
    assert "Slider" in read_controls(head).controls
    assert {channel.owner for channel in stored_map(head).channels} == {"Rig", "Slider"}

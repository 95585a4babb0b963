"""Animation that a preview or a bake mutes plays again afterwards, although the user has renamed what it moves."""

import bpy
import pytest

from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import write_controls
from facemime.blender.fcurves import curves_in, drivers_of
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import mesh_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow
from tests.helpers.face_rigs import bake, show
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")
KEYED, DRIVEN, POSED = ("eyeBlinkLeft", "jawOpen"), "mouthSmileLeft", "browInnerUp"


@pytest.fixture
def head():
    """A head with keyframes, a driver, and a value on shape keys, and keyframes on its delta rotation."""
    bpy.context.scene.render.fps = 25
    head = add_head(bpy.context, units=True)
    bpy.context.view_layer.objects.active = head
    blocks = mesh_of(head).shape_keys.key_blocks
    for number, name in enumerate(KEYED):
        for frame in (1, 20):
            blocks[name].value = frame / (30.0 + number)
            blocks[name].keyframe_insert("value", frame=frame)
    head["smile"] = 0.2
    driver = blocks[DRIVEN].driver_add("value").driver
    driver.type = "SUM"
    driver.variables.new().targets[0].id = head
    driver.variables[0].targets[0].data_path = '["smile"]'
    blocks[POSED].value = 0.3
    head.keyframe_insert("delta_rotation_euler", frame=1)
    bpy.context.view_layer.update()
    return head


def keys_of(head):
    return mesh_of(head).shape_keys


def muted(*owners):
    """Data paths of the curves and drivers that are muted, and names of such tracks and keys."""
    found = [curve.data_path for owner in owners for curve in curves_in(owner.animation_data) if curve.mute]
    found += [curve.data_path for owner in owners for curve in drivers_of(owner) if curve.mute]
    found += [
        track.name
        for owner in owners
        if owner.animation_data
        for track in owner.animation_data.nla_tracks
        if track.mute
    ]
    return found + [key.name for owner in owners for key in getattr(owner, "key_blocks", ()) if key.mute]


def bake_to(head, keys):
    settings = PuppetSettings(bake=BakeSettings(keys=keys), neutral=0.0)
    return puppet_head(bpy.context.scene, head, performance(), settings)


@pytest.mark.parametrize("by", ["KEYS", "SKIN"])
def test_an_action_that_is_renamed_during_a_preview_plays_again(head, by):
    show(head, by)
    bpy.context.scene.frame_set(30)
    assert muted(head)
    keys_of(head).animation_data.action.name, head.animation_data.action.name = "Mine", "Turn"
    TakeShow.running().close()
    assert not muted(head, keys_of(head))


@pytest.mark.parametrize("by", ["KEYS", "SKIN"])
def test_keys_that_are_renamed_during_a_preview_get_their_animation_and_values_back(head, by):
    show(head, by)
    bpy.context.scene.frame_set(30)
    for name in (*KEYED, DRIVEN, POSED):
        keys_of(head).key_blocks[name].name = f"My {name}"
    bpy.context.scene.frame_set(31)
    assert TakeShow.running() is not None
    TakeShow.running().close()
    assert not muted(head, keys_of(head))
    assert keys_of(head).key_blocks[f"My {POSED}"].value == pytest.approx(0.3)


def test_curves_that_the_user_muted_stay_muted_although_others_were_renamed(head):
    curve = next(iter(curves_in(keys_of(head).animation_data)))
    curve.mute = True
    show(head, "KEYS")
    for name in KEYED:
        keys_of(head).key_blocks[name].name = f"My {name}"
    TakeShow.running().close()
    assert muted(head, keys_of(head)) == [curve.data_path]


def test_a_track_that_is_renamed_during_a_preview_plays_again(head):
    data = keys_of(head).animation_data
    action, slot = data.action, getattr(data, "action_slot", None)
    strip = data.nla_tracks.new().strips.new("Mine", 1, action)
    if slot is not None:
        strip.action_slot = slot
    data.action = None
    show(head, "KEYS")
    assert data.nla_tracks[0].mute
    data.nla_tracks[0].name = "Renamed"
    TakeShow.running().close()
    assert not muted(head, keys_of(head))


def test_what_a_bake_muted_plays_again_after_its_keys_were_renamed(head):
    bake_to(head, "named")
    assert muted(keys_of(head))
    for name in (*KEYED, DRIVEN):
        keys_of(head).key_blocks[name].name = f"My {name}"
    remove_baked(head, own_targets(head))
    assert not muted(head, keys_of(head))


def test_bones_that_are_renamed_after_a_bake_play_their_own_animation_again(rigged):
    head, armature = rigged
    armature.pose.bones["c5"].keyframe_insert("location", frame=1)
    write_controls(head, learn_controls(head))
    bake(head)
    assert muted(armature)
    armature.data.bones["c5"].name = "lip"
    bake_to(head, "new")
    assert not muted(armature) and any("lip" in curve.data_path for curve in curves_in(armature.animation_data))

"""Heads that are driven live by their own shape keys."""

import bpy
import pytest

from facemime.blender.animation.live_keys import live_keys
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import ASIDE_PROPERTY, PART_PROPERTY, VALUES_PROPERTY
from facemime.core.base.errors import HeadError
from facemime.sessions.start import follow_settings, start_session
from tests.helpers.curves import curves_of
from tests.helpers.live_ticks import wait_for

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def character() -> bpy.types.Object:
    """A head with ARKit's keys that is not the built-in one."""
    head = add_head(bpy.context, units=True)
    for child in list(head.children):
        bpy.data.objects.remove(child)
    return head


def values(head: bpy.types.Object) -> dict[str, float]:
    """Values of the head's shape keys other than the first."""
    return {key.name: key.value for key in head.data.shape_keys.key_blocks[1:]}


def play(session, head: bpy.types.Object) -> None:
    """Step until the mouth is open."""
    wait_for(lambda: session.step() and values(head)["jawOpen"] > 0.1)


def test_a_character_with_known_keys_is_driven_by_their_values_or_by_its_skin_on_request(looping):
    head, scene = character(), bpy.context.scene
    session = start_session(scene, [head])
    play(session, head)
    assert LIVE_KEY not in values(head)
    scene.facemime.drive_by = "SKIN"
    follow_settings(session, scene)
    wait_for(lambda: session.step() and LIVE_KEY in values(head))
    some = values(head)
    assert some.pop(LIVE_KEY) == 1.0 and not any(some.values())
    scene.facemime.drive_by = "KEYS"
    follow_settings(session, scene)
    play(session, head)
    assert LIVE_KEY not in values(head)
    session.close()
    assert not any(values(head).values()) and VALUES_PROPERTY not in head.data.shape_keys


def test_what_the_user_made_follows_the_keys(looping):
    """A corrective that a driver computes from a key, and a second mesh whose keys follow those of the head."""
    head, scene = character(), bpy.context.scene
    head.shape_key_add(name="Corrective")
    blocks = head.data.shape_keys.key_blocks
    _drive(head.data.shape_keys, "Corrective", head.data.shape_keys, "jawOpen")
    session = start_session(scene, [head])
    play(session, head)
    bpy.context.view_layer.update()
    evaluated = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.shape_keys.key_blocks
    assert evaluated["Corrective"].value == pytest.approx(blocks["jawOpen"].value)
    session.close()


def test_keys_that_a_slider_drives_are_driven_by_the_performer_until_the_end(looping):
    head, scene = character(), bpy.context.scene
    head["slider"] = 0.25
    keys = head.data.shape_keys
    driver = keys.driver_add('key_blocks["jawOpen"].value')
    variable = driver.driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = head, '["slider"]'
    driver.driver.type = "AVERAGE"
    session = start_session(scene, [head])
    play(session, head)
    assert keys.animation_data.drivers[0].mute
    session.close()
    assert not keys.animation_data.drivers[0].mute and ASIDE_PROPERTY not in keys


def test_values_and_animation_of_the_keys_return_at_the_end_and_in_saved_files(looping, tmp_path):
    head, scene = character(), bpy.context.scene
    blocks = head.data.shape_keys.key_blocks
    blocks["mouthSmileLeft"].value = 0.3
    blocks["jawOpen"].keyframe_insert("value", frame=1)
    session = start_session(scene, [head])
    play(session, head)
    assert curves_of(head.data.shape_keys)[0].mute
    assert values(head)["mouthSmileLeft"] != pytest.approx(0.3)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    play(session, head)
    session.close()
    for opened in (False, True):
        if opened:
            bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "copy.blend"))
        keys = bpy.data.objects["Facemime Head"].data.shape_keys
        assert keys.key_blocks["mouthSmileLeft"].value == pytest.approx(0.3)
        assert sum(key.value for key in keys.key_blocks[1:]) == pytest.approx(0.3)
        assert not curves_of(keys)[0].mute and not {VALUES_PROPERTY, ASIDE_PROPERTY} & set(dict(keys))


def test_a_file_that_was_left_by_a_crash_opens_with_the_keys_as_they_were(looping, tmp_path, monkeypatch):
    head = character()
    session = start_session(bpy.context.scene, [head])
    play(session, head)
    monkeypatch.setattr(type(session), "suspend", lambda self: None)
    monkeypatch.setattr(type(session), "resume", lambda self: None)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "crashed.blend"), copy=True)
    session.close()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "crashed.blend"))
    assert not any(values(bpy.data.objects["Facemime Head"]).values())


def test_kept_poses_stay_in_the_keys(looping):
    head = character()
    session = start_session(bpy.context.scene, [head])
    play(session, head)
    session.keep = True
    session.close()
    assert values(head)["jawOpen"] > 0.1 and VALUES_PROPERTY not in head.data.shape_keys


def _drive(keys: bpy.types.Key, name: str, by: bpy.types.Key, source: str) -> None:
    """Let a key follow another by a driver."""
    driver = keys.driver_add(f'key_blocks["{name}"].value').driver
    driver.type = "AVERAGE"
    variable = driver.variables.new()
    variable.targets[0].id_type = "KEY"
    variable.targets[0].id, variable.targets[0].data_path = by, f'key_blocks["{source}"].value'


def test_the_built_in_head_is_driven_by_its_skin_unless_keys_are_requested():
    head = add_head(bpy.context, units=True)
    assert live_keys(head, "AUTOMATIC") is None and len(live_keys(head, "KEYS").offsets) > 40


def test_a_few_keys_are_not_taken_for_a_set():
    head = character()
    for key in [key for key in head.data.shape_keys.key_blocks[1:] if "Blink" in key.name]:
        head.shape_key_remove(key)
    assert live_keys(head, "AUTOMATIC") is None


def test_a_head_without_keys_cannot_be_driven_by_keys():
    head = add_head(bpy.context)
    assert PART_PROPERTY in head.children[0]
    with pytest.raises(HeadError, match="No key mapping preset"):
        live_keys(head, "KEYS")

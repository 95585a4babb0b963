"""Characters whose own keys leave their eyes open, as many avatars' do, shut them."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_keys import LiveValues
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.characters import write_kinds
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import HEAD_PROPERTY, PART_PROPERTY
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.heads.rig import Part
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.take import Take
from tests.helpers.curves import curves_of
from tests.helpers.takes import coefficient_take, make_take

BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")


def character(share: float) -> bpy.types.Object:
    """A head with separate eyes and ARKit's keys, whose blinks move the lids by a share of what shuts them."""
    head = add_head(bpy.context, units=True)
    for child in list(head.children):
        if child.get(PART_PROPERTY, "").startswith("eye"):
            del child[PART_PROPERTY]
            child[HEAD_PROPERTY] = head
            write_kinds(child.data, np.full(len(child.data.vertices), Part.ON_HEAD))
        else:
            bpy.data.objects.remove(child)
    blocks = head.data.shape_keys.key_blocks
    for name in BLINKS:
        rest, shut = (np.empty(3 * len(head.data.vertices), np.float32) for _ in range(2))
        blocks[0].points.foreach_get("co", rest)
        blocks[name].points.foreach_get("co", shut)
        blocks[name].points.foreach_set("co", rest + share * (shut - rest))
    return head


def blinking() -> Take:
    """Two seconds at rest with a long blink in the second one."""
    head = load_head()
    rest = head.vertices[head.landmarks].astype(float)
    shut = sum(head.units[COEFFICIENTS.index(name)][head.landmarks].astype(float) for name in BLINKS)
    amount = np.clip(6.0 * np.sin(np.pi * np.clip(np.arange(50) / 25.0 - 1.0, 0.0, 1.0)), 0.0, 1.0)
    return make_take((rest + amount[:, None, None] * shut) / outer_eye_distance(rest))


def baked(head: bpy.types.Object, take: Take) -> dict[str, float]:
    """Bake a take to the head's own keys; the largest value of each blink."""
    settings = PuppetSettings(bake=BakeSettings(keys="mapped"), neutral=0.0)
    puppet_head(bpy.context.scene, head, take, settings)
    largest = {}
    for curve in curves_of(head.data.shape_keys):
        if (name := curve.data_path.split('"')[1]) in BLINKS:
            largest[name] = max(point.co[1] for point in curve.keyframe_points)
    return largest


def test_bakes_take_blinks_as_far_as_the_eyes_need_it():
    whole = baked(character(1.0), blinking())
    head = character(0.8)
    largest = baked(head, blinking())
    blocks = head.data.shape_keys.key_blocks
    bpy.context.scene.frame_set(int(1 + 1.5 * 24))
    for name in BLINKS:
        assert largest[name] / whole[name] == pytest.approx(1.25, abs=0.07)
        assert blocks[name].slider_max == pytest.approx(largest[name]) and largest[name] > 1.0
        assert blocks[name].value == pytest.approx(largest[name], abs=0.03)
    assert blocks["jawOpen"].slider_max == 1.0


def test_a_range_that_the_user_made_smaller_stays():
    head = character(0.8)
    key = head.data.shape_keys.key_blocks["eyeBlinkLeft"]
    key.slider_max = 0.6
    largest = baked(head, blinking())
    assert key.slider_max == pytest.approx(0.6) and largest["eyeBlinkLeft"] == pytest.approx(0.6)
    assert largest["eyeBlinkRight"] > 1.0
    live = LiveValues(head.data.shape_keys, BLINKS, set())
    live.attach()
    live.write(np.array([1.2, 1.2]))
    assert key.slider_max == pytest.approx(0.6) and key.value == pytest.approx(0.6)
    live.detach(keep=False)


def test_a_key_with_coordinates_that_are_not_numbers_is_named_and_may_be_muted():
    head = character(1.0)
    key = head.data.shape_keys.key_blocks["jawOpen"]
    key.points[100].co = (np.nan,) * 3
    with pytest.raises(HeadError, match="jawOpen of Facemime Head has coordinates that are not numbers"):
        baked(head, blinking())
    key.mute = True
    assert min(baked(head, blinking()).values()) > 0.5


def test_muted_keys_of_the_mapping_are_named():
    head = character(1.0)
    settings = PuppetSettings(bake=BakeSettings(keys="mapped"), neutral=0.0)
    assert not any("left out" in note for note in puppet_head(bpy.context.scene, head, blinking(), settings).warnings)
    head.data.shape_keys.key_blocks["jawOpen"].mute = True
    report = puppet_head(bpy.context.scene, head, blinking(), settings)
    assert "Muted shape keys were left out: jawOpen. Unmute them to show them." in report.warnings


def test_what_a_phone_states_stays_as_it_is():
    assert max(baked(character(0.8), coefficient_take()).values()) == pytest.approx(0.9, abs=0.02)


def test_live_values_beyond_the_range_are_shown_and_the_range_returns():
    head = character(0.8)
    keys = head.data.shape_keys
    live = LiveValues(keys, BLINKS, set())
    live.attach()
    live.write(np.array([1.2, 0.4]))
    assert [keys.key_blocks[name].value for name in BLINKS] == pytest.approx([1.2, 0.4])
    live.detach(keep=False)
    assert [keys.key_blocks[name].value for name in BLINKS] == [0.0, 0.0]
    assert [keys.key_blocks[name].slider_max for name in BLINKS] == [1.0, 1.0]
    live.attach()
    live.write(np.array([1.2, 0.4]))
    live.detach(keep=True)
    assert keys.key_blocks[BLINKS[0]].value == pytest.approx(1.2)


def test_keys_that_move_both_ways_are_baked_and_shown_below_0():
    head = character(1.0)
    keys = head.data.shape_keys
    key = keys.key_blocks["eyeBlinkLeft"]
    key.name = "Lids Open-Close"
    table = KeyMap("Mine", (KeyRow("eyeBlinkLeft", key.name, gain=-1.0), KeyRow("eyeBlinkRight", "eyeBlinkRight")))
    settings = PuppetSettings(bake=BakeSettings(keys="mapped", table=table), neutral=0.0)
    puppet_head(bpy.context.scene, head, blinking(), settings)
    bpy.context.scene.frame_set(int(1 + 1.5 * 24))
    assert key.slider_min == -1.0 and key.value < -0.5
    key.slider_min = 0.0
    live = LiveValues(keys, [key.name], set())
    live.attach()
    live.write(np.array([-0.8]))
    assert key.value == pytest.approx(-0.8)
    live.detach(keep=False)
    assert key.slider_min == 0.0

"""A head that is animated already is driven: what moves the same is muted and named, or the take is added to it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from facemime.blender.actions import Curve, write_curves
from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.conflicts import mute_under, playing_under
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import members_of
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

FRAMES = (1, 20, 40)


def bake(head, keys="mapped", **settings):
    wanted = PuppetSettings(bake=BakeSettings(keys=keys, **settings))
    return puppet_head(bpy.context.scene, head, performance(), wanted)


def values_of(head, after=0):
    """Values of all keys in some frames, (F, K), that many frames later."""
    rows = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame + after)
        rows.append([key.value for key in head.data.shape_keys.key_blocks])
    return np.array(rows)


def animate(head, name="jawOpen", action="Idle"):
    """Animate a key from 0.1 to 0.3."""
    key = head.data.shape_keys.key_blocks[name]
    for frame, value in ((1, 0.1), (40, 0.3)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    head.data.shape_keys.animation_data.action.name = action


def _curves(head):
    animate(head)


def _strip(head):
    animate(head)
    data = head.data.shape_keys.animation_data
    data.nla_tracks.new().strips.new("Idle", 1, data.action)
    data.action, data.nla_tracks[0].name = None, "Idle"


def _solo(head):
    """A strip on a track that plays alone, above one that it silences."""
    animate(head, "mouthSmileLeft", "Silent")
    data = head.data.shape_keys.animation_data
    data.nla_tracks.new().strips.new("Silent", 1, data.action)
    data.nla_tracks[0].name, data.action = "Silent", None
    animate(head)
    data.nla_tracks.new().strips.new("Idle", 1, data.action)
    data.nla_tracks[1].name, data.action = "Idle", None
    head.data.shape_keys.key_blocks["mouthSmileLeft"].value = 0.0
    data.nla_tracks[1].is_solo = True


def _added_action(head):
    animate(head)
    head.data.shape_keys.animation_data.action_blend_type = "ADD"


def _driver(head):
    empty = bpy.data.objects.new("Slider", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location.x = 0.2
    driver = head.data.shape_keys.key_blocks["jawOpen"].driver_add("value").driver
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = empty, "location.x"
    driver.type = "AVERAGE"


@pytest.fixture
def plain():
    """Values of a bake to a head without other animation."""
    head = add_head(bpy.context, units=True, name="Plain")
    bake(head)
    return values_of(head)


@pytest.mark.parametrize("nla", first_of([False, True]))
@pytest.mark.parametrize("moved", first_of([_curves, _strip, _solo, _added_action, _driver], 2))
def test_a_bake_mutes_what_moves_its_keys_and_its_removal_lets_it_play_again(moved, nla, plain):
    head = add_head(bpy.context, units=True)
    moved(head)
    before = values_of(head)
    for _ in range(2):
        report = bake(head, nla=nla)
        np.testing.assert_allclose(values_of(head), plain, atol=1e-6)
        if moved != _strip or nla:
            assert any("Muted" in warning for warning in report.warnings) or moved == _strip
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(values_of(head), before, atol=1e-6)


@pytest.mark.parametrize("moved", first_of([_curves, _strip]))
def test_a_take_is_added_to_the_animation_of_keys_on_request(moved, plain):
    head = add_head(bpy.context, units=True)
    moved(head)
    before = values_of(head)
    for _ in range(2):
        report = bake(head, keep_animation=True)
        np.testing.assert_allclose(values_of(head), np.minimum(plain + before, 1.0), atol=1e-5)
        assert not any("Muted" in warning for warning in report.warnings)
    remove_baked(head, own_targets(head))
    np.testing.assert_allclose(values_of(head), before, atol=1e-6)


def moving_empty(kind, mode, *, strip):
    """An object that moves along x from frame 10 to 30 in an action of an extrapolation, perhaps above a strip."""
    empty = bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    data = empty.animation_data_create()
    if strip:
        empty.keyframe_insert("location", frame=1, index=1)
        data.nla_tracks.new().strips.new("Other", 1, data.action)
        data.action = None
    for frame, x in ((10, 1.0), (20, 2.0), (30, 3.0)):
        empty.location.x = x
        empty.keyframe_insert("location", frame=frame, index=0)
    data.action_extrapolation = mode
    (curve,) = curves_of(empty)
    if kind == "repeated":
        curve.modifiers.new("CYCLES")
    elif kind == "straight":
        curve.extrapolation = "LINEAR"
    elif kind == "of a manual range":
        data.action.use_frame_range, data.action.frame_start, data.action.frame_end = True, 12, 25
    return empty


@pytest.mark.parametrize("strip", [False, True])
@pytest.mark.parametrize("mode", ["HOLD", "HOLD_FORWARD", "NOTHING"])
@pytest.mark.parametrize("kind", ["plain", "repeated", "straight", "of a manual range"])
def test_animation_to_which_a_take_is_added_plays_as_before_in_all_frames(kind, mode, strip):
    def played():
        found = []
        for frame in (-3000, 1, 11, 15, 28, 40, 90_000):
            bpy.context.scene.frame_set(frame)
            found.append(empty.location.x)
        return found

    empty = moving_empty(kind, mode, strip=strip)
    before = played()
    write_curves(empty, "Take", np.arange(5.0, 36.0), [Curve("location", 0, np.zeros(31))], add=True)
    assert empty.animation_data.action is None
    assert played() == pytest.approx(before, abs=1e-5)


def _muted_curve(head):
    animate(head)
    curves_of(head.data.shape_keys)[0].mute = True


def _still(head):
    """Keys that do not move, as those that a pose library sets."""
    key = head.data.shape_keys.key_blocks["jawOpen"]
    for frame in (1, 2000):
        key.keyframe_insert("value", frame=frame)


@pytest.mark.parametrize("start", first_of([37, 1001]))
@pytest.mark.parametrize(
    ("moved", "settings"),
    [(None, {"nla": True}), (_still, {}), (_muted_curve, {}), (_still, {"keep_animation": True})],
)
def test_a_bake_on_a_strip_plays_from_the_frame_where_its_take_begins(start, moved, settings, plain):
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    if moved is not None:
        moved(head)
    scene.frame_start, scene.frame_end = start, start + 99
    bake(head, start="scene", **settings)
    np.testing.assert_allclose(values_of(head, start - 1), plain, atol=5e-3)


def test_a_driver_that_is_to_be_kept_moves_its_key_alone(plain):
    head = add_head(bpy.context, units=True)
    _driver(head)
    bake(head, keep_animation=True)
    place = head.data.shape_keys.key_blocks.find("jawOpen")
    wanted = plain.copy()
    wanted[:, place] = 0.2
    np.testing.assert_allclose(values_of(head), wanted, atol=1e-6)


@pytest.mark.parametrize("source", first_of(["key", "mesh", "object"]))
@pytest.mark.parametrize("keys", ["mapped", "named"])
def test_keys_of_parts_that_follow_those_of_the_head_stay_with_their_drivers(source, keys):
    head = add_head(bpy.context, units=True)
    lashes = members_of(head)[1].obj
    block, prefix = {
        "key": (head.data.shape_keys, ""),
        "mesh": (head.data, "shape_keys."),
        "object": (head, "data.shape_keys."),
    }[source]
    for key in lashes.data.shape_keys.key_blocks[1:]:
        driver = key.driver_add("value").driver
        driver.type = "AVERAGE"
        target = driver.variables.new().targets[0]
        target.id_type = block.id_type
        target.id, target.data_path = block, f'{prefix}key_blocks["{key.name}"].value'
    report = bake(head, keys, residual=False)
    assert not any("Muted" in warning for warning in report.warnings)
    drivers = lashes.data.shape_keys.animation_data.drivers
    assert len(drivers) == 52 and not any(driver.mute for driver in drivers)
    assert lashes.data.shape_keys.animation_data.action is None
    np.testing.assert_allclose(values_of(lashes)[:, 1:], values_of(head)[:, 1:], atol=1e-5)


def test_a_corrective_that_follows_other_keys_is_not_fitted():
    head = add_head(bpy.context, units=True)
    corrective = head.shape_key_add(name="corrective", from_mix=False)
    corrective.data[0].co.x += 0.01
    corrective.value = 0.0
    driver = corrective.driver_add("value").driver
    driver.type = "AVERAGE"
    target = driver.variables.new().targets[0]
    target.id_type, target.id = "KEY", head.data.shape_keys
    target.data_path = 'key_blocks["jawOpen"].value'
    bake(head, "named")
    values = dict(zip(head.data.shape_keys.key_blocks.keys(), values_of(head).T, strict=True))
    np.testing.assert_allclose(values["corrective"], values["jawOpen"], atol=1e-6)


@pytest.fixture
def head():
    """A head with an idle animation of a key of its own that opens the mouth, and one that moves only the neck."""
    head = add_head(bpy.context, units=True)
    animate(head)
    neck = head.shape_key_add(name="neck", from_mix=False)
    rest = np.array([vertex.co for vertex in head.data.vertices])
    neck.data[int(rest[:, 2].argmin())].co.z -= 0.01
    neck.value = 0.0
    for frame, value in ((1, 0.0), (40, 1.0)):
        neck.value = value
        neck.keyframe_insert("value", frame=frame)
    return head


def test_an_action_under_new_keys_is_muted_where_it_moves_the_same_vertices(head):
    report = bake(head, "new")
    assert any("Idle (jawOpen)" in warning for warning in report.warnings)
    curves = {curve.data_path: curve for curve in curves_of(head.data.shape_keys)}
    assert curves['key_blocks["jawOpen"].value'].mute and not curves['key_blocks["neck"].value'].mute
    assert not any(curve.mute for path, curve in curves.items() if "jawOpen" not in path)


def test_an_action_under_a_bake_that_is_kept_is_reported_and_muted_on_request(head):
    report = bake(head, "new", keep_animation=True)
    assert report.others == ("Idle",) and any("Idle" in warning for warning in report.warnings)
    assert mute_under(head) == 2 and playing_under(head) == []
    before = values_of(head)[:, head.data.shape_keys.key_blocks.find("jawOpen")]
    assert np.ptp(before) < 1e-6


def test_the_users_strip_is_muted_and_that_of_a_bake_is_not(head):
    data = head.data.shape_keys.animation_data
    data.nla_tracks.new().strips.new("Idle", 1, data.action)
    data.action = None
    data.nla_tracks[0].name = "Imported"
    bake(head, "new", nla=True, keep_animation=True)
    assert playing_under(head) == ["Imported"]
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.mute_others() == {"FINISHED"}
    assert {track.name: track.mute for track in data.nla_tracks} == {"Imported": True, "Facemime": False}


def test_without_other_animation_nothing_is_reported():
    head = add_head(bpy.context)
    report = puppet_head(bpy.context.scene, head, performance())
    assert report.others == () and not report.notes and mute_under(head) == 0

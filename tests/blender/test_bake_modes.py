"""All bakes: existing shape keys, caches, clean curves, NLA, and bones."""

import bpy
import numpy as np
import pytest

from facemime.blender.actions import TRACK
from facemime.blender.animation.bake_keys import BAKED_KEY_PREFIX
from facemime.blender.animation.exporting import MODIFIER
from facemime.blender.animation.live import Follow, LiveHeadObject
from facemime.blender.animation.puppet import puppet_head, puppet_heads
from facemime.blender.animation.refit import keyframe_count
from facemime.blender.animation.targets import PoseTarget
from facemime.blender.frames import rotation_to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rigs import read_rig
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import HeadError
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.smooth import smooth_take
from tests.helpers.bakes import armature, bake, largest_error, played
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("at_the_takes_rate")


@pytest.mark.parametrize("nla", first_of([False, True]))
@pytest.mark.parametrize(
    ("options", "most"),
    [
        ({}, 0.01),
        ({"clean": 0.005}, 0.015),
        ({"max_keys": 1}, 0.2),
        ({"keys": "named"}, 0.3),
        ({"keys": "named", "clean": 0.01}, 0.3),
        ({"keys": "mapped"}, 0.5),
        ({"keys": "cache"}, 1e-5),
        ({"keys": "alembic"}, 1e-5),
    ],
    ids=str,
)
def test_every_bake_plays_back_the_live_vertices_within_the_reported_error(options, most, nla, tmp_path):
    head = add_head(bpy.context, units=options.get("keys") in ("named", "mapped"))
    report = bake(head, nla=nla, path=tmp_path / "cache.pc2", **options)
    assert report.worst_error < most
    assert largest_error(head, report) <= report.worst_error + 1e-4
    assert f"{report.keys} shape keys" in report.summary() or report.keys == 0
    assert (tmp_path / "cache.abc").exists() == (options.get("keys") == "alembic")
    has_action = head.animation_data.action is not None
    tracks = [track.name for track in head.animation_data.nla_tracks]
    assert (has_action, tracks) == ((False, [TRACK]) if nla else (True, []))


@pytest.mark.thorough
def test_a_limit_on_keys_is_kept_and_increases_the_error():
    head = add_head(bpy.context)
    one, two = (bake(head, keys="new", max_keys=count) for count in (1, 2))
    assert (one.keys, two.keys) == (1, 2) and one.worst_error > 2.0 * two.worst_error
    assert largest_error(head, two) <= two.worst_error + 1e-4


def test_curves_on_whole_frames_have_few_keyframes_and_stay_within_their_error():
    head = add_head(bpy.context)
    bpy.context.scene.render.fps = 25
    report = bake(head, whole_frames=True, clean=0.01)
    points = [point for curve in curves_of(head.data.shape_keys) for point in curve.keyframe_points]
    assert len(points) == report.keyframes < report.frames / 3
    assert all(point.co.x == round(point.co.x) and point.interpolation == "BEZIER" for point in points)
    assert largest_error(head, report) <= report.worst_error + 1e-4
    every = bake(head, whole_frames=True, clean=0.0)
    assert every.keyframes == every.frames == every.keys * len(performance().times)


def test_named_keys_show_all_of_the_motion_with_residual_keys_in_a_group_of_their_own():
    head = add_head(bpy.context, units=True)
    bpy.context.scene.render.fps = 25
    named = bake(head, keys="named", residual=False)
    both = bake(head, keys="automatic", whole_frames=True)
    assert both.worst_error < both.named_error == pytest.approx(named.worst_error + 0.005, abs=1e-3)
    assert largest_error(head, both) <= both.worst_error + 1e-4
    curves = curves_of(head.data.shape_keys)
    groups = {curve.data_path.split('"')[1]: curve.group.name for curve in curves}
    assert {groups[name] for name in groups if name.startswith("Facemime Residual")} == {"Residual"}
    assert groups["jawOpen"] == "Jaw" and groups["browInnerUp"] == "Brows" and groups["eyeBlinkLeft"] == "Eyes"
    # Muting the group leaves what the named keys show.
    for curve in curves:
        curve.mute = curve.group.name == "Residual"
    for key in head.data.shape_keys.key_blocks:
        key.value = 0.0 if key.name.startswith("Facemime") else key.value
    assert named.worst_error / 2 < largest_error(head, both) <= both.named_error + 1e-4


@pytest.mark.thorough
def test_a_character_has_one_action_where_actions_have_slots():
    head = add_head(bpy.context, units=True)
    for _ in range(2):
        bake(head, keys="automatic", whole_frames=True)
        owners = [head, head.data.shape_keys, *head.children]
        actions = {data.action for owner in owners if (data := owner.animation_data) is not None} - {None}
        assert len(actions) == 1 or bpy.app.version < (4, 4)


def test_detail_fits_the_last_bake_again_until_a_keyframe_is_changed():
    head, settings = add_head(bpy.context, units=True), bpy.context.scene.facemime_takes.bake
    first = bake(head, keys="automatic", whole_frames=True)
    assert settings.detail == pytest.approx(75.0) and keyframe_count(head) == first.keyframes
    settings.detail = 100.0
    assert keyframe_count(head) == first.frames
    settings.detail = 20.0
    few = keyframe_count(head)
    assert few < first.keyframes
    curve = next(curve for curve in curves_of(head.data.shape_keys) if "jawOpen" in curve.data_path)
    curve.keyframe_points[0].co.y += 0.1
    settings.detail = 75.0
    assert keyframe_count(head) == few and curve.keyframe_points[0].co.y > 0.05


@pytest.mark.thorough
def test_baking_to_something_else_removes_the_earlier_bake(tmp_path):
    head = add_head(bpy.context, units=True)
    bake(head, keys="named")
    bake(head, keys="cache", path=tmp_path / "a.pc2", nla=True)
    assert all(block.value == 0.0 for block in head.data.shape_keys.key_blocks[1:])
    assert not curves_of(head.data.shape_keys) and head.modifiers[0].name == MODIFIER
    report = bake(head, keys="new")
    assert MODIFIER not in head.modifiers and not head.animation_data.nla_tracks
    names = [block.name for block in head.data.shape_keys.key_blocks]
    assert sum(name.startswith(BAKED_KEY_PREFIX) for name in names) == report.keys
    assert largest_error(head, report) < 0.01


def test_keys_stay_within_their_ranges_and_a_custom_table_moves_only_its_own_keys():
    head = add_head(bpy.context, units=True)
    head.data.shape_keys.key_blocks["jawOpen"].slider_max = 0.15
    table = KeyMap("mine", (KeyRow("jawOpen", "Jaw_Open", 2.0), KeyRow("browInnerUp", "browInnerUp", 0.5)))
    report = bake(head, keys="mapped", table=table)
    assert report.keys == 2
    curves = {curve.data_path.split('"')[1]: curve for curve in curves_of(head.data.shape_keys)}
    assert set(curves) == {"jawOpen", "browInnerUp"}
    assert max(point.co[1] for point in curves["jawOpen"].keyframe_points) == pytest.approx(0.15)
    assert max(point.co[1] for point in curves["browInnerUp"].keyframe_points) > 0.1


@pytest.mark.thorough
def test_a_bake_never_removes_an_animators_curves():
    head = add_head(bpy.context, units=True)
    keys = head.data.shape_keys
    mine = keys.key_blocks["jawOpen"]
    mine.value = 0.4
    mine.keyframe_insert("value", frame=7)
    for _ in range(2):
        bake(head, keys="named")
    (curve,) = (curve for curve in curves_of(keys) if curve.mute)
    assert [tuple(point.co) for point in curve.keyframe_points] == [(7.0, pytest.approx(0.4))]


@pytest.mark.parametrize("mode", first_of(["QUATERNION", "XYZ", "AXIS_ANGLE"]))
def test_bones_follow_the_baked_pose_of_head_and_eyes_as_they_do_live(mode):
    head = add_head(bpy.context)
    rig = armature("Head", "Eye")
    for bone in rig.pose.bones:
        bone.rotation_mode = mode
    empty = bpy.data.objects.new("Eye", None)
    bpy.context.collection.objects.link(empty)
    empty.rotation_euler = (0.2, 0.5, 1.0)
    targets = {
        "head": PoseTarget.of(rig, "Head"),
        "eye_left": PoseTarget.of(rig, "Eye"),
        "eye_right": PoseTarget.of(empty),
    }
    report = bake(head, targets)
    row = int(np.argmax(np.abs(report.motion.rotation[:, 0, 2])))
    played(head, report, row)
    baked = [np.array(bone.matrix_basis) for bone in rig.pose.bones] + [np.array(empty.matrix_basis)]
    take = smooth_take(performance())
    shown = LiveHeadObject(head, targets, Follow(translation=True))
    rig.animation_data_clear()
    empty.animation_data_clear()
    frame = int(np.flatnonzero(take.found)[row])
    shown.attach()
    shown.write(HeadDriver(read_rig(head), report.neutral).frame(take.result(frame)))
    bpy.context.view_layer.update()
    live = [np.array(bone.matrix_basis) for bone in rig.pose.bones] + [np.array(empty.matrix_basis)]
    shown.detach(keep=False)
    np.testing.assert_allclose(baked, live, atol=2e-3)
    axes = np.array(rig.data.bones["Head"].matrix_local)[:3, :3]
    turned = axes @ baked[0][:3, :3] @ axes.T
    np.testing.assert_allclose(turned, rotation_to_blender(report.motion.rotation[row]), atol=2e-3)
    assert np.abs(turned - np.eye(3)).max() > 0.1
    eyes = [child for child in head.children if child.name.startswith("Eye")]
    assert all(eye.animation_data.action is None or not curves_of(eye) for eye in eyes)


@pytest.mark.parametrize("nla", first_of([False, True]))
def test_head_and_eyes_that_follow_bones_of_one_armature_are_baked_side_by_side(nla):
    head, rig = add_head(bpy.context), armature("Head", "Eye")
    targets = {"head": PoseTarget.of(rig, "Head"), "eye_left": PoseTarget.of(rig, "Eye")}
    for _ in range(2):  # the second bake replaces the first
        bake(head, targets, nla=nla)
        data = rig.animation_data
        tracks = [track.name for track in data.nla_tracks]
        assert (data.action is None, tracks) == ((True, [TRACK]) if nla else (False, []))
    turned = set()
    for frame in range(1, 60):
        bpy.context.scene.frame_set(frame)
        turned |= {bone.name for bone in rig.pose.bones if bone.rotation_quaternion.angle > 0.05}
    assert "Head" in turned


@pytest.mark.thorough
def test_a_track_that_holds_another_strip_is_kept_and_the_bake_gets_a_new_one():
    head = add_head(bpy.context)
    action = bpy.data.actions.new("Mine")
    head.animation_data_create().nla_tracks.new().name = "Mine"
    bake(head, nla=True)
    head.animation_data.nla_tracks[TRACK].name = "Kept"
    bake(head, nla=True)
    assert [track.name for track in head.animation_data.nla_tracks] == ["Mine", "Kept", TRACK]
    bpy.data.actions.remove(action)


@pytest.mark.thorough
def test_a_strip_that_the_user_put_onto_a_bakes_track_survives_the_next_bake():
    head = add_head(bpy.context)
    bake(head, nla=True)
    data = head.data.shape_keys.animation_data
    data.nla_tracks[TRACK].strips.new("Mine", 500, bpy.data.actions.new("Mine"))
    for _ in range(2):
        bake(head, nla=True)
        strips = [strip for track in data.nla_tracks for strip in track.strips]
        assert sorted(strip.name == "Mine" for strip in strips) == [False, True]
    assert data.nla_tracks[TRACK].strips["Mine"].frame_start == 500.0


def test_an_animated_delta_transform_is_a_placement_to_which_the_pose_is_added():
    head, scene = add_head(bpy.context), bpy.context.scene
    for frame, height in ((1, 0.0), (60, 3.0)):
        head.delta_location.z = height
        head.keyframe_insert("delta_location", frame=frame)
    heights = {}
    for again in (False, True):
        for frame in (1, 30, 60, 90):
            scene.frame_set(frame)
            heights.setdefault(frame, []).append(head.matrix_world.translation.z)
        if not again:
            puppet_head(scene, head, performance(), PuppetSettings(translation=True))
    for before, after in heights.values():
        assert after == pytest.approx(before, abs=0.1)


@pytest.mark.parametrize("nla", first_of([False, True]))
@pytest.mark.parametrize("keys", first_of(["new", "named", "mapped", "cache"], 2))
def test_a_baked_head_shows_only_the_live_frame_and_plays_its_bake_afterwards(keys, nla, tmp_path):
    head = add_head(bpy.context, units=True)
    report = bake(head, keys=keys, nla=nla, path=tmp_path / "a.pc2")
    before = played(head, report, 40)
    driver, take = HeadDriver(read_rig(head), report.neutral), smooth_take(performance())
    shown = LiveHeadObject(head, {"head": PoseTarget.of(head)}, Follow(translation=True))
    shown.attach()
    frame = driver.frame(take.result(50))
    shown.write(frame)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(played(head, report, 40), frame.vertices[: len(before)], atol=1e-6)
    shown.detach(keep=False)
    np.testing.assert_allclose(played(head, report, 40), before, atol=1e-6)


@pytest.mark.thorough
def test_each_of_several_heads_gets_a_cache(tmp_path):
    heads = [add_head(bpy.context, name=name) for name in ("One", "Two")]
    settings = PuppetSettings(bake=BakeSettings(keys="cache", path=tmp_path / "take.pc2"))
    reports = puppet_heads(bpy.context.scene, heads, performance(), settings)
    assert len({head.modifiers[MODIFIER].filepath for head in heads}) == 2
    for head, report in zip(heads, reports, strict=True):
        assert largest_error(head, report) < 1e-4


@pytest.mark.thorough
@pytest.mark.parametrize("keys", ["named", "mapped"])
def test_vertex_groups_of_keys_are_respected_and_muted_keys_ignored(keys):
    head = add_head(bpy.context, units=True)
    blocks = head.data.shape_keys.key_blocks
    blocks["browInnerUp"].mute = True
    half = head.vertex_groups.new(name="Half")
    half.add([vertex.index for vertex in head.data.vertices if vertex.co.x > 0.0], 0.5, "REPLACE")
    blocks["jawOpen"].vertex_group = "Half"
    report = bake(head, keys=keys, residual=False)
    assert largest_error(head, report) <= report.worst_error + 1e-4
    assert report.keys == 51 and blocks["browInnerUp"].value == 0.0
    for block in blocks:
        block.mute = True
    with pytest.raises(HeadError, match="has no shape keys"):
        bake(head, keys=keys)


@pytest.mark.thorough
@pytest.mark.parametrize("keys", ["new", "named"])
def test_solo_active_shape_key_does_not_hide_the_bake(keys):
    head = add_head(bpy.context, units=True)
    head.show_only_shape_key = True
    report = bake(head, keys=keys)
    assert largest_error(head, report) <= report.worst_error + 1e-4


def test_a_built_in_head_without_keys_is_given_those_of_arkit_and_one_that_was_sculpted_is_not():
    head, sculpted = add_head(bpy.context), add_head(bpy.context)
    sculpted.data.vertices[100].co.x += 0.01
    given, new = (bake(obj, keys="automatic") for obj in (head, sculpted))
    assert not np.isnan(given.named_error) and np.isnan(new.named_error)
    assert "jawOpen" in head.data.shape_keys.key_blocks and "jawOpen" not in sculpted.data.shape_keys.key_blocks
    lashes = next(child for child in head.children if child.name.startswith("Lashes"))
    assert "jawOpen" in lashes.data.shape_keys.key_blocks
    assert largest_error(head, given) <= given.worst_error + 1e-4


def _jaw_and_brows(head, frames=(10, 30, 50)):
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append([head.data.shape_keys.key_blocks[name].value for name in ("jawOpen", "browInnerUp")])
    return np.array(found)


@pytest.mark.thorough
def test_strengths_of_a_head_scale_the_last_bake_at_once_and_the_next_by_their_keyframes():
    head = add_head(bpy.context, units=True)
    bake(head, keys="automatic", whole_frames=True)
    before = _jaw_and_brows(head)
    assert before[:, 0].max() > 0.1
    head.facemime.strength_jaw = 0.5
    np.testing.assert_allclose(_jaw_and_brows(head), before * (0.5, 1.0), atol=0.03)
    head.facemime.strength_jaw = 1.0
    np.testing.assert_allclose(_jaw_and_brows(head), before, atol=1e-6)
    # More from frame 30 on.
    for frame, strength in ((29, 1.0), (30, 1.5)):
        head.facemime.strength_jaw = strength
        head.keyframe_insert("facemime.strength_jaw", frame=frame)
    for _ in range(2):
        bake(head, keys="automatic", whole_frames=True)
        np.testing.assert_allclose(_jaw_and_brows(head), before * ((1.0, 1.0), (1.5, 1.0), (1.5, 1.0)), atol=0.03)


@pytest.mark.parametrize(("count", "told"), [(3, False), (12, True)])
def test_own_keys_of_unknown_names_are_mentioned_when_new_ones_are_added(count, told):
    head = add_head(bpy.context)
    head.shape_key_add(name="Basis")
    for number in range(count):
        head.shape_key_add(name=f"Ausdruck {number}").points[number].co.z += 0.01
    report = bake(head, keys="automatic")
    assert any("bake to Existing Shape Keys" in note for note in report.notes) == told
    assert not bake(head, keys="new").notes

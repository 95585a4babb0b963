"""Controls of a character's own rig: learnt, solved, baked."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from facemime.blender.animation import live_controls
from facemime.blender.animation.bake_controls import solve_motion
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.characters import write_bones
from facemime.blender.controls.probing import Learning, learn_controls
from facemime.blender.controls.stored import read_controls, write_controls
from facemime.blender.controls.view import PosedFace
from facemime.blender.fcurves import curves_in
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import key_names, mesh_of
from facemime.blender.names import CONTROLS_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.heads.part_names import FaceBones
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.rigs.rig_map import LOCATION, ROTATION, SCALE
from facemime.core.takes.file import save_take
from facemime.sessions.start import start_session
from tests.helpers.face_rigs import bake, make_face_rig, show, state
from tests.helpers.live_ticks import wait_for
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def path_of_turn(armature):
    """Property with the rotation of the bone of the head, which turns with the performer."""
    mode = armature.pose.bones["Skull"].rotation_mode
    return {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}.get(mode, "rotation_euler")


def own_paths(armature):
    return {curve.data_path for curve in curves_in(armature.animation_data)}


def test_learning_finds_the_controls_of_the_face_and_no_others(rigged):
    found = learn_controls(rigged[0])
    expected = {"Hinge", "Slider", "lift", *(f"c{number}" for number in range(len(rigged[1].pose.bones) - 4))}
    assert set(found.controls) == expected
    assert not {"Skull", "Side", "Hidden"} & set(found.controls)
    assert {channel.bone for channel in found.channels if channel.kind == ROTATION} == {"Hinge"}
    assert (1, "c1") not in {(channel.index, channel.bone) for channel in found.channels if channel.kind == LOCATION}


def test_learning_leaves_every_channel_bit_for_bit_as_it_was(rigged):
    before = state(rigged[1])
    learn_controls(rigged[0])
    assert state(rigged[1]) == before


def test_learning_that_is_stopped_restores_the_rig(rigged):
    before, learning = state(rigged[1]), Learning(rigged[0])
    steps = learning.steps()
    for _ in range(20):
        next(steps)
    assert state(rigged[1]) != before
    learning.close()
    assert state(rigged[1]) == before


@pytest.mark.parametrize("seed", first_of([1, 2]))
def test_a_scaled_armature_with_other_rolls_and_modes_is_learnt_alike(seed):
    plain = learn_controls(make_face_rig(seed)[0])
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scaled = learn_controls(make_face_rig(seed, scale=100.0)[0])
    assert set(plain.controls) == set(scaled.controls)
    shown = [np.linalg.norm(found.effects[:, :66], axis=(1, 2)).sum() for found in (plain, scaled)]
    np.testing.assert_allclose(*shown, rtol=0.15)


@pytest.mark.parametrize(("scaled", "error"), [(False, 0.15), (True, 0.2)])
def test_random_poses_of_the_rig_are_found_again(rigged, scaled, error):
    head, found = rigged[0], learn_controls(rigged[0])
    random = np.random.default_rng(3)
    posed = [scaled or found.channels[number].kind != SCALE for number in found.channel]
    share = np.zeros((12, len(posed)))
    size = len(share), sum(posed)
    share[:, posed] = random.uniform(0.0, 0.4, size) * (random.random(size) < 0.2)
    wanted = np.einsum("nk,ksc->nsc", np.minimum(share, found.upper), found.effects)
    solved = solve_motion(head, found, wanted)
    off = np.linalg.norm(wanted, axis=2).max()
    assert solved.errors.mean() < error * off


def test_controls_are_stored_with_the_head(rigged, tmp_path):
    head = rigged[0]
    assert bpy.ops.facemime.learn_controls() == {"FINISHED"}
    name, count = head.name, len(head.facemime_rig.controls)
    assert count > 10 and 0.3 < head.facemime_rig.shown <= 1.0
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rig.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "rig.blend"))
    assert len(read_controls(bpy.data.objects[name]).controls) == count


def test_a_changed_rig_has_to_be_learnt_again(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    read_controls(head)
    armature.pose.bones["c3"].lock_location[0] = True
    with pytest.raises(HeadError, match="Learn the controls again"):
        read_controls(head)


def test_posing_the_rig_does_not_make_the_controls_stale(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    armature.pose.bones["Skull"].location = (0.0, 0.1, 0.0)
    armature.pose.bones["c3"].location = (0.01, 0.0, 0.0)
    bpy.context.view_layer.update()
    read_controls(head)


def test_controls_that_are_switched_off_are_not_used_and_stay_off(rigged):
    head = rigged[0]
    write_controls(head, learn_controls(head))
    head.facemime_rig.controls["Hinge"].use = False
    assert "Hinge" not in read_controls(head).controls
    write_controls(head, learn_controls(head))
    assert not head.facemime_rig.controls["Hinge"].use


def test_a_head_without_a_rig_says_that_no_control_moves_it():
    head = add_head(bpy.context)
    with pytest.raises(HeadError, match="No control"):
        learn_controls(head)
    with pytest.raises(HeadError, match="Learn Controls"):
        bake(head)


def test_a_rig_that_does_not_move_its_mesh_says_why(rigged):
    head, armature = rigged
    armature.data.pose_position = "REST"
    bpy.context.view_layer.update()
    with pytest.raises(HeadError, match=r"Rig is in Rest Position.* Set it to Pose Position"):
        learn_controls(head)
    armature.data.pose_position = "POSE"
    head.modifiers["Rig"].show_viewport = False
    with pytest.raises(HeadError, match=r"modifier Rig of .* is disabled in viewports"):
        learn_controls(head)
    other = head.modifiers.new("Other", "ARMATURE")
    other.object, head.modifiers["Rig"].show_viewport = armature, True
    other.show_viewport = False
    assert "c3" in learn_controls(head).controls


def test_bakes_and_previews_say_that_rest_position_hides_the_controls(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    write_bones(head, None, FaceBones())
    armature.data.pose_position = "REST"
    assert any("Rig is in Rest Position" in note for note in bake(head).notes)
    session = show(head)
    assert any("Rig is in Rest Position" in warning for warning in session.warnings)
    session.close()


def test_a_bake_animates_the_controls_alone(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    before, keys = state(armature), key_names(head)
    report = bake(head)
    assert key_names(head) == keys
    assert state(armature)["Side"] == before["Side"]
    paths = own_paths(armature)
    assert paths and not any("Side" in path or "Hidden" in path for path in paths)
    assert [path for path in paths if "Skull" in path] == ['pose.bones["Skull"].' + path_of_turn(armature)]
    drivers = mesh_of(head).shape_keys.animation_data.drivers
    assert not any(curve.mute for curve in drivers)
    assert report.keyframes < 0.6 * report.frames
    assert report.summary().startswith(f"{len(read_controls(head).controls)} controls, largest error")


def test_a_bake_plays_back_what_was_solved(rigged):
    head, armature = rigged
    armature.pose.bones["c2"].location = (0.0, 0.0, 0.0)
    found = learn_controls(head)
    write_controls(head, found)
    bpy.context.view_layer.update()
    view = PosedFace(head, read_rig(head))
    rest = view.look().face
    report = bake(head, clean=0.0)
    wanted, worst, off, size = report.motion.vertices[:, found.sample], 0.0, [], []
    for row in range(0, len(wanted), 4):
        bpy.context.scene.frame_set(1 + round(report.motion.times[row] * 25.0))
        away = np.linalg.norm(view.look().face - rest - wanted[row], axis=1)
        worst = max(worst, away.max())
        off.append(away[:66].mean())
        size.append(np.linalg.norm(wanted[row, :66], axis=1).mean())
    view.close()
    assert worst <= (report.worst_error + 1e-4) * found.unit
    assert np.mean(off) < 0.6 * np.mean(size)


def test_baked_controls_stay_within_their_limits(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    bake(head)
    slider = bpy.data.objects["Slider"]
    low = slider.constraints[0].min_z
    for frame in range(1, 61):
        bpy.context.scene.frame_set(frame)
        assert low - 1e-5 <= slider.location.z <= low + 0.2 + 1e-5
        assert -1e-6 <= armature["lift"] <= 1.0 + 1e-6
        assert np.abs(armature.pose.bones["c0"].location).max() <= 0.01 + 1e-6


def test_a_second_bake_replaces_the_first_and_one_to_keys_removes_it(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    bake(head)
    count = len(curves_in(armature.animation_data))
    bake(head)
    assert count > 20 and len(curves_in(armature.animation_data)) == count
    settings = PuppetSettings(bake=BakeSettings(keys="new"), neutral=0.0)
    puppet_head(bpy.context.scene, head, performance(), settings)
    assert all("Skull" in path for path in own_paths(armature))
    assert armature.pose.bones["c3"].location[:] == (0.0, 0.0, 0.0) and armature["lift"] == 0.0


def test_curves_are_grouped_by_region(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    bake(head)
    groups = {curve.group.name for curve in curves_in(armature.animation_data) if curve.group is not None}
    assert {"Mouth", "Eyes", "Brows"} <= groups


def test_a_preview_moves_the_controls_and_puts_them_back(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    before, keys = state(armature), len(mesh_of(head).shape_keys.key_blocks)
    shown = show(head)
    bpy.context.scene.frame_set(40)
    during = state(armature)
    assert sum(during[name] != before[name] for name in before) > 10
    assert during["Side"] == before["Side"] and len(mesh_of(head).shape_keys.key_blocks) == keys
    shown.close()
    after = state(armature)
    assert {name for name in after if after[name] != before[name]} <= {"Skull"}
    assert CONTROLS_PROPERTY not in armature


def off_in_preview(head, found):
    """Error of the landmarks in a preview, relative to their motion."""
    rig = read_rig(head)
    rest = points_of(head, rig)
    shown = show(head)
    off, size = [], []
    bpy.context.scene.frame_set(1)
    for frame in range(10, 60, 6):
        bpy.context.scene.frame_set(frame)
        wanted = shown.frames[0].vertices[found.sample[:66]] - rig.vertices[found.sample[:66]]
        off.append(np.linalg.norm(points_of(head, rig) - rest - wanted, axis=1).mean())
        size.append(np.linalg.norm(wanted, axis=1).mean())
    shown.close()
    return np.mean(off) / np.mean(size)


def points_of(head, rig):
    """The landmarks as the rig shows them, without modifiers that make other vertices."""
    view = PosedFace(head, rig)
    try:
        return view.look().face[:66]
    finally:
        view.close()


def test_a_preview_shows_the_performance_by_the_controls(rigged):
    head, armature = rigged
    armature.pose.bones["c2"].location = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    found = learn_controls(head)
    write_controls(head, found)
    assert off_in_preview(head, found) < 0.7


@pytest.mark.parametrize("factor", [0.4, 2.5])
@pytest.mark.parametrize("modifier", first_of([None, "SUBSURF", "SOLIDIFY"]))
def test_a_preview_corrects_a_rig_that_is_fast(rigged, monkeypatch, factor, modifier):
    head, wrong = _wrongly_learnt(rigged, factor, modifier)
    off = []
    for seconds in (0.0, 60.0):
        monkeypatch.setattr(live_controls, "_PATIENCE", seconds)
        off.append(off_in_preview(head, wrong))
    assert off[1] < 0.95 * off[0]


@pytest.mark.parametrize("modifier", ["DECIMATE", pytest.param("REMESH", marks=pytest.mark.thorough)])
def test_a_preview_is_not_corrected_by_a_mesh_whose_vertices_are_others(rigged, monkeypatch, modifier):
    head, wrong = _wrongly_learnt(rigged, 2.5, modifier)
    if modifier == "DECIMATE":
        head.modifiers[-1].ratio = 0.4
    off = []
    for seconds in (0.0, 60.0):
        monkeypatch.setattr(live_controls, "_PATIENCE", seconds)
        off.append(off_in_preview(head, wrong))
    assert off[0] == pytest.approx(off[1], abs=0.005)


def _wrongly_learnt(rigged, factor, modifier):
    """A head whose controls are stored as moving it `factor` times as far as they do; and what is stored."""
    head, armature = rigged
    armature.pose.bones["c2"].location = (0.0, 0.0, 0.0)
    if modifier is not None:
        head.modifiers.new("Other", modifier)
    bpy.context.view_layer.update()
    found = learn_controls(head)
    wrong = replace(found, effects=factor * found.effects)
    write_controls(head, wrong)
    return head, wrong


def test_what_drives_a_preview_can_be_changed_while_it_runs(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    before, shown = state(armature), show(head, "SKIN")
    bpy.context.scene.frame_set(40)
    bpy.context.scene.facemime.drive_by = "CONTROLS"
    assert shown.follow(bpy.context.scene)
    assert state(armature)["c5"] != before["c5"]
    bpy.context.scene.facemime.drive_by = "SKIN"
    shown.follow(bpy.context.scene)
    assert state(armature)["c5"] == before["c5"]
    shown.close()


def test_a_preview_of_controls_that_are_not_known_is_refused(rigged):
    with pytest.raises(HeadError, match="Learn Controls"):
        show(rigged[0])


def test_a_file_saved_during_a_preview_opens_with_the_users_values(rigged, tmp_path):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    before, path = state(armature), str(tmp_path / "during.blend")
    shown = show(head)
    bpy.context.scene.frame_set(40)
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    shown.close()
    bpy.ops.wm.open_mainfile(filepath=path)
    after = state(bpy.data.objects["Rig"])
    assert {name for name in after if after[name] != before[name]} <= {"Skull"}


def test_an_animated_rig_plays_on_after_a_preview(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    bone = armature.pose.bones["c4"]
    for frame, height in ((1, 0.0), (60, 0.01)):
        bone.location[2] = height
        bone.keyframe_insert("location", index=2, frame=frame)
    shown = show(head)
    bpy.context.scene.frame_set(40)
    shown.close()
    bpy.context.scene.frame_set(60)
    assert bone.location[2] == pytest.approx(0.01)
    assert not any(curve.mute for curve in curves_in(armature.animation_data))


def test_a_live_puppet_moves_the_controls(rigged, tmp_path):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    save_take(performance(), tmp_path / "take.facetake")
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take, settings.drive_by = "TAKE", str(tmp_path / "take.facetake"), "CONTROLS"
    settings.source.loop = True
    before, session = state(armature), start_session(bpy.context.scene, [head])
    wait_for(lambda: session.step() and state(armature)["c12"] != before["c12"])
    session.close()
    assert state(armature)["c12"] == before["c12"]


def test_an_undo_during_a_preview_leaves_the_rig_at_rest(rigged):
    head, armature = rigged
    write_controls(head, learn_controls(head))
    before, shown = state(armature), show(head)
    bpy.context.scene.frame_set(40)
    again = [head.found_again() for head in shown.heads]
    assert again[0].controls is shown.heads[0].controls
    shown.close()
    assert state(armature)["c5"] == before["c5"]

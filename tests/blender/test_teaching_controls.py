"""Teaching a head by the bones and sliders of its rig."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import write_controls
from facemime.blender.controls.view import seen_vertices
from facemime.blender.rigs import read_rig
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.heads.style import load_style
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from facemime.sessions.show import TakeShow, follow_settings
from facemime.sessions.start import start_session
from tests.blender.test_cli import run
from tests.helpers.face_rigs import make_face_rig, state
from tests.helpers.live_ticks import wait_for
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")
EXPRESSION = 42
"""A frame with an open mouth and raised brows."""


@pytest.fixture
def rigged(in_a_project):
    """A head on a made rig whose controls are known, which shows a performance by them."""
    scene = bpy.context.scene
    scene.render.fps, scene.facemime.find_neutral, scene.facemime.neutral = 25, False, 0.0
    head, armature = make_face_rig()
    bpy.context.view_layer.objects.active = head
    armature.pose.bones["c2"].location = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    write_controls(head, learn_controls(head))
    return head, armature


def show(head, by="CONTROLS", frame=EXPRESSION):
    """Preview the performance on the head."""
    bpy.context.scene.facemime.drive_by = by
    session = TakeShow(bpy.context.scene, [head], performance())
    bpy.context.scene.frame_set(frame)
    return session


def pose(armature):
    """Pose a bone, a slider and a property as an artist wants them."""
    armature.pose.bones["c12"].location[2] += 0.006
    bpy.data.objects["Slider"].location.z += 0.08
    armature["lift"] = 0.45
    armature.update_tag()
    bpy.context.view_layer.update()
    return armature.pose.bones["c12"].location[2], bpy.data.objects["Slider"].location.z, armature["lift"]


def values(armature):
    return armature.pose.bones["c12"].location[2], bpy.data.objects["Slider"].location.z, armature["lift"]


def test_posed_controls_are_taught_and_fade_with_the_expression(rigged):
    head, armature = rigged
    before, session = state(armature), show(head)
    wanted = pose(armature)
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    (example,) = read_rig(head).style.examples
    assert set(example.controls) == {"c12 location z", "Slider location z", "lift property lift"}
    assert not example.keys and not len(example.offsets) and example.thumbnail
    np.testing.assert_allclose(values(armature), wanted, atol=2e-3)
    bpy.context.scene.frame_set(5)
    assert abs(armature["lift"]) < 0.05
    bpy.context.scene.frame_set(EXPRESSION)
    np.testing.assert_allclose(values(armature), wanted, atol=5e-3)
    head.facemime_style.examples[0].mute = True
    follow_settings()
    assert abs(values(armature)[1] - wanted[1]) > 0.03
    session.close()
    after = state(armature)
    assert {name for name in after if after[name] != before[name]} <= {"Skull"}


def test_a_frame_taught_again_by_controls_keeps_what_was_not_changed(rigged):
    head, armature = rigged
    session = show(head)
    pose(armature)
    bpy.ops.facemime.teach_frame()
    first = dict(read_rig(head).style.examples[0].controls)
    armature["lift"] = 0.2
    armature.update_tag()
    bpy.ops.facemime.teach_frame()
    (example,) = read_rig(head).style.examples
    assert example.controls["Slider location z"] == pytest.approx(first["Slider location z"], abs=2e-3)
    assert armature["lift"] == pytest.approx(0.2, abs=5e-3)
    session.close()


def test_a_bake_to_controls_contains_what_was_taught(rigged):
    head, armature = rigged
    session = show(head)
    wanted = pose(armature)
    bpy.ops.facemime.teach_frame()
    session.close()

    def baked():
        settings = PuppetSettings(bake=BakeSettings(keys="controls"), neutral=0.0, smoothing=0.0)
        puppet_head(bpy.context.scene, head, performance(), settings)
        bpy.context.scene.frame_set(EXPRESSION)
        return np.array(values(armature))

    corrected = baked()
    (example,) = read_rig(head).style.examples
    head.facemime_style.examples[0].mute = True
    moved = corrected - baked()
    assert moved[1:] == pytest.approx(
        [example.controls["Slider location z"], example.controls["lift property lift"]], abs=0.02
    )
    assert corrected[2] == pytest.approx(wanted[2], abs=0.06)  # a bake is corrected twice, and the live rig once


def test_a_running_puppet_sets_the_controls_as_they_were_taught(rigged, tmp_path):
    head, armature = rigged
    bpy.context.scene.facemime.find_neutral = True  # as live, or expressions would be measured from another face
    session = show(head)
    pose(armature)
    bpy.ops.facemime.teach_frame()
    session.close()
    save_take(performance(), tmp_path / "take.facetake")
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take = "TAKE", str(tmp_path / "take.facetake")
    settings.source.loop = True
    session = start_session(bpy.context.scene, [head])
    wait_for(lambda: session.step() and armature["lift"] > 0.3)
    session.close()
    assert armature["lift"] == 0.0


def test_controls_that_do_not_show_the_take_are_named(rigged):
    head, armature = rigged
    head.facemime_rig.controls["Hinge"].use = False
    session = show(head)
    with pytest.raises(RuntimeError, match="looks as the take shows it"):
        bpy.ops.facemime.teach_frame()
    armature.pose.bones["Hinge"].location.x += 0.01
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match=r"Hinge.*Enable them in Head > Controls"):
        bpy.ops.facemime.teach_frame()
    session.close()


def test_a_control_that_was_posed_but_not_taught_follows_the_take_again(rigged):
    head, armature = rigged
    session = show(head)
    as_shown = values(armature)
    pose(armature)
    bpy.context.scene.frame_set(EXPRESSION + 1)
    bpy.context.scene.frame_set(EXPRESSION)
    np.testing.assert_allclose(values(armature), as_shown, atol=5e-3)
    session.close()


def test_a_bone_posed_over_a_take_on_the_skin_is_taught_as_its_motion_of_the_skin(rigged):
    head, armature = rigged
    session = show(head, "SKIN")
    before = seen_vertices(head)
    head.name = "Renamed"
    armature.pose.bones["c12"].location[2] += 0.006
    bpy.context.view_layer.update()
    wanted = seen_vertices(head)
    assert np.abs(wanted - before).max() > 0.003
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    assert armature.pose.bones["c12"].location[2] == 0.0
    assert np.abs(seen_vertices(head) - wanted).max() < 5e-4
    (example,) = read_rig(head).style.examples
    assert len(example.offsets) == len(wanted) and not example.controls
    session.close()


def test_a_pose_that_modifiers_distort_is_refused_and_stays(rigged):
    head, armature = rigged
    head.modifiers.new("Bend", "SIMPLE_DEFORM").angle = 1.0
    session = show(head, "SKIN")
    bone = armature.pose.bones["c12"]
    bone.location[2] = 0.006
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match=r"Modifiers of .* change the shape.*c12"):
        bpy.ops.facemime.teach_frame()
    assert bone.location[2] == pytest.approx(0.006) and not len(head.facemime_style.examples)
    session.close()


def test_taught_controls_are_undone_saved_and_shared(rigged, tmp_path):
    head, armature = rigged
    name, path = head.name, tmp_path / "artist.facestyle"
    session = show(head)
    bpy.ops.ed.undo_push(message="Before")
    wanted = pose(armature)
    bpy.ops.facemime.teach_frame()
    bpy.ops.ed.undo_push(message="Teach This Frame")
    bpy.ops.facemime.save_style(filepath=str(path))
    bpy.ops.ed.undo()
    assert not len(bpy.data.objects[name].facemime_style.examples)
    bpy.ops.ed.redo()
    assert len(bpy.data.objects[name].facemime_style.examples) == 1
    TakeShow.running().close()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "taught.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "taught.blend"))
    head, armature = bpy.data.objects[name], bpy.data.objects["Rig"]
    bpy.context.view_layer.objects.active = head
    assert dict(load_style(path).examples[0].controls) == dict(read_rig(head).style.examples[0].controls)
    bpy.ops.facemime.remove_example()
    assert bpy.ops.facemime.load_style(filepath=str(path)) == {"FINISHED"}
    session = show(head)
    np.testing.assert_allclose(values(armature), wanted, atol=5e-3)
    session.close()


@pytest.mark.thorough
def test_the_command_bakes_controls_with_a_style(rigged, tmp_path):
    head, armature = rigged
    style, blend, out = tmp_path / "artist.facestyle", tmp_path / "rig.blend", tmp_path / "out.blend"
    session = show(head)
    wanted = pose(armature)
    bpy.ops.facemime.teach_frame()
    session.close()
    save_take(performance(), tmp_path / "take.facetake")
    bpy.ops.facemime.save_style(filepath=str(style))
    bpy.ops.facemime.remove_example()
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True)
    line = ("puppet", tmp_path / "take.facetake", "-o", out, "--neutral", "0", "--keys", "controls", "--head")
    done = run(*line, f"{blend}:{head.name}", "--style", style)
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(out))
    bpy.context.scene.frame_set(EXPRESSION)
    assert bpy.data.objects["Rig"]["lift"] == pytest.approx(wanted[2], abs=0.06)

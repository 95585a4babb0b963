"""Which controls of a rig are used, live and in bakes, what each does, as arrows and on a sheet."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.controls.checks import loose_parts, measure_speed
from facemime.blender.controls.display import drawn_arrows
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.stored import error_curve, read_controls, write_controls
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import CONTROLS_PROPERTY
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from facemime.sessions.start import follow_settings, start_session
from tests.helpers.face_rigs import show, state
from tests.helpers.live_ticks import wait_for
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def rigged(rigged):
    """A head on a made rig, whose controls are known, and which is active."""
    write_controls(rigged[0], learn_controls(rigged[0]))
    return rigged


def test_a_control_that_is_switched_off_stops_at_once_in_a_preview(rigged):
    head, armature = rigged
    before, shown = state(armature), show(head)
    bpy.context.scene.frame_set(40)
    moved = next(name for name in ("c5", "c8", "c12") if state(armature)[name] != before[name])
    assert not shown.follow(bpy.context.scene)
    head.facemime_rig.controls[moved].use = False
    assert shown.follow(bpy.context.scene)
    assert state(armature)[moved] == before[moved] and state(armature) != before
    for item in head.facemime_rig.controls:
        item.use = False
    shown.follow(bpy.context.scene)
    assert {name for name, value in state(armature).items() if value != before[name]} <= {"Skull"}
    head.facemime_rig.controls[moved].use = True
    shown.follow(bpy.context.scene)
    assert state(armature)[moved] != before[moved]
    shown.close()
    assert state(armature)[moved] == before[moved]


def test_a_control_that_is_switched_off_stops_at_once_while_live(rigged, tmp_path):
    head, armature = rigged
    save_take(performance(), tmp_path / "take.facetake")
    scene = bpy.context.scene
    scene.facemime.source.kind, scene.facemime.drive_by = "TAKE", "CONTROLS"
    scene.facemime.source.take, scene.facemime.source.loop = str(tmp_path / "take.facetake"), True
    before, session = state(armature), start_session(scene, [head])
    wait_for(lambda: session.step() and state(armature)["c12"] != before["c12"])
    head.facemime_rig.controls["c12"].use = False
    follow_settings(session, scene)
    assert state(armature)["c12"] == before["c12"]
    wait_for(lambda: session.step() and state(armature)["c5"] != before["c5"])
    assert state(armature)["c12"] == before["c12"]
    session.close()
    assert state(armature)["c5"] == before["c5"]


def test_a_rig_that_is_renamed_during_a_preview_returns_to_rest(rigged):
    head, armature = rigged
    before, shown = state(armature), show(head)
    bpy.context.scene.frame_set(40)
    assert state(armature) != before
    armature.name = "Renamed"
    shown.close()
    assert state(armature) == before and CONTROLS_PROPERTY not in armature


def test_few_controls_are_those_that_help_most(rigged):
    head = rigged[0]
    assert bpy.ops.facemime.rank_controls() == {"FINISHED"}
    group = head.facemime_rig
    assert all(item.use and item.order for item in group.controls) and group.few == len(group.controls)
    errors = error_curve(head)
    assert min(errors) <= 2 and max(errors) == len(group.controls) and errors[max(errors)] < 0.7 * errors[min(errors)]
    group.few = 4
    used = {item.name for item in group.controls if item.use}
    assert 4 <= len(used) <= 5 and "Hinge" in used and set(read_controls(head).controls) == used
    write_controls(head, learn_controls(head))
    assert not error_curve(head)


def test_arrows_start_at_the_skin_and_follow_the_selected_control(rigged):
    head = rigged[0]
    group, graph = head.facemime_rig, bpy.context.evaluated_depsgraph_get()
    view = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    assert drawn_arrows(head, graph, view, (800, 800), every=False) is None
    every = drawn_arrows(head, graph, view, (800, 800), every=True)
    assert 10 < len(every.axes) <= len(group.controls)
    group.active = [item.name for item in group.controls].index("Hinge")
    jaw = drawn_arrows(head, graph, view, (800, 800), every=False)
    assert len(jaw.axes) > 5 and jaw.ends[:, 0, 1].mean() < every.ends[:, 0, 1].mean()


def test_the_control_sheet_is_written_and_leaves_the_rig_as_it_was(rigged, tmp_path):
    head, armature = rigged
    head.facemime_rig.controls["c4"].use = False
    before = state(armature)
    assert bpy.ops.facemime.export_control_sheet(filepath=str(tmp_path / "sheet")) == {"FINISHED"}
    page = (tmp_path / "sheet.html").read_text(encoding="utf-8")
    assert state(armature) == before
    assert "Hinge" in page and "Slider" in page and ">c5<" in page and ">c4<" not in page
    assert page.count("data:image/jpeg") >= len(read_controls(head).channels)


def test_a_rig_that_is_too_slow_to_be_live_is_said_to_be_baked(rigged):
    head, armature = rigged
    before = state(armature)
    measure_speed(head, read_controls(head))
    assert 0.0 < head.facemime_rig.seconds < 1.0 and state(armature) == before
    head.facemime_rig.seconds = 0.002
    shown = show(head)
    assert not [text for text in shown.warnings if "too slow" in text]
    shown.close()
    head.facemime_rig.seconds = 0.18
    shown = show(head)
    assert [text for text in shown.warnings if "takes 180 ms per frame" in text and "Bake to it" in text]
    bpy.context.scene.facemime.drive_by = "SKIN"
    shown.follow(bpy.context.scene)
    assert not [text for text in shown.overruled() if "too slow" in text]
    shown.close()


def test_parts_that_the_rig_leaves_behind_are_named(rigged):
    head, armature = rigged
    assert "Eye.L, Eye.R" in loose_parts(head) and "stay behind" in loose_parts(head)
    report = puppet_head(
        bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys="controls"), neutral=0.0)
    )
    assert loose_parts(head) in report.warnings
    for name in ("Eye.L", "Eye.R"):
        eye = bpy.data.objects[name]
        eye.parent, eye.parent_type, eye.parent_bone = armature, "BONE", "Skull"
    assert loose_parts(head) == ""
    assert loose_parts(add_head(bpy.context)) == ""

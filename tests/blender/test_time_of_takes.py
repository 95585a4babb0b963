"""Where a take starts in a scene, and whose the frame range is."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import is_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from facemime.sessions.show import TakeShow
from facemime.settings import takes_store
from tests.helpers.commands import run
from tests.helpers.curves import curves_of
from tests.helpers.owners import UNDER_WINE
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def bake(head, **settings):
    return puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(**settings)))


def range_of(scene):
    return scene.frame_start, scene.frame_end


def keyed(head):
    """First and last frame of the bake."""
    points = [point.co.x for curve in curves_of(head.data.shape_keys) for point in curve.keyframe_points]
    return min(points), max(points)


@pytest.mark.parametrize(("start", "frame"), [("first", 1), ("current", 1040), ("scene", 1001)])
def test_a_take_starts_where_it_was_asked_to(start, frame):
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 25, 1001, 1100
    scene.frame_set(1040)
    report = bake(head, start=start)
    assert report.start == frame and keyed(head)[0] == pytest.approx(frame)
    assert range_of(scene) == (1001, 1100) and scene.frame_current == 1040
    assert any("1001 to 1100" in warning for warning in report.warnings) == (start == "first")


def test_the_range_of_an_untouched_scene_becomes_that_of_each_take():
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps = 25
    bake(head)
    first = range_of(scene)
    puppet_head(scene, head, performance(30))
    assert first == (1, 60) and range_of(scene) == (1, 30)
    bake(head, start="scene")
    assert range_of(scene) == (1, 60)


def _camera_move(scene):
    camera = bpy.data.objects.new("Camera", None)
    scene.collection.objects.link(camera)
    camera.keyframe_insert("location", frame=1)


def _strip(scene):
    cube = bpy.data.objects.new("Cube", None)
    scene.collection.objects.link(cube)
    track = cube.animation_data_create().nla_tracks.new()
    action = bpy.data.actions.new("Move")
    track.strips.new("Move", 1, action)


def _other_key(scene):
    mesh = bpy.data.meshes.new("Other")
    mesh.from_pydata([(0, 0, 0)], [], [])
    obj = bpy.data.objects.new("Other", mesh)
    scene.collection.objects.link(obj)
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Key").keyframe_insert("value", frame=3)


def _marker(scene):
    scene.timeline_markers.new("Shot", frame=20)


def _material(scene):
    material = bpy.data.materials.new("Blinking")
    if hasattr(material, "use_nodes"):
        material.use_nodes = True
    material.node_tree.nodes[0].keyframe_insert("location", frame=1)
    scene.objects[0].data.materials.append(material)


def _edit(scene):
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strips.new_effect("Shot", "COLOR", 1, frame_start=1, **_LENGTH)


_LENGTH = {"length": 40} if bpy.app.version >= (5, 0, 0) else {"frame_end": 40}


@pytest.mark.parametrize("use", first_of([_camera_move, _strip, _other_key, _marker, _material, _edit], 2))
def test_the_range_of_a_scene_in_use_is_kept_unless_its_change_is_asked_for(use):
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps = 25
    use(scene)
    bake(head)
    assert range_of(scene) == (1, 250)
    show = TakeShow(scene, [head], performance())
    assert range_of(scene) == (1, 250)
    show.close()
    bake(head, fit_range=True)
    assert range_of(scene) == (1, 60)


def test_preview_bake_and_playhead_share_the_frame_at_which_a_take_was_put(tmp_path, takes):
    scene, path = bpy.context.scene, tmp_path / "a.facetake"
    scene.render.fps = 25
    save_take(performance(), path)
    bpy.ops.facemime.import_take(filepath=str(path))
    head = add_head(bpy.context)
    bpy.context.view_layer.objects.active = head
    takes.bake.start, takes.bake.keys = "current", "new"
    scene.frame_set(40)
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    assert keyed(head)[0] == pytest.approx(40.0)
    scene.frame_set(60)
    assert bpy.ops.facemime.trim_take(keep="FROM") == {"FINISHED"}
    assert takes.items[takes.index].length == pytest.approx(60 / 25 - 20 / 25, abs=0.05)


@pytest.fixture
def late(tmp_path, takes):
    """A take in the list whose first frame is at 0.52 s, in frame 14, as those of tables may be."""
    bpy.context.scene.render.fps = 25
    take = performance()
    save_take(replace(take, times=take.times + 0.52), tmp_path / "late.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "late.facetake"))
    return takes_store.read(takes.items[0])


@pytest.mark.parametrize(("keep", "kept"), [("TIMELINE", slice(6, 17)), ("FROM", slice(11, None)), ("TO", slice(12))])
def test_the_timeline_trims_a_take_that_begins_late_where_it_is_seen(late, takes, keep, kept):
    scene = bpy.context.scene
    scene.use_preview_range = True
    scene.frame_preview_start, scene.frame_preview_end = 20, 30
    scene.frame_set(25)
    assert bpy.ops.facemime.trim_take(keep=keep) == {"FINISHED"}
    np.testing.assert_array_equal(takes_store.read(takes.items[1]).shape, late.shape[kept])


def test_seconds_of_trimming_are_the_take_s_own_as_the_refusal_says(late, takes):
    first, last = (float(np.float32(late.times[place])) for place in (0, -1))
    assert bpy.ops.facemime.trim_take(start=first, end=last) == {"FINISHED"}
    assert len(takes_store.read(takes.items[1])) == len(late)
    takes.index = 0
    with pytest.raises(RuntimeError, match=r"between 0.1 s and 0.4 s. Use times from 0.52 s to 2.88 s"):
        bpy.ops.facemime.trim_take(start=0.1, end=0.4)


def test_a_take_is_inserted_into_one_that_begins_late_at_its_own_time(late, takes, tmp_path):
    other = performance(20)
    save_take(other, tmp_path / "other.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "other.facetake"))
    takes.index = 0
    assert bpy.ops.facemime.punch_in_take(other="other", start=0.96, blend=0.1) == {"FINISHED"}
    edited = takes_store.read(takes.items[1])
    np.testing.assert_allclose(edited.times, late.times, atol=1e-9)
    np.testing.assert_array_equal(edited.shape[:11], late.shape[:11])
    np.testing.assert_allclose(edited.shape[19], other.shape[8], atol=2e-4)


def test_a_take_keeps_its_own_time_after_the_start():
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 25, 101, 300
    take = performance()
    settings = PuppetSettings(bake=BakeSettings(start="scene"))
    puppet_head(scene, head, replace(take, times=take.times + 2.0), settings)
    assert keyed(head)[0] == pytest.approx(151.0)


@pytest.mark.thorough
@pytest.mark.skipif(UNDER_WINE, reason="wine draws no pictures")
def test_a_character_of_another_scene_gets_the_rate_and_range_of_its_own(tmp_path):
    own, edit = bpy.context.scene, bpy.data.scenes.new("Edit")
    add_head(bpy.context).name = "Face"
    own.render.fps, edit.render.fps = 24, 60
    bpy.context.window.scene = edit
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    save_take(performance(), tmp_path / "a.facetake")
    outputs = ("-o", tmp_path / "out.blend", "--sheet", tmp_path / "out.png", "--gltf", tmp_path / "out.glb")
    done = run("puppet", tmp_path / "a.facetake", *outputs, "--head", tmp_path / "two.blend", "--start", "scene")
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    assert bpy.context.scene.name == "Edit" and range_of(bpy.context.scene) == (1, 250)
    first, last = keyed(bpy.data.objects["Face"])
    assert first == pytest.approx(1.0) and last == pytest.approx(1.0 + performance().times[-1] * 24, abs=1.1)
    assert range_of(bpy.data.scenes["Scene"]) == (1, int(np.ceil(last - 1e-3)))


@pytest.mark.thorough
def test_a_character_of_another_scene_is_found_and_bound_in_its_own(tmp_path):
    head = add_head(bpy.context)
    head.name = "Face"
    for owner in (head, head.data):
        for name in list(owner.keys()):
            del owner[name]
    bpy.context.window.scene = bpy.data.scenes.new("Edit")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "two.blend"))
    for number, name in enumerate(("", ":Face")):
        output = tmp_path / f"{number}.blend"
        done = run("bind", f"{tmp_path / 'two.blend'}{name}", "-o", output, "--picture", tmp_path / f"{number}.png")
        assert done.returncode == 0, done.stderr
        bpy.ops.wm.open_mainfile(filepath=str(output))
        assert bpy.context.scene.name == "Edit" and is_head(bpy.data.objects["Face"])


@pytest.mark.parametrize(("start", "first"), [("first", 1), ("current", 40), ("scene", 10)])
def test_time_stretching_does_not_change_where_a_take_starts_and_the_range_holds_all_of_it(start, first):
    head, scene = add_head(bpy.context), bpy.context.scene
    scene.render.fps, scene.render.frame_map_old, scene.render.frame_map_new = 25, 100, 200
    if start == "scene":
        scene.frame_start = first
    scene.frame_set(40)
    bake(head, start=start, fit_range=True)
    last = first + 2 * 25 * performance().times[-1]
    assert scene.frame_start == first and last <= scene.frame_end < last + 1
    keys = [point.co[0] for curve in curves_of(head) for point in curve.keyframe_points]
    assert min(keys) == pytest.approx(first / 2) and max(keys) == pytest.approx(last / 2)

"""The list of takes: showing, editing and baking the selected take."""

import wave
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.animation.bake_keys import BAKED_KEY_PREFIX
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.frames import to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rigs import read_rig
from facemime.core.drive.driver import HeadDriver
from facemime.core.takes.file import save_take
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.smooth import smooth_take
from facemime.sessions.session import Session
from facemime.sessions.show import TakeShow, follow_settings
from facemime.settings import takes_store
from tests.helpers.live_ticks import shown
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("in_a_project")


def test_a_shown_take_equals_the_live_motion_and_leaves_no_trace(imported):
    head, scene = add_head(bpy.context), bpy.context.scene
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    take, rig = smooth_take(takes_store.read(imported)), read_rig(head)
    driver = HeadDriver(rig, calibrate(take))
    for row in (10, 41, 55, 22):
        scene.frame_set(row + 1)
        mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        shown = np.array([vertex.co for vertex in mesh.vertices])
        np.testing.assert_allclose(shown, to_blender(driver.frame(take.result(row)).vertices)[: len(shown)], atol=1e-6)
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    assert head.data.shape_keys is None and Session.current is None
    scene.frame_set(41)
    assert tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)


def test_the_range_of_the_scene_becomes_that_of_the_shown_take_which_is_reported(imported, capfd):
    add_head(bpy.context)
    bpy.context.scene.frame_end = 250
    bpy.ops.facemime.show_take()
    frames = len(takes_store.read(imported))
    assert (bpy.context.scene.frame_start, bpy.context.scene.frame_end) == (1, frames) != (1, 250)
    assert f"frames 1 to {frames}" in capfd.readouterr().out
    bpy.ops.facemime.show_take()


def test_a_shown_take_follows_the_settings_and_the_keys_that_drive_the_head(imported):
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    bpy.ops.facemime.show_take()
    scene.frame_set(41)
    before = shown(head)
    scene.facemime.strength_lower = 0.2
    follow_settings()
    assert np.abs(shown(head) - before).max() > 1e-3
    scene.facemime.drive_by = "KEYS"
    follow_settings()
    assert LIVE_KEY not in head.data.shape_keys.key_blocks
    assert max(key.value for key in head.data.shape_keys.key_blocks[1:]) > 0.05
    bpy.ops.facemime.show_take()
    assert not any(key.value for key in head.data.shape_keys.key_blocks[1:])


def test_a_shown_take_follows_its_scene_when_that_is_renamed(imported):
    head = add_head(bpy.context)
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    scene = bpy.context.scene
    scene.name = "Renamed"
    scene.frame_set(5)
    first = shown(head)
    scene.frame_set(42)
    assert np.abs(shown(head) - first).max() > 1e-3
    scene.facemime.strength_lower = 0.0
    follow_settings()
    assert np.abs(shown(head) - first).max() < 1e-2
    assert bpy.ops.facemime.show_take() == {"FINISHED"}


def test_a_shown_take_is_not_saved_with_the_file_and_continues_afterwards(imported, tmp_path):
    head = add_head(bpy.context)
    bpy.ops.facemime.show_take()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    assert LIVE_KEY in head.data.shape_keys.key_blocks and isinstance(Session.current, TakeShow)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "copy.blend"))
    assert Session.current is None and bpy.data.objects["Facemime Head"].data.shape_keys is None
    assert takes_store.read(bpy.context.scene.facemime_takes.items[0]).times.shape == performance().times.shape


def test_deleting_the_head_stops_showing_the_take(imported):
    head = add_head(bpy.context)
    bpy.ops.facemime.show_take()
    bpy.data.objects.remove(head)
    bpy.context.scene.frame_set(30)
    assert Session.current is None


def test_fields_of_longer_times_are_in_seconds_as_blender_shows_90_s_as_minutes():
    for operator, fields in (("trim_take", ("start", "end")), ("punch_in_take", ("start",))):
        properties = getattr(bpy.types, f"FACEMIME_OT_{operator}").__annotations__
        for field in fields:
            assert "(s)" in properties[field].keywords["name"] and "subtype" not in properties[field].keywords


def test_trimming_and_mending_add_takes_below_the_original(imported, takes, tmp_path):
    save_take(performance(20), tmp_path / "Other.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "Other.facetake"))
    takes.index, before = 0, (tmp_path / "First.facetake").read_bytes()
    assert bpy.ops.facemime.trim_take(start=0.4, end=1.6) == {"FINISHED"}
    trimmed = takes_store.read(takes.items[1])
    assert takes.index == 1 and takes.items[1].length == pytest.approx(1.2)
    assert trimmed.times[0] == 0.0 and trimmed.times[-1] == pytest.approx(1.2)
    assert bpy.ops.facemime.mend_take(outliers=True, gaps="bridge", smoothing="zero-phase") == {"FINISHED"}
    mended = takes_store.read(takes.items[2])
    assert mended.found.all() and not trimmed.found.all() and mended.info["smoothed"] == "zero-phase"
    names = ["First", "First_Trimmed", "First_Trimmed_Mended", "Other"]
    assert [line.name for line in takes.items] == names and takes.index == 2
    assert (tmp_path / "First.facetake").read_bytes() == before
    assert len(takes_store.read(takes.items[0])) == len(performance())
    with pytest.raises(RuntimeError, match="There is no frame"):
        bpy.ops.facemime.trim_take(start=8.0, end=9.0)


@pytest.mark.parametrize(
    ("keep", "preview", "first", "last"),
    [("TIMELINE", True, 11, 31), ("TIMELINE", False, 6, 41), ("FROM", False, 21, 60), ("TO", False, 1, 21)],
)
def test_a_take_is_trimmed_by_the_timeline(imported, takes, keep, preview, first, last):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.use_preview_range = 6, 41, preview
    if preview:
        scene.frame_preview_end, scene.frame_preview_start = 31, 11
    scene.frame_set(21)
    whole = takes_store.read(imported)
    assert bpy.ops.facemime.trim_take(keep=keep) == {"FINISHED"}
    trimmed = takes_store.read(takes.items[1])
    np.testing.assert_array_equal(trimmed.shape, whole.shape[first - 1 : last])


def test_mirroring_a_take_twice_restores_it(imported, takes):
    before = takes_store.read(imported)
    only_mirror = {"outliers": False, "gaps": "leave", "smoothing": "none", "mirror": True}
    assert bpy.ops.facemime.mend_take(**only_mirror) == {"FINISHED"}
    once = takes_store.read(takes.items[1])
    np.testing.assert_allclose(once.pose[:, 2], -before.pose[:, 2])
    np.testing.assert_allclose(once.pose[:, 4], 639.0 - before.pose[:, 4])
    assert np.nanmax(np.abs(before.pose[:, 2])) > 0.0
    assert bpy.ops.facemime.mend_take(**only_mirror) == {"FINISHED"}
    twice = takes_store.read(takes.items[2])
    np.testing.assert_allclose(twice.pose, before.pose)
    np.testing.assert_allclose(twice.landmarks, before.landmarks, atol=1e-3)


def test_neutral_here_uses_the_face_at_the_current_frame(imported):
    before = calibrate(takes_store.read(imported)).shape
    bpy.context.scene.frame_set(36)
    assert bpy.ops.facemime.renew_neutral() == {"FINISHED"}
    take = takes_store.read(imported)
    assert np.abs(calibrate(take).shape - take.shape[35]).max() < np.abs(before - take.shape[35]).max() / 3.0
    bpy.context.scene.frame_set(900)
    with pytest.raises(RuntimeError, match="No face was found"):
        bpy.ops.facemime.renew_neutral()


def test_another_take_is_inserted_by_punch_in(imported, takes, tmp_path):
    assert not bpy.ops.facemime.punch_in_take.poll()
    other = performance(20)
    save_take(other, tmp_path / "Retake.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "Retake.facetake"))
    takes.index = 0
    assert bpy.ops.facemime.punch_in_take(other="Retake", start=1.4, blend=0.1) == {"FINISHED"}
    take = takes_store.read(takes.items[1])
    np.testing.assert_allclose(take.shape[40], other.shape[5], atol=2e-4)
    assert take.info["punched_in"] == [[pytest.approx(1.4), pytest.approx(1.4 + 19 / 25)]]
    with pytest.raises(RuntimeError, match="This take is not in the list"):
        bpy.ops.facemime.punch_in_take(other="Nobody")
    with pytest.raises(RuntimeError, match="cannot be inserted into itself"):
        bpy.ops.facemime.punch_in_take(other=takes.items[takes.index].name)


def test_of_takes_with_the_same_name_the_one_that_is_not_selected_is_inserted(imported, takes, tmp_path):
    (tmp_path / "retakes").mkdir()
    other = performance(20)
    save_take(replace(other, shape=other.shape + 0.5), tmp_path / "retakes" / "First.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "retakes" / "First.facetake"))
    for selected in (0, 2):  # the edited take was added below the first one
        takes.index = selected
        bpy.ops.facemime.punch_in_take(other="First", start=0.0, blend=0.1)
        edited = takes_store.read(takes.items[selected + 1]).shape[8]
        inserted = other.shape[8] + 0.5 if selected == 0 else performance().shape[8]
        np.testing.assert_allclose(edited, inserted, atol=1e-3)


@pytest.mark.skipif(not bpy.app.build_options.audaspace, reason="this bpy was built without sound")
def test_the_sound_is_in_sync_with_the_take(imported, tmp_path):
    with wave.open(str(tmp_path / "sound.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(2 * 8000 * 2))
    take = performance()
    take.info["offset"] = 0.4
    save_take(take, tmp_path / "late.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "late.facetake"))
    assert bpy.ops.facemime.add_sound(filepath=str(tmp_path / "sound.wav")) == {"FINISHED"}
    editor = bpy.context.scene.sequence_editor
    strip = (editor.strips if hasattr(editor, "strips") else editor.sequences)[0]
    assert strip.frame_start == pytest.approx(1.0 - 0.4 * 25) and strip.frame_final_duration == 50
    with pytest.raises(RuntimeError, match="cannot be found"):
        bpy.ops.facemime.add_sound()
    (tmp_path / "performance.mp4").write_bytes(b"a video without sound")
    (tmp_path / "sound.wav").rename(tmp_path / "performance.wav")
    bpy.context.scene.facemime.source.video = str(tmp_path / "performance.mp4")
    assert bpy.ops.facemime.add_sound() == {"FINISHED"}
    strips = list(editor.strips if hasattr(editor, "strips") else editor.sequences)
    assert len(strips) == 2 and len({strip.channel for strip in strips}) == 2
    with pytest.raises(RuntimeError, match="no readable sound"):
        bpy.ops.facemime.add_sound(filepath=str(tmp_path / "late.facetake"))


@pytest.mark.parametrize("keys", first_of(["new", "cache", "named", "mapped"], 2))
def test_the_selected_take_is_baked_with_the_settings_of_the_panel(keys, imported, takes, tmp_path):
    head = add_head(bpy.context, units=True)
    takes.bake.keys, takes.bake.max_keys, takes.bake.clean, takes.bake.nla = keys, 2, 0.5, True
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    baked = [key for key in head.data.shape_keys.key_blocks if key.name.startswith(BAKED_KEY_PREFIX)]
    assert len(baked) == (2 if keys in ("new", "named") else 0)
    assert (tmp_path / "caches" / "First Facemime_Head.pc2").exists() == (keys == "cache")
    assert head.animation_data.nla_tracks and head.animation_data.action is None


def test_heads_baked_one_after_another_keep_separate_caches(imported, takes):
    takes.bake.keys = "cache"
    for name in ("One", "Two"):
        add_head(bpy.context, name=name)
        assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    paths = {bpy.data.objects[name].modifiers[0].filepath for name in ("One", "Two")}
    assert len(paths) == 2 and all(Path(bpy.path.abspath(path)).is_file() for path in paths)


@pytest.mark.parametrize(
    ("operator", "suffix"), [("export_take", ".facetake"), ("export_key_map", ".json"), ("export_preset", ".json")]
)
def test_an_export_appends_its_suffix_and_overwrites_no_other_file(operator, suffix, imported, tmp_path):
    other = tmp_path / f"Take 1{suffix}"
    other.write_text("mine")
    assert getattr(bpy.ops.facemime, operator)(filepath=str(tmp_path / "Take 1.5")) == {"FINISHED"}
    assert other.read_text() == "mine" and (tmp_path / f"Take 1.5{suffix}").is_file()


def test_baking_and_removing_a_take_are_one_undo_step_each(imported):
    add_head(bpy.context)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.facemime.bake_take("EXEC_DEFAULT", True)
    assert bpy.data.objects["Facemime Head"].data.shape_keys is not None
    bpy.ops.facemime.remove_take("EXEC_DEFAULT", True)
    assert not len(bpy.context.scene.facemime_takes.items)
    bpy.ops.ed.undo()
    assert len(takes_store.read(bpy.context.scene.facemime_takes.items[0])) == 60
    assert bpy.data.objects["Facemime Head"].data.shape_keys is not None
    bpy.ops.ed.undo()
    head = bpy.data.objects["Facemime Head"]
    assert head.data.shape_keys is None and head.animation_data is None


def test_numbered_meshes_and_parameters_are_imported_into_the_list(takes, tmp_path):
    assert bpy.ops.facemime.add_head() == {"FINISHED"}
    for number in (1, 2, 3):
        bpy.ops.wm.obj_export(filepath=str(tmp_path / f"face{number}.obj"), export_selected_objects=True)
    path = str(tmp_path / "face1.obj")
    assert bpy.ops.facemime.import_take(filepath=path, fps=25.0) == {"FINISHED"}
    take = takes_store.read(takes.items[-1])
    assert len(take) == 3 and take.found.all() and take.info["fps"] == 25.0
    np.savez(tmp_path / "clip.npz", expr=np.zeros((2, 10)))
    with pytest.raises(RuntimeError, match="Choose the model's file, too"):
        bpy.ops.facemime.import_take(filepath=str(tmp_path / "clip.npz"))

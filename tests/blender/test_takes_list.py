"""The list of takes: recorded, shown, changed, packed, removed, found again, baked; and the table of keys."""

import gc
import threading
import time
import wave
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.bake_keys import BAKED_KEY_PREFIX
from facemime.blender.frames import to_blender
from facemime.blender.head import add_head
from facemime.blender.live import LIVE_KEY
from facemime.blender.meshes import read_rig
from facemime.core.bake.key_map import load_map
from facemime.core.capture import VideoSource
from facemime.core.drive import HeadDriver
from facemime.core.retarget import calibrate
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.smooth import smooth_take
from facemime.operators import punch_in
from facemime.scene import takes_store
from facemime.scene.settings import write_calibration
from facemime.sessions.punch_in import PunchIn
from facemime.sessions.recording import Recording, settle
from facemime.sessions.session import Session
from facemime.sessions.show import TakeShow
from facemime.sessions.start import start_session
from takes import performance


@pytest.fixture(autouse=True)
def _in_a_project(_empty_file, tmp_path):
    """A saved .blend, and nothing left over at the end."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    bpy.context.scene.render.fps = 25
    yield
    if Session.current is not None:
        Session.current.close()
    Recording.current = PunchIn.current = None
    gc.collect()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("facemime")]


@pytest.fixture
def takes():
    """The list."""
    return bpy.context.scene.facemime_takes


@pytest.fixture
def imported(tmp_path, takes):
    """A take in the list."""
    save_take(performance(), tmp_path / "First.facetake")
    assert bpy.ops.facemime.import_take(filepath=str(tmp_path / "First.facetake")) == {"FINISHED"}
    return takes.items[0]


@pytest.fixture
def session(tmp_path):
    """A live session that plays a take over and over, as a camera would."""
    save_take(performance(), tmp_path / "source.facetake")
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take = "TAKE", str(tmp_path / "source.facetake")
    settings.source.loop, settings.source.speed = True, 10.0
    write_calibration(settings, calibrate(performance()))
    return start_session(bpy.context.scene, [add_head(bpy.context)])


def wait_for(condition) -> None:
    """Until the worker has come so far."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def test_a_recording_is_on_the_disk_while_it_runs_and_in_the_list_when_it_ends(session, takes, tmp_path):
    wait_for(lambda: session.worker.counts.tracked > 5)
    assert bpy.ops.facemime.record_take(name="Anna") == {"FINISHED"}
    path = tmp_path / "takes" / "Anna.facetake"
    wait_for(lambda: Recording.current.frames > 80)
    assert "cut" in load_take(path).info["recovered"]
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    line = takes.items[0]
    assert (line.name, line.path) == ("Anna", "//takes/Anna.facetake")
    take = takes_store.read(line)
    assert take.times[0] == 0.0 and len(take) > 80 and "recovered" not in take.info
    assert take.info["clock"] == "media" and take.info["offset"] > 0.0
    np.testing.assert_allclose(calibrate(take).shape, session.worker.neutral.shape)
    assert line.length == pytest.approx(float(take.times[-1]))
    assert Session.current is session and not bpy.context.scene.facemime_takes.items[0].packed


def test_a_recording_whose_session_is_stopped_is_listed_too_and_the_next_has_its_own_file(session, takes):
    for _ in range(2):
        assert bpy.ops.facemime.record_take(name="Same") == {"FINISHED"}
        wait_for(lambda: Recording.current.frames > 3)
        if len(takes.items):
            session.close()
            assert settle()
        else:
            bpy.ops.facemime.record_take()
    assert [line.name for line in takes.items] == ["Same", "Same 2"]
    assert not settle() and not bpy.ops.facemime.record_take.poll()


def test_a_recording_is_not_listed_in_another_file_but_found_in_its_own(session, takes, tmp_path):
    assert bpy.ops.facemime.record_take(name="Left") == {"FINISHED"}
    wait_for(lambda: Recording.current.frames > 10)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert Recording.current is None and Session.current is None
    assert not len(bpy.context.scene.facemime_takes.items)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "project.blend"))
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["Left"]


def test_without_a_puppet_nothing_can_be_recorded():
    assert not bpy.ops.facemime.record_take.poll()
    with pytest.raises(RuntimeError, match="Start the puppet first"):
        bpy.ops.facemime.record_take()


def rerecord(**options) -> None:
    """Record a part anew, with the timer's ticks."""
    assert bpy.ops.facemime.rerecord_take(lead=0.05, **options) == {"FINISHED"}
    while PunchIn.current is not None:
        punch_in._watch()
        time.sleep(0.005)


def test_a_part_of_a_take_is_recorded_anew_and_the_rest_stays(session, imported, takes):
    before = takes_store.read(imported)
    wait_for(lambda: session.worker.counts.tracked > 5)
    rerecord(start=11, end=31, blend=0.1)
    after = takes_store.read(imported)
    assert len(takes.items) == 1 and imported.path != "//First.facetake" and Session.current is session
    assert after.info["punched_in"] == [[pytest.approx(0.4), pytest.approx(1.2)]]
    assert after.times[-1] == before.times[-1] and np.all(np.diff(after.times) > 0.0)
    old, new = before.times < 0.4, after.times < 0.4
    np.testing.assert_array_equal(after.landmarks[new], before.landmarks[old])
    inside = (after.times > 0.55) & (after.times < 1.05)
    assert inside.any() and not np.isin(after.times[inside], before.times).all()
    assert Recording.current is None and bpy.context.scene.sync_mode == "NONE"


def test_a_part_that_is_broken_off_leaves_the_take_as_it_was_and_what_came_in_the_list(session, imported, takes):
    assert bpy.ops.facemime.rerecord_take(start=1, end=1000, lead=0.0) == {"FINISHED"}
    assert not bpy.ops.facemime.rerecord_take.poll()
    wait_for(lambda: punch_in._watch() is not None and Recording.current is not None and Recording.current.frames > 5)
    session.close()
    assert punch_in._watch() is None
    assert [line.name for line in takes.items] == ["First", "Punch_In"] and takes.items[0].path == "//First.facetake"
    assert PunchIn.current is None and Recording.current is None


def test_a_part_without_length_is_refused(session, imported):
    with pytest.raises(RuntimeError, match="has no length"):
        bpy.ops.facemime.rerecord_take(start=5, end=5)


@pytest.mark.parametrize("fps", [24, 30, 60])
def test_a_video_is_kept_beside_the_take_and_shown_beside_the_head_in_step(fps, takes, tmp_path):
    scene = bpy.context.scene
    scene.facemime.source.kind, scene.facemime.source.loop, takes.video = "SAMPLE", False, True
    scene.render.fps = fps
    head = add_head(bpy.context)
    session = start_session(scene, [head])
    assert bpy.ops.facemime.record_take(name="Seen") == {"FINISHED"}
    wait_for(lambda: Recording.current.frames > 40)
    bpy.ops.facemime.record_take()
    session.close()
    take, video = takes_store.read(takes.items[0]), tmp_path / "takes" / "Seen.mkv"
    assert take.info["source"] == "Seen.mkv" and take.info["offset"] == 0.0
    with VideoSource(video) as frames:
        assert len(list(frames)) == round(take.times[-1] * 30.0) + 1
    assert bpy.ops.facemime.trim_take(start=0.5, end=9.0) == {"FINISHED"}
    trimmed = takes_store.read(takes.items[0])
    assert bpy.ops.facemime.add_reference() == {"FINISHED"}
    empty = scene.objects["Seen Reference"]
    for frame in (1, 2, fps // 2, fps):
        scene.frame_set(frame)
        shown = frame + empty.evaluated_get(bpy.context.evaluated_depsgraph_get()).image_user.frame_offset
        assert abs((shown - 1) / 30.0 - trimmed.info["offset"] - (frame - 1) / fps) <= 0.5 / 30.0 + 1e-6
    assert (
        empty.location.x < min(corner[0] for corner in head.bound_box)
        and empty.empty_display_size > 0.5 * head.dimensions.z
    )


def test_a_take_is_shown_at_the_scenes_frame_as_it_would_be_live_and_leaves_nothing(imported):
    head, scene = add_head(bpy.context), bpy.context.scene
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    take, rig = smooth_take(takes_store.read(imported)), read_rig(head)
    driver = HeadDriver(rig, calibrate(take))
    for row in (10, 41, 55, 22):
        scene.frame_set(row + 1)
        mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        shown = np.array([vertex.co for vertex in mesh.vertices])
        np.testing.assert_allclose(shown, to_blender(driver.frame(take.result(row)).vertices), atol=1e-6)
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    assert head.data.shape_keys is None and Session.current is None
    scene.frame_set(41)
    assert tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)


def test_a_shown_take_is_not_saved_with_the_file_and_goes_on_afterwards(imported, tmp_path):
    head = add_head(bpy.context)
    bpy.ops.facemime.show_take()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    assert LIVE_KEY in head.data.shape_keys.key_blocks and isinstance(Session.current, TakeShow)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "copy.blend"))
    assert Session.current is None and bpy.data.objects["Facemime Head"].data.shape_keys is None
    assert takes_store.read(bpy.context.scene.facemime_takes.items[0]).times.shape == performance().times.shape


def test_a_head_that_is_deleted_while_a_take_is_shown_ends_the_show(imported):
    head = add_head(bpy.context)
    bpy.ops.facemime.show_take()
    bpy.data.objects.remove(head)
    bpy.context.scene.frame_set(30)
    assert Session.current is None


def test_a_removed_take_is_still_on_the_disk_and_can_be_found_again(imported, takes, tmp_path):
    assert bpy.ops.facemime.trim_take(start=0.4, end=1.6) == {"FINISHED"}
    path = Path(bpy.path.abspath(takes.items[0].path))
    assert bpy.ops.facemime.remove_take() == {"FINISHED"} and not len(takes.items)
    assert path.is_file() and not bpy.ops.facemime.remove_take.poll()
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.path for line in takes.items] == ["//takes/First.facetake"]
    assert bpy.ops.facemime.find_takes() == {"FINISHED"} and len(takes.items) == 1


def test_trimmed_and_mended_a_take_has_another_file_and_the_one_before_stays(imported, tmp_path):
    before = imported.path
    assert bpy.ops.facemime.trim_take(start=0.4, end=1.6) == {"FINISHED"}
    trimmed = takes_store.read(imported)
    assert trimmed.times[0] == 0.0 and trimmed.times[-1] == pytest.approx(1.16)
    assert imported.length == pytest.approx(1.16) and (tmp_path / "First.facetake").is_file()
    assert bpy.ops.facemime.mend_take(outliers=True, gaps="bridge", smooth=True) == {"FINISHED"}
    mended = takes_store.read(imported)
    assert mended.found.all() and not trimmed.found.all() and mended.info["smoothed"] == "zero-phase"
    imported.path = before
    assert len(takes_store.read(imported)) == len(performance())
    with pytest.raises(RuntimeError, match="No frame is left"):
        bpy.ops.facemime.trim_take(start=8.0, end=9.0)


def test_what_mending_changed_is_drawn_as_an_image(imported):
    assert bpy.ops.facemime.mend_take(picture=True) == {"FINISHED"}
    image = bpy.data.images["First Mended"]
    assert image.packed_file is not None and min(image.size) > 500
    pixels = np.array(image.pixels[:]).reshape(-1, 4)
    assert (pixels == 1.0).all(axis=1).mean() > 0.8 and (np.ptp(pixels[:, :3], axis=1) > 0.2).any()


def test_the_neutral_is_chosen_anew_from_the_face_at_the_scenes_frame(imported):
    before = calibrate(takes_store.read(imported)).shape
    bpy.context.scene.frame_set(36)
    assert bpy.ops.facemime.renew_neutral() == {"FINISHED"}
    take = takes_store.read(imported)
    assert np.abs(calibrate(take).shape - take.shape[35]).max() < np.abs(before - take.shape[35]).max() / 3.0
    bpy.context.scene.frame_set(900)
    with pytest.raises(RuntimeError, match="No face was found"):
        bpy.ops.facemime.renew_neutral()


def test_another_take_is_punched_in_from_a_moment_on(imported, takes, tmp_path):
    other = performance(20)
    save_take(other, tmp_path / "Retake.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "Retake.facetake"))
    takes.index = 0
    assert bpy.ops.facemime.punch_in_take(other="Retake", start=1.4, blend=0.1) == {"FINISHED"}
    take = takes_store.read(takes.items[0])
    np.testing.assert_allclose(take.shape[40], other.shape[5], atol=2e-4)
    assert take.info["punched_in"] == [[pytest.approx(1.4), pytest.approx(1.4 + 19 / 25)]]
    with pytest.raises(RuntimeError, match="no such take"):
        bpy.ops.facemime.punch_in_take(other="Nobody")


def test_a_packed_take_needs_no_file_and_can_be_unpacked(imported, tmp_path):
    assert bpy.ops.facemime.pack_take() == {"FINISHED"}
    (tmp_path / "First.facetake").unlink()
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    line = bpy.context.scene.facemime_takes.items[0]
    np.testing.assert_allclose(takes_store.read(line).times, performance().times)
    assert bpy.ops.facemime.pack_take() == {"FINISHED"}
    assert line.packed is None and not bpy.data.texts and (tmp_path / "takes" / "First.facetake").is_file()


def test_what_is_wrong_with_a_take_is_said(imported, tmp_path):
    (tmp_path / "First.facetake").unlink()
    with pytest.raises(RuntimeError, match="is not at"):
        bpy.ops.facemime.export_take(filepath=str(tmp_path / "out.facetake"))
    imported.packed = bpy.data.texts.new("rubbish")
    with pytest.raises(RuntimeError, match="is damaged"):
        bpy.ops.facemime.export_take(filepath=str(tmp_path / "out.facetake"))
    with pytest.raises(RuntimeError, match="no take"):
        bpy.ops.facemime.import_take(filepath=str(tmp_path / "none.facetake"))


def test_takes_go_out_and_come_in_as_files_and_tables(imported, takes, tmp_path):
    for suffix in ("csv", "facetake"):
        assert bpy.ops.facemime.export_take(filepath=str(tmp_path / f"out.{suffix}")) == {"FINISHED"}
        assert bpy.ops.facemime.import_take(filepath=str(tmp_path / f"out.{suffix}")) == {"FINISHED"}
        takes.index = 0
    for line in takes.items[1:]:
        np.testing.assert_allclose(takes_store.read(line).shape, takes_store.read(takes.items[0]).shape)
    assert [line.path for line in takes.items[1:]] == ["//takes/out.facetake", "//out.facetake"]


def test_an_unsaved_file_has_its_takes_in_the_users_folder():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert takes_store.folder().is_absolute() and takes_store.folder().name == "takes"
    assert "facemime" in str(takes_store.folder())


def test_saved_elsewhere_or_as_a_copy_the_file_finds_its_takes(imported, tmp_path):
    (tmp_path / "other").mkdir()
    for name, copy in (("copy.blend", True), ("moved.blend", False)):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other" / name), copy=copy, relative_remap=False)
        assert imported.path == ("//First.facetake" if copy else "//../First.facetake")
        assert len(takes_store.read(imported)) == 60
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "copy.blend"))
    assert len(takes_store.read(bpy.context.scene.facemime_takes.items[0])) == 60


def test_a_take_of_an_unsaved_file_becomes_relative_when_that_is_saved(tmp_path):
    save_take(performance(), tmp_path / "First.facetake")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "First.facetake"))
    line = bpy.context.scene.facemime_takes.items[0]
    assert line.path == str(tmp_path / "First.facetake")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "late.blend"))
    assert line.path == "//First.facetake"


@pytest.mark.skipif(not bpy.app.build_options.audaspace, reason="this bpy was built without sound")
def test_sound_lies_in_step_with_the_take(imported, tmp_path):
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
    with pytest.raises(RuntimeError, match="not at hand"):
        bpy.ops.facemime.add_sound()
    (tmp_path / "performance.mp4").write_bytes(b"a video without sound")
    (tmp_path / "sound.wav").rename(tmp_path / "performance.wav")
    bpy.context.scene.facemime.source.video = str(tmp_path / "performance.mp4")
    assert bpy.ops.facemime.add_sound() == {"FINISHED"}
    strips = list(editor.strips if hasattr(editor, "strips") else editor.sequences)
    assert len(strips) == 2 and len({strip.channel for strip in strips}) == 2
    with pytest.raises(RuntimeError, match="no sound"):
        bpy.ops.facemime.add_sound(filepath=str(tmp_path / "late.facetake"))


@pytest.mark.parametrize("keys", ["new", "named", "mapped", "cache"])
def test_the_chosen_take_is_baked_as_the_panel_says(keys, imported, takes, tmp_path):
    head = add_head(bpy.context, units=True)
    takes.bake.keys, takes.bake.max_keys, takes.bake.clean, takes.bake.nla = keys, 2, 0.5, True
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    baked = [key for key in head.data.shape_keys.key_blocks if key.name.startswith(BAKED_KEY_PREFIX)]
    assert len(baked) == (2 if keys == "new" else 0)
    assert (tmp_path / "caches" / "First.pc2").exists() == (keys == "cache")
    assert head.animation_data.nla_tracks and head.animation_data.action is None


def test_a_bake_and_the_removal_of_a_take_are_one_undo_step_each(imported):
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


def test_a_table_is_detected_edited_shared_and_learnt(imported, takes, tmp_path):
    head, bake = add_head(bpy.context, units=True), takes.bake
    assert bpy.ops.facemime.detect_key_map() == {"FINISHED"} and len(bake.rows) == 52
    bake.row = [row.key for row in bake.rows].index("tongueOut")
    assert bpy.ops.facemime.remove_key_row() == {"FINISHED"} and len(bake.rows) == 51
    assert bpy.ops.facemime.add_key_row() == {"FINISHED"}
    bake.keys = "mapped"
    with pytest.raises(RuntimeError, match="Row 52 of the table has no key"):
        bpy.ops.facemime.bake_take()
    bake.rows[51].key, bake.rows[51].gain = "tongueOut", 0.25
    assert bpy.ops.facemime.export_key_map(filepath=str(tmp_path / "mine.json")) == {"FINISHED"}
    assert load_map(tmp_path / "mine.json").rows[51].gain == 0.25
    assert bpy.ops.facemime.import_key_map(filepath=str(tmp_path / "mine.json")) == {"FINISHED"}
    assert not bpy.ops.facemime.learn_key_map.poll()
    for frame, value in ((1, 0.0), (35, 0.8), (45, 0.8)):
        bpy.context.scene.frame_set(frame)
        head.data.shape_keys.key_blocks["cheekPuff"].value = value
        assert bpy.ops.facemime.add_key_pose() == {"FINISHED"}
    assert bpy.ops.facemime.learn_key_map() == {"FINISHED"} and not len(bake.poses)
    assert sum(row.gain for row in bake.rows if row.key == "cheekPuff" and row.source != "cheekPuff") > 0.2
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    bpy.context.scene.frame_set(35)
    assert head.data.shape_keys.key_blocks["cheekPuff"].value == pytest.approx(0.8, abs=0.1)


def test_a_head_of_unknown_keys_has_no_table_to_be_detected():
    head = add_head(bpy.context)
    for name in ("Basis", "Fat"):
        head.shape_key_add(name=name, from_mix=False)
    with pytest.raises(RuntimeError, match="no preset knows"):
        bpy.ops.facemime.detect_key_map()

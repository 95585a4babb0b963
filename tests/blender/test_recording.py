"""Recording and re-recording takes, with and without video."""

import threading
from math import cos, radians, sin

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from facemime.blender.heads.new_heads import add_head
from facemime.blender.reference import add_reference
from facemime.core.errors import OutputError
from facemime.core.files.capture import VideoSource
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.neutral import calibrate
from facemime.operators.puppet import running
from facemime.sessions.session import Session
from facemime.sessions.start import start_session
from facemime.settings import storage, takes_store
from tests.helpers.live_ticks import attend, wait_for
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of
from tests.helpers.turned import turned_clip

pytestmark = pytest.mark.usefixtures("in_a_project")


def test_a_recording_is_on_disk_from_the_start_and_in_the_list_at_the_end(session, takes, tmp_path):
    wait_for(lambda: session.worker.counts.tracked > 5)
    assert bpy.ops.facemime.record_take(name="Anna") == {"FINISHED"}
    path = tmp_path / "takes" / "Anna.facetake"
    wait_for(lambda: session.recorder.recording.frames > 80)
    assert "cut" in load_take(path).info["recovered"]
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    line = takes.items[0]
    assert (line.name, line.path) == ("Anna", "//takes/Anna.facetake")
    take = takes_store.read(line)
    assert take.times[0] == 0.0 and len(take) > 80 and "recovered" not in take.info
    assert take.info["clock"] == "media" and take.info["offset"] > 0.0
    np.testing.assert_allclose(calibrate(take).shape, session.worker.first.neutral.shape)
    assert line.length == pytest.approx(float(take.times[-1]))
    assert Session.current is session and not bpy.context.scene.facemime_takes.items[0].packed


def test_stopping_the_session_lists_the_recording_and_the_next_one_gets_a_new_file(session, takes):
    for _ in range(2):
        assert bpy.ops.facemime.record_take(name="Same") == {"FINISHED"}
        wait_for(lambda: session.recorder.recording.frames > 3)
        if len(takes.items):
            session.close()
            assert Session.current is session and session.recorder.recording is not None
            attend()
        else:
            bpy.ops.facemime.record_take()
    assert [line.name for line in takes.items] == ["Same", "Same 2"]
    assert Session.current is None


def test_a_recording_is_listed_before_the_next_session_starts(session, takes):
    assert bpy.ops.facemime.record_take(name="First") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 3)
    session.close()
    second = start_session(bpy.context.scene, [bpy.data.objects["Facemime Head"]])
    assert [line.name for line in takes.items] == ["First"] and Session.current is second


def test_a_recording_whose_disk_is_full_is_listed_while_the_puppet_continues(session, takes, monkeypatch):
    assert bpy.ops.facemime.record_take(name="Full") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 60)

    def fail(*_):
        raise OutputError("The disk is full.")

    monkeypatch.setattr(session.recorder.recording, "append", fail)
    wait_for(lambda: attend() or session.recorder.recording is None)
    assert [line.name for line in takes.items] == ["Full"] and running() is session


def test_undoing_during_a_recording_keeps_it_and_the_take_before(session, takes):
    for name in ("First", "Second"):
        assert bpy.ops.facemime.record_take(name=name) == {"FINISHED"}
        wait_for(lambda: session.recorder.recording.frames > 3)
        if name == "First":
            assert bpy.ops.facemime.record_take() == {"FINISHED"}
    assert bpy.ops.ed.undo() == {"FINISHED"}
    assert running() is session and session.recorder.recording is not None
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["First"]
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["First", "Second"]


def test_a_recording_is_listed_in_its_scene_when_that_is_renamed(session, takes):
    assert bpy.ops.facemime.record_take(name="First") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 3)
    scene = bpy.context.scene
    bpy.ops.ed.undo_push(message="before")
    before, scene.name = scene.name, "Renamed"
    bpy.data.scenes.new(before)
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    assert [line.name for line in scene.facemime_takes.items] == ["First"]
    assert bpy.ops.ed.undo() == {"FINISHED"}
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["First"]


def test_undoing_the_start_of_the_puppet_while_recording_lists_the_take(session, takes):
    session.close()
    bpy.ops.ed.undo_push(message="before")
    again = start_session(bpy.context.scene, [bpy.data.objects["Facemime Head"]])
    assert bpy.ops.facemime.record_take(name="Undone") == {"FINISHED"}
    wait_for(lambda: again.recorder.recording.frames > 3)
    assert bpy.ops.ed.undo() == {"FINISHED"} and running() is None
    attend()
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["Undone"] and Session.current is None


def test_a_recording_is_found_in_its_own_file_and_not_listed_in_another(session, takes, tmp_path):
    assert bpy.ops.facemime.record_take(name="Left") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 10)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert session.recorder.recording.closed and Session.current is None
    assert not len(bpy.context.scene.facemime_takes.items)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "project.blend"))
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["Left"]


def test_a_recording_is_listed_if_another_file_cannot_be_opened(session, takes, tmp_path):
    assert bpy.ops.facemime.record_take(name="Kept") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 3)
    (tmp_path / "broken.blend").write_bytes(b"BLENDER-v405" + bytes(100))
    with pytest.raises(RuntimeError):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "broken.blend"))
    assert session.closed
    attend()
    assert [line.name for line in bpy.context.scene.facemime_takes.items] == ["Kept"] and Session.current is None


def test_takes_are_found_beside_unreadable_files(takes, tmp_path):
    folder = tmp_path / "takes"
    folder.mkdir()
    save_take(performance(), folder / "Good.facetake")
    save_take(performance(), folder / "Zoe.facetake")
    (folder / "Broken.facetake").write_bytes((folder / "Good.facetake").read_bytes()[:60])
    (folder / "Empty.facetake").touch()
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.name for line in takes.items] == ["Good", "Zoe"]


def test_a_recording_that_cannot_start_leaves_no_thread(session, takes, tmp_path, monkeypatch):
    takes.video = True
    monkeypatch.setattr(storage, "default_folder", lambda name: tmp_path / name)
    (tmp_path / "takes").write_text("not a folder")
    before = threading.active_count()
    with pytest.raises(RuntimeError, match="Cannot write"):
        bpy.ops.facemime.record_take()
    assert threading.active_count() == before and session.recorder.recording is None


def test_recording_needs_a_head():
    assert not bpy.ops.facemime.record_take.poll()
    with pytest.raises(RuntimeError, match="Select a head"):
        bpy.ops.facemime.record_take()


def test_recording_starts_the_puppet_first(take, takes):
    add_head(bpy.context)
    assert bpy.ops.facemime.record_take(name="At Once") == {"FINISHED"}
    session = Session.current
    wait_for(lambda: session.recorder.recording.frames > 3)
    session.close()
    attend()
    assert [line.name for line in takes.items] == ["At_Once"]


def test_an_error_of_the_start_is_reported_when_recording(takes):
    add_head(bpy.context)
    bpy.context.scene.facemime.source.kind = "VIDEO"
    with pytest.raises(RuntimeError, match="video"):
        bpy.ops.facemime.record_take()
    assert Session.current is None and not len(takes.items)


def rerecord(**options) -> None:
    """Re-record a range, with the ticks of the timer."""
    assert bpy.ops.facemime.rerecord_take(lead=0.05, **options) == {"FINISHED"}
    wait_for(lambda: attend() or running().recorder.punch_in is None)


def test_a_range_is_re_recorded_and_the_rest_of_the_take_is_kept(session, imported, takes):
    before = takes_store.read(imported)
    wait_for(lambda: session.worker.counts.tracked > 5)
    rerecord(start=11, end=31, blend=0.1)
    after = takes_store.read(imported)
    assert len(takes.items) == 1 and imported.path != "//First.facetake" and Session.current is session
    assert after.info["punched_in"] == [[pytest.approx(0.4), pytest.approx(1.2)]]
    assert after.times[-1] == before.times[-1] and np.all(np.diff(after.times) > 0.0)
    old, new = before.times < 0.4, after.times < 0.4
    np.testing.assert_array_equal(after.landmarks[new], before.landmarks[old])
    part, new_part = (take.landmarks[(take.times > 0.55) & (take.times < 1.05)] for take in (before, after))
    assert len(new_part) > 0 and not np.array_equal(part, new_part)
    assert session.recorder.recording is None and bpy.context.scene.sync_mode == "NONE"


def test_a_range_is_re_recorded_in_a_scene_that_is_renamed_meanwhile(session, imported, takes):
    wait_for(lambda: session.worker.counts.tracked > 5)
    assert bpy.ops.facemime.rerecord_take(start=11, end=31, lead=0.05, blend=0.1) == {"FINISHED"}
    bpy.context.scene.name = "Renamed"
    wait_for(lambda: attend() or running().recorder.punch_in is None)
    assert takes_store.read(imported).info["punched_in"] == [[pytest.approx(0.4), pytest.approx(1.2)]]


def test_an_interrupted_re_recording_keeps_the_take_and_lists_the_recorded_part(session, imported, takes):
    assert bpy.ops.facemime.rerecord_take(start=1, end=1000, lead=0.0) == {"FINISHED"}
    assert not bpy.ops.facemime.rerecord_take.poll()
    wait_for(lambda: attend() or (session.recorder.recording is not None and session.recorder.recording.frames > 5))
    session.close()
    attend()
    assert [line.name for line in takes.items] == ["First", "Insert"] and takes.items[0].path == "//First.facetake"
    assert Session.current is None and bpy.context.scene.sync_mode == "NONE"


def test_an_empty_range_is_rejected(session, imported):
    with pytest.raises(RuntimeError, match="is empty"):
        bpy.ops.facemime.rerecord_take(start=5, end=5)


@pytest.mark.parametrize("fps", first_of([24, 30, 60]))
def test_the_video_is_kept_beside_the_take_and_plays_beside_the_head_in_sync(fps, takes, tmp_path):
    scene = bpy.context.scene
    scene.facemime.source.kind, scene.facemime.source.loop, takes.video = "SAMPLE", False, True
    scene.render.fps = fps
    head = add_head(bpy.context)
    session = start_session(scene, [head])
    assert bpy.ops.facemime.record_take(name="Seen") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 40)
    bpy.ops.facemime.record_take()
    session.close()
    take, video = takes_store.read(takes.items[0]), tmp_path / "takes" / "Seen.mkv"
    assert take.info["source"] == "Seen.mkv" and take.info["offset"] == 0.0
    with VideoSource(video) as frames:
        assert len(list(frames)) == round(take.times[-1] * 30.0) + 1
    assert bpy.ops.facemime.trim_take(start=0.5, end=9.0) == {"FINISHED"}
    trimmed = takes_store.read(takes.items[1])
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


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_a_phone_video_is_upright_beside_the_head(tmp_path, turn):
    head = add_head(bpy.context)
    empty = add_reference(bpy.context.scene, turned_clip(tmp_path / "clip.mp4", turn), 0.0, head)
    bpy.context.view_layer.update()
    top = empty.matrix_world.to_3x3() @ Vector((0, 1, 0))  # of the image as Blender displays it
    left = 0.0 if bpy.app.version >= (4, 4, 0) else radians(turn)  # Blender 4.2 does not rotate it
    expected = Vector((sin(left), 0, cos(left)))
    assert (top - expected).length < 1e-5
    right, height = head.bound_box[0][0], empty.empty_display_size
    assert empty.location.x + (0.5 if turn % 180 == 0 else 0.375) * height < right


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_a_video_that_is_stored_mirrored_is_shown_so_beside_the_head(tmp_path, turn):
    clip = turned_clip(tmp_path / "clip.mp4", turn, mirrored=True)
    empty = add_reference(bpy.context.scene, clip, 0.0, add_head(bpy.context))
    bpy.context.view_layer.update()
    displayed = empty.matrix_world.to_3x3()
    # Where Blender rotates an image, its upper side comes from another one of what is stored.
    rotated = Matrix.Rotation(-radians(turn) if bpy.app.version >= (4, 4, 0) else 0.0, 3, "Z")
    top, side = displayed @ rotated @ Vector((0, 1, 0)), displayed @ rotated @ Vector((1, 0, 0))
    assert (top - Vector((-sin(radians(turn)), 0, -cos(radians(turn))))).length < 1e-5
    assert (side - Vector((cos(radians(turn)), 0, -sin(radians(turn))))).length < 1e-5

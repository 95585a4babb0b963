"""Editing of the landmarks of a take: pins in the list, the preview, undo, and what is learnt from them."""

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.timeline import seconds_of
from facemime.blender.viewports import FreeBox
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.pins import pins_of
from facemime.core.takes.timing import shift_time
from facemime.sessions.landmark_edit import LandmarkEdit
from facemime.sessions.show import TakeShow
from facemime.settings import takes_store
from tests.helpers.takes import performance

BOX = FreeBox(0.0, 0.0, 800.0, 600.0)
UPPER = (37, 38)
"""Landmarks of the right upper lid."""


@pytest.fixture
def line(tmp_path):
    path = tmp_path / "take.facetake"
    save_take(performance(60), path)
    return takes_store.add(bpy.context.scene, path)


@pytest.fixture
def edit(line):
    bpy.context.scene.frame_set(20)
    edit = LandmarkEdit(bpy.context.scene, line, 0)
    edit.look_at(BOX)
    edit.fit()
    yield edit
    edit.close()


def shut(edit):
    """Drag the right upper lid to the lower one, as the mouse does."""
    edit.editor.mark()
    for upper, lower in zip(UPPER, (41, 40), strict=True):
        x, y = edit.landmarks[lower]
        edit.editor.place(upper, float(x), float(y))
    edit.changed()


def file_of(line):
    return takes_store.located(line.path)


def test_a_position_in_the_viewport_is_that_of_the_image_at_any_zoom(edit):
    place = edit.to_region(edit.landmarks[30])
    assert edit.is_inside(place) and edit.nearest(place + 3.0, 10.0) == 30
    edit.zoom(3.0, place)
    np.testing.assert_allclose(edit.to_region(edit.landmarks[30]), place, atol=1e-6)
    np.testing.assert_allclose(edit.to_image(edit.to_region(edit.landmarks)), edit.landmarks, atol=1e-6)
    edit.pan(np.array([10.0, 20.0]))
    np.testing.assert_allclose(edit.to_region(edit.landmarks[30]), place + (10.0, 20.0), atol=1e-6)


def test_pins_are_written_beside_what_was_tracked_and_shown_by_the_preview(edit, line):
    scene, head = bpy.context.scene, add_head(bpy.context)
    tracked = load_take(file_of(line))
    show = TakeShow(scene, [head], takes_store.read(line), line.path)
    before = _lids(head)
    shut(edit)
    edit.save(scene)
    assert _lids(head) < 0.1 * before, "the avatar's lid is shut in this frame"
    show.close()
    solved, raw = takes_store.read(line), takes_store.read(line, solved=False)
    assert takes_store.has_pins(line) and len(pins_of(solved)) == 2
    np.testing.assert_array_equal(raw.landmarks, tracked.landmarks)
    np.testing.assert_array_equal(solved.landmarks[55], tracked.landmarks[55])
    assert np.abs(solved.landmarks[edit.editor.frame, list(UPPER)] - edit.landmarks[list(UPPER)]).max() < 0.5


def _lids(head):
    """Opening of the right eye of a head as shown, in metres."""
    from facemime.blender.rigs import read_rig

    bpy.context.view_layer.update()
    mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    co = np.empty(3 * len(mesh.vertices))
    mesh.vertices.foreach_get("co", co)
    points = co.reshape(-1, 3)[read_rig(head).landmarks]
    return float(points[37, 2] - points[41, 2])


def test_the_editor_follows_the_frames_of_its_scene_when_that_is_renamed(edit):
    scene, before = bpy.context.scene, edit.editor.frame
    scene.name = "Renamed"
    scene.frame_set(40)
    assert edit.follow_scene(scene) and edit.editor.frame != before


def test_undo_restores_the_pins_in_the_file_and_redo_sets_them_again(edit, line):
    scene = bpy.context.scene
    bpy.ops.ed.undo_push(message="before")
    path = file_of(line)
    shut(edit)
    edit.save(scene)
    bpy.ops.ed.undo_push(message="Edit Landmarks")
    assert len(pins_of(load_take(path))) == 2
    bpy.ops.ed.undo()
    assert pins_of(load_take(path)) == ()
    bpy.ops.ed.redo()
    assert len(pins_of(load_take(path))) == 2


def test_the_editor_has_its_own_undo_and_removes_pins(edit):
    shut(edit)
    assert len(edit.editor.pins()) == 2
    assert edit.editor.undo() and not edit.editor.pins() and not edit.editor.changed
    assert edit.editor.redo() and edit.editor.changed
    assert edit.editor.remove(np.array([37])) and list(edit.editor.pins()) == [38]
    edit.editor.step(5)
    assert not edit.editor.pins() and edit.editor.next_pinned(-1) and list(edit.editor.pins()) == [38]
    edit.editor.discard()
    assert not edit.editor.changed


def test_packed_takes_keep_their_pins_in_the_blend_file(line):
    scene = bpy.context.scene
    takes_store.pack(line)
    edit = LandmarkEdit(scene, line, 0)
    shut(edit)
    edit.save(scene)
    edit.close()
    assert len(pins_of(takes_store.read(line))) == 2
    assert pins_of(load_take(file_of(line))) == (), "the file itself is as it was"
    assert len(pins_of(load_take(takes_store.unpack(line)))) == 2


def test_trimmed_and_mended_takes_keep_pins_that_can_still_be_removed(edit, line):
    scene = bpy.context.scene
    shut(edit)
    edit.save(scene)
    assert bpy.ops.facemime.mend_take() == {"FINISHED"}
    mended = takes_store.chosen(scene)
    assert len(pins_of(takes_store.read(mended))) == 2
    raw = takes_store.read(mended, solved=False)
    assert np.abs(raw.landmarks - takes_store.read(mended).landmarks).max() > 1.0


def test_pins_of_one_frame_are_refused_for_learning_and_those_of_several_correct_other_takes(line, tmp_path):
    scene = bpy.context.scene
    assert bpy.ops.facemime.learn_from_pins.poll()
    with pytest.raises(RuntimeError, match="no pins"):
        bpy.ops.facemime.learn_from_pins()
    edit = LandmarkEdit(scene, line, 0)
    for frame in (5, 20, 35, 50):
        edit.editor.frame = frame
        edit.changed()
        for landmark in range(17, 22):
            x, y = edit.editor.take.landmarks[frame, landmark].tolist()
            edit.editor.place(landmark, x, y - 5.0)
        if frame == 5:
            edit.save(scene)
            with pytest.raises(RuntimeError, match="do not predict each other"):
                bpy.ops.facemime.learn_from_pins()
    edit.save(scene)
    edit.close()
    assert bpy.ops.facemime.learn_from_pins() == {"FINISHED"}
    assert takes_store.learns(line) and len(scene.facemime.performers) == 1
    own = takes_store.read(line).landmarks[12, 17:22, 1] - takes_store.read(line, solved=False).landmarks[12, 17:22, 1]
    assert own.mean() < -3.0, "a frame without pins is corrected, too"
    other = tmp_path / "other.facetake"
    save_take(performance(40), other)
    second = takes_store.add(scene, other)
    moved = takes_store.read_corrected(scene, second).landmarks - takes_store.read(second).landmarks
    assert moved[12, 17:22, 1].mean() < -3.0
    scene.facemime_takes.index = 0
    assert bpy.ops.facemime.learn_from_pins() == {"FINISHED"}
    assert not takes_store.learns(line)
    np.testing.assert_array_equal(
        takes_store.read_corrected(scene, second).landmarks, takes_store.read(second).landmarks
    )


def test_next_doubtful_frame_goes_to_the_least_certain_frame_first(tmp_path):
    scene, take = bpy.context.scene, performance(60)
    take.landmark_confidence[:] = 0.9
    take.landmark_confidence[40, 36:42] = 0.1
    path = tmp_path / "doubtful.facetake"
    save_take(take, path)
    takes_store.add(scene, path)
    assert bpy.ops.facemime.next_doubtful_frame() == {"FINISHED"}
    rate = scene.render.fps / scene.render.fps_base
    assert (scene.frame_current_final - 1) / rate == pytest.approx(take.times[40] - take.times[0], abs=0.51 / rate)


def test_landmarks_cannot_be_edited_without_a_window(line):
    with pytest.raises(RuntimeError, match="no 3D Viewport"):
        bpy.ops.facemime.edit_landmarks()


def test_the_editor_shows_the_frame_of_a_late_take_that_the_preview_shows(tmp_path):
    scene, path = bpy.context.scene, tmp_path / "late.facetake"
    take = shift_time(performance(60), 0.52 - float(performance(60).times[0]))
    save_take(take, path)
    line = takes_store.add(scene, path)
    for number in (5, 30):
        scene.frame_set(round(1 + float(take.times[number]) * scene.render.fps / scene.render.fps_base))
        edit = LandmarkEdit(scene, line, 0)
        nearest = np.abs(take.times - seconds_of(scene)).argmin()
        assert edit.editor.frame == nearest
        edit.editor.step(1)
        edit.show_in_scene(scene)
        assert seconds_of(scene) == pytest.approx(edit.editor.time, abs=0.5 / scene.render.fps)
        edit.close()

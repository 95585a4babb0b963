"""The video beside a head and the sound in the Sequencer are in step with the take, by the times in their files."""

import wave

import bpy
import cv2
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.reference import add_reference
from facemime.blender.timeline import rate_of
from facemime.core.files.capture import VideoSource
from facemime.core.takes.file import save_take
from facemime.operators import bake
from tests.helpers.clips import write_variable_clip
from tests.helpers.takes import performance

STEPS = [1] * 30 + [2] * 30
"""A second at 30 images per second, and two at 15."""
RATE = 30


@pytest.fixture
def clip(tmp_path):
    """A clip of a variable rate, and the times of its images."""
    return tmp_path / "variable.mp4", write_variable_clip(tmp_path / "variable.mp4", STEPS, RATE)


def on_display(times, seconds):
    """Number of the image on display at a time."""
    return max(0, int(np.searchsorted(times, seconds + 1e-6, side="right")) - 1)


def test_times_of_a_variable_rate_are_those_of_the_file(clip):
    path, times = clip
    with VideoSource(path) as video:
        np.testing.assert_allclose([frame.time for frame in video], times, atol=1e-3)


@pytest.mark.parametrize(("fps", "start"), [(24, 1.0), (60, 1.0), (30, 1001.0), (25, -20.0)])
@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_the_reference_shows_the_image_of_the_takes_time(fps, start, offset, clip):
    path, times = clip
    scene, head = bpy.context.scene, add_head(bpy.context)
    scene.render.fps = fps
    empty = add_reference(scene, path, offset, head, start)
    for second in (0.0, 0.5, 1.0, 1.5, 2.2, 2.5):
        frame = round(start + second * rate_of(scene))
        scene.frame_set(frame)
        user = empty.evaluated_get(bpy.context.evaluated_depsgraph_get()).image_user
        within = min(max(frame - user.frame_start + 1, 0), user.frame_duration)  # as Blender limits it
        shown = on_display(times, (within + user.frame_offset - 1) / RATE)
        wanted = (frame - start) / rate_of(scene) + offset
        assert abs(times[shown] - min(wanted, times[-1])) <= 2 / RATE + 0.5 / RATE


@pytest.mark.parametrize("aspect", [1.5, 0.5])
def test_the_reference_has_the_shape_in_which_players_show_the_video(clip, aspect, monkeypatch):
    monkeypatch.setattr(VideoSource, "_pixel_aspect", lambda source: aspect)
    head = add_head(bpy.context)
    empty = add_reference(bpy.context.scene, clip[0], 0.0, head)
    width, height = (side * pixel for side, pixel in zip(empty.data.size, empty.data.display_aspect, strict=True))
    stored = empty.data.size[0] / empty.data.size[1]
    assert width / height == pytest.approx(aspect * stored, rel=1e-3)
    tall = np.ptp([corner[2] for corner in head.bound_box])
    assert empty.empty_display_size == pytest.approx(tall * max(width / height, 1.0), rel=1e-3)


@pytest.mark.thorough
def test_blender_numbers_the_images_of_a_video_by_time(clip):
    path, times = clip
    scene = bpy.context.scene
    render = scene.render
    scene.view_settings.view_transform = "Standard"
    render.resolution_x, render.resolution_y, render.resolution_percentage = 160, 120, 100
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strips.new_movie("clip", str(path), channel=1, frame_start=1)
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format, render.filepath = "PNG", str(path.with_suffix(".png"))
    with VideoSource(path) as video:
        greys = np.array([frame.image.mean() for frame in video])
    for number in (0, 20, 40, 60, 80):
        scene.frame_set(1 + number)
        bpy.ops.render.render(write_still=True)
        shown = int(np.abs(greys - cv2.imread(render.filepath).mean()).argmin())
        assert abs(shown - on_display(times, number / RATE)) <= 1


@pytest.mark.skipif(not bpy.app.build_options.audaspace, reason="this bpy was built without sound")
def test_sound_that_starts_before_the_first_image_starts_before_the_take(takes, tmp_path, monkeypatch):
    with wave.open(str(tmp_path / "sound.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(2 * 8000 * 2))
    save_take(performance(), tmp_path / "a.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "a.facetake"))
    scene = bpy.context.scene
    scene.sync_mode = "NONE"
    monkeypatch.setattr(bake, "sound_lead", lambda path: 0.48)
    assert bpy.ops.facemime.add_sound(filepath=str(tmp_path / "sound.wav")) == {"FINISHED"}
    editor = scene.sequence_editor
    (strip,) = editor.strips if hasattr(editor, "strips") else editor.sequences
    assert strip.frame_start == pytest.approx(1.0 - 0.48 * 25) and scene.sync_mode == "AUDIO_SYNC"

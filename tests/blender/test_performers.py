"""The performer's face is in the .blend file only on request."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.puppet.performer import Performer
from facemime.core.puppet.sources import TakePlayer
from facemime.core.takes.neutral import calibrate
from facemime.sessions import calibrating
from facemime.settings.performers import read_calibration, stored_performers, write_calibration
from tests.helpers.live_ticks import start, ticks_until
from tests.helpers.takes import performance

NEUTRAL = replace(calibrate(performance()), asked=True)


@pytest.fixture
def settings(in_a_project):
    return bpy.context.scene.facemime


def saved_and_opened():
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    return bpy.context.scene.facemime


def test_a_calibration_is_for_the_session_and_not_in_the_file(settings):
    write_calibration(settings, NEUTRAL)
    settings = saved_and_opened()
    assert [performer.name for performer in settings.performers] == ["Performer 1"] and not stored_performers()
    np.testing.assert_array_equal(read_calibration(settings).shape, NEUTRAL.shape)


def test_a_calibration_is_kept_in_the_file_on_request_and_removed_by_a_button(settings):
    write_calibration(settings, NEUTRAL)
    settings.keep_calibrations = True
    settings = saved_and_opened()
    assert len(stored_performers()) == 1
    assert bpy.ops.facemime.clear_calibrations() == {"FINISHED"}
    settings = saved_and_opened()
    assert not stored_performers() and not settings.keep_calibrations
    assert not bpy.ops.facemime.clear_calibrations.poll()
    np.testing.assert_array_equal(read_calibration(settings).shape, NEUTRAL.shape)


def test_a_calibration_made_after_the_request_is_kept_as_well_until_it_is_withdrawn(settings):
    settings.keep_calibrations = True
    write_calibration(settings, NEUTRAL)
    assert len(stored_performers()) == 1
    settings.keep_calibrations = False
    settings = saved_and_opened()
    assert not stored_performers() and read_calibration(settings) is not None


def test_a_calibration_that_an_earlier_version_stored_stays_in_the_file(settings):
    write_calibration(settings, NEUTRAL)
    settings.performers[0].calibration = json.dumps(NEUTRAL.to_dict())
    saved_and_opened()
    assert len(stored_performers()) == 1


def test_the_button_removes_faces_of_all_scenes_and_of_files_from_before(settings):
    write_calibration(settings, NEUTRAL)
    settings.keep_calibrations = True
    saved_and_opened()
    bpy.ops.scene.new(type="FULL_COPY")
    assert len(stored_performers()) == 2
    assert bpy.ops.facemime.clear_calibrations() == {"FINISHED"} and not stored_performers()


def test_resetting_forgets_the_face_in_the_session_and_in_the_file(settings):
    settings.keep_calibrations = True
    write_calibration(settings, NEUTRAL)
    assert bpy.ops.facemime.reset_calibration() == {"FINISHED"}
    assert read_calibration(settings) is None and not stored_performers()


def test_what_a_camera_teaches_about_the_performer_is_not_written_to_the_file(settings, take, monkeypatch):
    monkeypatch.setattr(calibrating, "_KEEPING", 0.0)
    monkeypatch.setattr(Performer, "learnt", property(lambda _: NEUTRAL))
    monkeypatch.setattr("facemime.sessions.start.open_source", lambda _: TakePlayer(take, "camera", loop=True))
    settings.source.kind = "CAMERA"
    bpy.ops.facemime.reset_calibration()
    add_head(bpy.context)
    start()
    ticks_until(lambda: read_calibration(settings) is not None)
    bpy.ops.facemime.stop_puppet()
    assert not stored_performers() and settings.performers[0].calibration == ""


OTHER = replace(NEUTRAL, shape=NEUTRAL.shape * 1.1)


def test_a_copied_scene_keeps_the_performers_of_the_first_as_they_were(settings):
    write_calibration(settings, NEUTRAL)
    bpy.ops.scene.new(type="FULL_COPY")
    copied = bpy.context.scene.facemime
    np.testing.assert_array_equal(read_calibration(copied).shape, NEUTRAL.shape)
    write_calibration(copied, OTHER)
    np.testing.assert_array_equal(read_calibration(settings).shape, NEUTRAL.shape)
    np.testing.assert_array_equal(read_calibration(copied).shape, OTHER.shape)


@pytest.mark.parametrize("kept", [False, True])
def test_a_file_saved_under_another_name_has_performers_of_its_own(settings, tmp_path, kept):
    settings.keep_calibrations = kept
    write_calibration(settings, NEUTRAL)
    bpy.ops.wm.save_mainfile()
    first, second = bpy.data.filepath, str(tmp_path / "second.blend")
    bpy.ops.wm.save_as_mainfile(filepath=second)
    np.testing.assert_array_equal(read_calibration(bpy.context.scene.facemime).shape, NEUTRAL.shape)
    write_calibration(bpy.context.scene.facemime, OTHER)
    bpy.ops.wm.save_mainfile()
    for path, own in ((first, NEUTRAL), (second, OTHER)):
        bpy.ops.wm.open_mainfile(filepath=path)
        np.testing.assert_array_equal(read_calibration(bpy.context.scene.facemime).shape, own.shape)

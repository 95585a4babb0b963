"""Sources and calibrations of a live session: where they are stored, and their errors."""

import os

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.operators.puppet import FACEMIME_OT_puppet, running
from facemime.settings.performers import calibration_of, forget, read_calibration
from facemime.settings.preferences import preferences
from facemime.ui.status import status_lines, summary
from tests.helpers.live_ticks import start, tick, ticks_until, wait_for
from tests.helpers.owners import UNDER_WINE

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def test_each_performer_has_a_calibration(take):
    add_head(bpy.context)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    assert [performer.name for performer in settings.performers] == ["Performer 1"]
    with pytest.raises(RuntimeError):
        bpy.ops.facemime.calibrate()
    bpy.ops.facemime.add_performer(name="Ada")
    assert read_calibration(settings) is None
    start()
    assert bpy.ops.facemime.calibrate(countdown=0.05) == {"FINISHED"}
    assert running().countdown is not None
    ticks_until(lambda: calibration_of(settings.performers[1]))
    assert settings.performer == 1 and running().worker.first.quality is not None
    np.testing.assert_array_equal(read_calibration(settings).shape, running().worker.first.neutral.shape)
    bpy.ops.facemime.stop_puppet()
    bpy.ops.facemime.remove_performer()
    assert [performer.name for performer in settings.performers] == ["Performer 1"]


@pytest.fixture
def preferred():
    """The preferences, whose camera is reset afterwards."""
    yield preferences()
    preferences().property_unset("camera")


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        ("VIDEO", "", "No video is selected"),
        ("VIDEO", "none.mp4", "There is no file"),
        ("PICTURES", "none", "There is no folder"),
        ("PICTURES", "a\udcff", "There is no folder"),
        ("PICTURES", "x" * 300, "There is no folder"),
        ("TAKE", "x" * 300, "There is no take" if UNDER_WINE else "file name too long"),
        ("TAKE", "none.facetake", "There is no take"),
        ("CAMERA", "http://phone:8080/video", "Online Access"),
        ("CAMERA", "http:phone/video", "Online Access"),
        ("CAMERA", "TCP:phone", "Online Access"),
        ("CAMERA", "/dev/none", "cannot be opened"),
    ],
)
def test_a_missing_source_is_reported_and_leaves_the_head_unchanged(tmp_path, preferred, kind, name, message):
    head = add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind = kind
    path = name if ":" in name or not name else str(tmp_path / name)
    source.video = source.folder = source.take = path
    preferred.camera = path.encode(errors="replace").decode()
    reports = []
    try:
        outcome = bpy.ops.facemime.puppet()
    except RuntimeError as error:
        reports, outcome = [str(error)], {"CANCELLED"}
    if outcome == {"RUNNING_MODAL"}:
        session = running()
        wait_for(lambda: session.worker.error is not None)
        reports = [str(session.worker.error)]
        assert tick() == {"CANCELLED"}
    assert message in reports[0]
    assert running() is None and head.data.shape_keys is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes as POSIX has them")
def test_while_a_camera_is_opened_the_panel_says_so(tmp_path, preferred):
    """A pipe that nobody writes to stands for a camera that takes long to open."""
    os.mkfifo(tmp_path / "camera")
    add_head(bpy.context)
    bpy.context.scene.facemime.source.kind = "CAMERA"
    preferred.camera = str(tmp_path / "camera")
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    assert summary(running())[0].startswith("Opening the camera ...")
    assert status_lines(running())[-1][0].startswith("Opening the camera ...")
    bpy.ops.facemime.stop_puppet()


def test_buttons_are_enabled_only_when_they_can_run(looping):
    assert not FACEMIME_OT_puppet.poll(bpy.context)
    add_head(bpy.context)
    assert FACEMIME_OT_puppet.poll(bpy.context)
    assert not bpy.ops.facemime.stop_puppet.poll() and not bpy.ops.facemime.calibrate.poll()
    bpy.ops.facemime.puppet()
    assert not FACEMIME_OT_puppet.poll(bpy.context) and bpy.ops.facemime.stop_puppet.poll()


def test_a_damaged_calibration_is_reported(take):
    add_head(bpy.context)
    performer = bpy.context.scene.facemime.performers[0]
    forget(performer)
    performer.calibration = '{"shape": 3}'
    with pytest.raises(RuntimeError, match="Calibrate again"):
        bpy.ops.facemime.puppet()

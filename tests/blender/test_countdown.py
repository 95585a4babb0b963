"""A recording may start after a countdown, which Esc cancels, and performers hear cues that they cannot see."""

import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import bpy
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.operators import puppet
from facemime.operators.puppet import running
from facemime.sessions.calibrating import beep
from facemime.settings.preferences import preferences
from facemime.ui.status import countdown_text
from tests.helpers.live_ticks import TIMER, let_a_frame_come, start, tick, ticks_until

pytestmark = pytest.mark.usefixtures("in_a_project", "looping")
ESC = SimpleNamespace(type="ESC", value="PRESS", ctrl=False, oskey=False, mouse_x=0, mouse_y=0)


@pytest.fixture
def beeps(monkeypatch):
    """Times at which a sound was played."""
    heard = []
    monkeypatch.setattr("facemime.sessions.calibrating.beep", lambda: heard.append(time.perf_counter()))
    return heard


@pytest.fixture
def puppet_running():
    """A puppet whose recordings have a countdown."""
    add_head(bpy.context)
    start()
    bpy.context.scene.facemime_takes.countdown = "3"


def test_a_recording_starts_after_the_countdown_with_a_beep(puppet_running, beeps):
    session = running()
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    assert session.recorder.recording is None and 0.0 < session.countdown <= 3.0 and "recording starts" in session.task
    bpy.context.scene.name = "Renamed"
    session.recorder.delayed = replace(session.recorder.delayed, at=time.perf_counter() - 1.0)
    ticks_until(lambda: session.recorder.recording is not None and session.recorder.recording.frames > 2)
    assert session.countdown is None and len(beeps) == 1
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    assert len(bpy.context.scene.facemime_takes.items) == 1


def test_by_default_there_is_a_countdown_before_a_performer_and_none_before_a_video(puppet_running):
    session, takes = running(), bpy.context.scene.facemime_takes
    takes.property_unset("countdown")
    bpy.ops.facemime.record_take()
    assert session.countdown is None and session.recorder.recording is not None
    bpy.ops.facemime.record_take()
    session.worker.source, video = StreamSource(StreamSettings()), session.worker.source
    try:
        bpy.ops.facemime.record_take()
        assert session.recorder.recording is None and 0.0 < session.countdown <= 3.0
    finally:
        session.worker.source.close()
        session.worker.source = video


def test_esc_in_the_viewport_cancels_the_countdown_and_not_the_puppet(puppet_running, monkeypatch):
    monkeypatch.setattr(puppet, "viewport_under", lambda *_: True)
    bpy.ops.facemime.record_take()
    assert tick(ESC) == {"RUNNING_MODAL"} and running() is not None and running().countdown is None
    assert tick(ESC) == {"FINISHED"} and running() is None


def test_the_button_cancels_the_countdown(puppet_running, beeps):
    bpy.ops.facemime.record_take()
    bpy.ops.facemime.record_take()
    assert running().countdown is None and running().recorder.recording is None and not beeps


@pytest.mark.thorough
@pytest.mark.parametrize("sounds", [True, False])
def test_the_end_of_a_calibration_is_heard_if_sounds_are_wanted(puppet_running, beeps, sounds):
    preferences().sounds = sounds
    session = running()
    session.calibrating.begin(countdown=0.0)
    ticks_until(lambda: session.countdown is None)
    assert len(beeps) == sounds
    preferences().property_unset("sounds")


def test_the_countdown_continues_in_the_viewport_without_frames(puppet_running, monkeypatch):
    session, redrawn = running(), []
    session.calibrating.begin(countdown=60.0)
    ticks_until(lambda: not session.step())
    monkeypatch.setattr(puppet, "redraw", lambda context, kind: redrawn.append(kind))
    session.operator._redrawn_at = -1.0
    tick()
    assert "WINDOW" in redrawn


@pytest.mark.parametrize(("range_of", "asked"), [(False, "Hold Still"), (True, "Now")])
def test_at_the_end_of_a_countdown_the_performer_is_told_what_to_do(puppet_running, range_of, asked):
    session = running()
    session.calibrating.begin(range_of=range_of, countdown=2.5)
    assert countdown_text(session) == "3"
    session.calibrating.begin(range_of=range_of, countdown=0.0)
    assert countdown_text(session) == asked


def test_a_beep_without_an_audio_device_is_not_an_error():
    assert beep() in (True, False)


@pytest.mark.thorough
def test_a_slow_redraw_is_named_as_the_slowest_step(puppet_running):
    session = running()
    for _ in range(14):
        number = session._number
        while session._number == number:
            let_a_frame_come()
            session.operator.modal(bpy.context, TIMER)
        time.sleep(0.06)
    session.step()
    assert session.stopwatch.slowest() == "redraw"


def test_blender_built_without_sound_stays_silent(monkeypatch):
    monkeypatch.setitem(sys.modules, "aud", None)
    assert not beep()

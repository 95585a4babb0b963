"""The worker tracks the newest frame, drives heads, and survives failures of sources and disks."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import facemime
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import OutputError, SourceError
from facemime.core.face.landmarks import LOWER_LIDS, LOWER_LIPS, UPPER_LIDS, lid_gaps
from facemime.core.files.capture import VideoSource
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet import worker as worker_module
from facemime.core.puppet.outputs import LiveHead
from facemime.core.puppet.performer import RangeCalibration
from facemime.core.puppet.sources import LiveFrame, LiveSource, TakePlayer, VideoPlayer
from facemime.core.puppet.timing import STAGES, Delays, Stopwatch
from facemime.core.puppet.worker import LiveOptions, LiveWorker
from facemime.core.takes.face_space import load_face_space
from facemime.core.takes.neutral import calibrate
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.clocks import PATIENCE, EagerClock, wait_for
from tests.helpers.takes import make_take, performance

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


class Listed(LiveSource):
    """Delivers given items, one per read: frames, errors to raise, or None."""

    name = "list"

    def __init__(self, things):
        self._things = list(things)
        self.closed = False

    def read(self, timeout):
        if not self._things:
            self.ended = True
            return None
        thing = self._things.pop(0)
        if isinstance(thing, Exception):
            raise thing
        return thing

    def close(self):
        self.closed = True


class Recorded(list):
    """Keeps recorded frames; full after `room` frames."""

    def __init__(self, room=10**9):
        super().__init__()
        self.room, self.closed = room, False

    def append(self, frame, result):
        if len(self) >= self.room:
            raise OutputError("The disk is full. Free some space.")
        super().append((frame.time, result))

    def flush(self):
        pass

    def close(self):
        self.closed = True


def frames_of(take) -> list[LiveFrame]:
    """Return the frames of a take as a source delivers them."""
    return [LiveFrame(float(t), None, take.result(i)) for i, t in enumerate(take.times)]


def run(worker: LiveWorker) -> LiveWorker:
    """Start a worker, and wait for the end of its source."""
    worker.start()
    wait_for(lambda: not worker.running)
    return worker


def test_heads_equal_those_without_a_worker():
    take, rig = performance(), built_in_head()
    neutral = calibrate(take)
    options = DriveSettings(strength_middle=0.5, strength_lower=1.2)
    worker = run(
        LiveWorker(
            Listed(frames_of(take)),
            neutral=neutral,
            heads=(LiveHead(rig), LiveHead(rig, options)),
            options=LiveOptions(smoothing=0.0),
        )
    )
    last = take.result(len(take) - 1)
    assert worker.latest.number == worker.counts.tracked == len(take) and worker.counts.lost == 1
    for head, wanted in zip(worker.latest.heads, (DriveSettings(), options), strict=True):
        np.testing.assert_array_equal(head.vertices, HeadDriver(rig, neutral, wanted).frame(last).vertices)


def test_a_real_clip_is_tracked_as_offline():
    source = VideoPlayer(SAMPLE)
    source.pace = EagerClock()
    worker = LiveWorker(source, heads=(LiveHead(built_in_head()),), options=LiveOptions(smoothing=0.0, preview=160))
    recorded = Recorded()
    worker.record(recorded)
    worker.start()
    wait_for(lambda: worker.counts.tracked >= 8)
    worker.close()
    tracker = FaceTracker.load()
    with VideoSource(SAMPLE) as video:
        for (at, result), frame in zip(recorded, video, strict=False):
            assert at == pytest.approx(frame.time)
            np.testing.assert_allclose(result.landmarks, tracker.track(frame.image).landmarks, atol=1e-6)
    assert len(recorded) >= 8 and recorded.closed and source.read(0.0) is None
    assert worker.latest.preview.shape == (120, 160, 4) and worker.latest.preview.dtype == np.float32


def test_without_a_neutral_the_first_second_with_a_face_is_used():
    take = performance()
    worker = run(LiveWorker(Listed(frames_of(take)), heads=(LiveHead(built_in_head()),)))
    assert worker.first.neutral is not None and len(worker.latest.heads) == 1
    first = take.part(take.times <= 1.0 + 1e-9)
    np.testing.assert_allclose(worker.first.neutral.shape, calibrate(first).shape, atol=1e-3)


def test_an_error_before_the_first_frame_ends_the_worker_and_later_ones_are_retried():
    first = run(LiveWorker(Listed([SourceError("no camera. Plug one in.")])))
    assert "no camera" in str(first.error)
    frames = frames_of(performance())
    later = run(LiveWorker(Listed([*frames[:3], SourceError("gone. Plug it in."), *frames[3:6]])))
    assert later.error is None and later.counts.tracked == 6 and later.message == ""


def test_a_missing_source_is_reported_until_it_returns():
    frames = frames_of(performance())
    worker = run(LiveWorker(Listed([*frames[:3], SourceError("gone. Plug it in.")])))
    assert worker.message == "gone. Plug it in."


def test_a_full_disk_ends_the_recording_and_not_the_puppet():
    worker = LiveWorker(Listed(frames_of(performance())))
    recorded = Recorded(room=5)
    worker.record(recorded)
    run(worker)
    assert "disk is full" in str(worker.recording_error)
    assert len(recorded) == 5 and worker.counts.tracked == 60 and worker.error is None


def test_pending_frames_are_written_when_no_frame_comes():
    frames, recorded = frames_of(performance())[:8], Recorded()
    worker = LiveWorker(Listed([*frames[:5], None, *frames[5:]]), options=LiveOptions(smoothing=0.0))
    worker.record(recorded)
    flushed = []
    recorded.flush = lambda: flushed.append(len(recorded))
    run(worker)
    assert flushed[0] == 5 and len(recorded) == 8


def test_recordings_contain_unsmoothed_results():
    take, recorded = performance(), Recorded()
    worker = LiveWorker(Listed(frames_of(take)), options=LiveOptions(smoothing=1.0))
    worker.record(recorded)
    run(worker)
    np.testing.assert_array_equal([r.landmarks for _, r in recorded], take.landmarks)


def test_options_and_heads_may_change_and_deformers_are_reused():
    take, rig = performance(), built_in_head()
    source = TakePlayer(take, "take", loop=True)
    source.pace = EagerClock()
    worker = LiveWorker(source, neutral=calibrate(take), heads=(LiveHead(rig),))
    worker.start()
    wait_for(lambda: worker.latest is not None and worker.latest.heads)
    deformer = worker._drivers.drivers[0].deformer
    worker.heads = (LiveHead(rig, DriveSettings(strength_upper=0.0, strength_middle=0.0, strength_lower=0.0)),)
    at_rest = rig.vertices
    wait_for(lambda: worker.latest.heads and np.abs(worker.latest.heads[0].vertices - at_rest).max() < 1e-6)
    assert worker._drivers.drivers[0].deformer is deformer
    worker.heads = (LiveHead(rig, DriveSettings(kernel="gaussian")),)
    wait_for(lambda: worker._drivers.drivers[0].deformer is not deformer)
    worker.close()


def test_calibration_uses_the_next_second_and_is_rejected_if_the_performer_moves():
    take = performance(200)
    still = calibrate(take)
    worker = LiveWorker(Listed(frames_of(take)), neutral=still)
    worker.calibrate()
    run(worker)
    assert worker.first.quality.good and worker.first.neutral is not still and not worker.first.calibrating
    rng = np.random.default_rng(1)
    shaken = make_take(take.shape[:30] + rng.normal(0.0, 0.05, take.shape[:30].shape))
    restless = LiveWorker(Listed(frames_of(shaken)), neutral=still)
    restless.calibrate()
    assert "moved" in run(restless).first.quality.message


def test_a_calibration_with_a_held_expression_asks_for_a_relaxed_face():
    neutral, space = calibrate(performance(), 0.0), load_face_space()
    opened = neutral.shape + space.units[np.argmax(space.amount(np.eye(len(space.units))))]
    held = LiveWorker(Listed(frames_of(make_take(np.array([opened] * 40)))), neutral=neutral)
    held.calibrate()
    assert "expression" in run(held).first.quality.message


def test_calibration_without_a_face_is_reported_and_keeps_the_neutral_face():
    take = performance()
    blind = make_take(take.shape[:40], found=np.zeros(40, bool))
    worker = LiveWorker(Listed(frames_of(blind)), neutral=calibrate(take))
    before = worker.first.neutral
    worker.calibrate()
    run(worker)
    assert not worker.first.quality.good and worker.first.neutral is before


def test_the_range_of_eyes_and_mouth_is_learnt_and_missing_parts_are_requested():
    neutral = calibrate(performance(), 0.0)
    shut, opened = neutral.shape.copy(), neutral.shape.copy()
    shut[UPPER_LIDS, 1] += 0.9 * lid_gaps(neutral.shape)
    opened[LOWER_LIPS, 1] += 0.3
    said = []
    for shown in ([], [shut] * 20, [shut] * 20 + [opened] * 20):
        take = make_take(np.array([neutral.shape] * 70 + shown))
        calibration = RangeCalibration(neutral)
        assert [calibration.add(float(t), take.result(i)) for i, t in enumerate(take.times)].count(True) <= 11
        said.append(calibration.quality())
    assert [quality.good for quality in said] == [False, False, True]
    assert "No closed eyes seen" in said[0].message and "mouth was hardly opened" in said[1].message
    learnt = calibration.neutral()
    assert learnt.shut == pytest.approx(0.1, abs=0.02) and learnt.mouth_gain > 1.1


def test_the_stopwatch_names_the_slow_stage():
    watch = Stopwatch()
    assert watch.slowest() == "" and np.isnan(watch.latency) and watch.medians() == {}
    for _ in range(5):
        watch.add(Delays((0.001, 0.002, 0.001, 0.001, 0.001)))
    assert watch.slowest() == "" and watch.latency == pytest.approx(0.006)
    for _ in range(20):
        watch.add(Delays((0.001, 0.02, 0.001, 0.001, 0.001)))
    assert watch.slowest() == "track" and watch.rate > 0
    assert set(watch.percentiles(50.0, 95.0)) == {*STAGES, "total"}


class Stuck(Listed):
    """Blocks in `read` until it is released, like a hanging driver or disk."""

    def __init__(self):
        super().__init__([])
        self.asked, self.let_go = threading.Event(), threading.Event()

    def read(self, timeout):
        self.asked.set()
        self.let_go.wait()
        return None


def test_a_source_that_does_not_respond_is_abandoned(monkeypatch):
    monkeypatch.setattr(worker_module, "_ENDING", 0.1)
    source = Stuck()
    worker = LiveWorker(source)
    worker.start()
    assert source.asked.wait(PATIENCE)
    worker.close()
    assert worker.running and source.closed
    source.let_go.set()
    wait_for(lambda: not worker.running)
    assert worker.error is None


def test_a_disk_that_does_not_respond_is_an_error(monkeypatch):
    monkeypatch.setattr(worker_module, "_ENDING", 0.1)
    writing, let_go = threading.Event(), threading.Event()
    recorded = Recorded()
    recorded.append = lambda *frame: writing.set() or let_go.wait()
    worker = LiveWorker(Listed(frames_of(performance())))
    worker.record(recorded)
    worker.start()
    assert writing.wait(PATIENCE)
    with pytest.raises(OutputError, match="does not respond"):
        worker.close()
    let_go.set()
    wait_for(lambda: not worker.running)
    worker.close()
    assert recorded.closed


def blinks(count: int = 240):
    """Frames of a performer at rest who blinks every second without closing the lids completely."""
    take = performance(count)
    shapes = np.tile(take.shape[0], (count, 1, 1))
    for start in range(40, count - 3, 25):
        shapes[start : start + 3, UPPER_LIDS, 1] += 0.8 * (
            shapes[start : start + 3, LOWER_LIDS, 1] - shapes[start : start + 3, UPPER_LIDS, 1]
        )
    return make_take(shapes)


@pytest.mark.parametrize("wanted", [True, False])
def test_where_eyes_are_shut_is_learnt_in_a_live_session_unless_turned_off(wanted):
    options = LiveOptions(smoothing=0.0, learn=wanted)
    worker = run(LiveWorker(Listed(frames_of(blinks())), heads=(LiveHead(built_in_head()),), options=options))
    assert (worker.first.neutral.shut > 0.1) == wanted and (worker.first.learnt is worker.first.neutral) == wanted


def test_a_take_is_shown_with_the_neutral_face_it_began_with():
    source = TakePlayer(blinks(), "take")
    source.pace = EagerClock()
    assert run(LiveWorker(source, options=LiveOptions(smoothing=0.0))).first.neutral.shut == 0.0


def test_the_learnt_neutral_face_is_forgotten_on_request():
    take, asked = blinks(), replace(calibrate(performance()), shut=0.3, asked=True)
    worker = LiveWorker(Listed(frames_of(take)), neutral=asked, options=LiveOptions(smoothing=0.0))
    worker.forget()
    run(worker)
    assert not worker.first.neutral.asked and worker.first.neutral.shut == pytest.approx(0.2, abs=0.05)

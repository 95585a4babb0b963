"""Over real sockets, faces arrive, are played and return to rest at the end, and strangers change nothing."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import closing
from itertools import count

import numpy as np
import pytest

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENT_MIRROR, N_COEFFICIENTS
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.outputs import LiveHead
from facemime.core.puppet.sources import LiveFrame
from facemime.core.puppet.worker import LiveOptions, LiveWorker
from facemime.core.streams.playout import EASE, HOLD
from facemime.core.streams.sender import SENT, moved_from, turned_from
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.core.streams.transport.security import write_key
from facemime.core.takes.measured import coefficient_face
from facemime.core.takes.neutral import calibrate
from tests.helpers.clocks import PATIENCE
from tests.helpers.links import collected, free_port, recorded, sender_to, streamed
from tests.helpers.takes import coefficient_take as acted
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

RATE = 60.0


# Sent faces, recorded and baked, to the precision of the protocol


@pytest.mark.parametrize(("protocol", "precision"), [("own", 2e-5), ("vmc", 1e-5), ("livelink", 1e-5)])
def test_a_recorded_stream_of_coefficients_bakes_to_what_was_sent(opened, tmp_path, protocol, precision):
    take, source = acted(), opened(protocol)
    sender, neutral = sender_to(source, expressions="arkit"), coefficient_face().neutral
    frames = streamed(source, take, lambda n: sender.send(take.times[n], take.result(n), neutral))
    sender.close()
    saved = recorded(frames, tmp_path / "stream.facetake")
    np.testing.assert_allclose(np.diff(saved.times), np.diff(take.times), atol=1e-6)
    np.testing.assert_allclose(arkit_coefficients(saved, calibrate(saved)), take.coefficients, atol=precision)
    np.testing.assert_allclose(saved.pose[:, 1:4], take.pose[:, 1:4], atol=2e-5)
    np.testing.assert_allclose(saved.shape, take.shape, atol=2e-4)


def test_left_and_right_of_a_face_can_be_swapped_without_its_rotation(opened):
    result, shown = acted().result(5), []
    for swap in (False, True):
        source = opened("livelink", swap=swap)
        sender, times = sender_to(source), count()
        (frame, *_) = collected(
            source, 1, lambda s=sender, t=times: s.send(next(t) / 60.0, result, coefficient_face().neutral)
        )
        sender.close()
        shown.append(frame.result)
    plain, swapped = shown
    np.testing.assert_allclose(swapped.coefficients, plain.coefficients[COEFFICIENT_MIRROR], atol=1e-6)
    np.testing.assert_allclose(swapped.gaze, plain.gaze * (1.0, -1.0), atol=1e-5)
    np.testing.assert_allclose(swapped.pose[1:4], plain.pose[1:4], atol=1e-5)
    assert not np.allclose(swapped.coefficients, plain.coefficients)


@pytest.mark.parametrize("protocol", first_of(["own", "openseeface"]))
def test_a_recorded_stream_of_landmarks_is_what_was_tracked(opened, tmp_path, protocol):
    whole = performance()
    take, source = whole.part(whole.found), opened(protocol)
    sender = sender_to(source)
    frames = streamed(source, take, lambda n: sender.send(take.times[n], take.result(n), None))
    sender.close()
    saved = recorded(frames, tmp_path / "stream.facetake")
    np.testing.assert_allclose(saved.shape, take.shape, atol=2.0**-13)
    np.testing.assert_allclose(np.diff(saved.times), np.diff(take.times), atol=1e-6)
    if protocol == "own":
        np.testing.assert_allclose(saved.pose, take.pose, rtol=1e-5, atol=1e-2)


# Lost and found


def test_a_stream_that_ends_is_held_returns_to_rest_and_resumes_by_itself():
    take, neutral, now = acted(), coefficient_face().neutral, [0.0]
    source = StreamSource(StreamSettings("livelink", port=free_port()), clock=lambda: now[0], every=True)
    source.read(0.0)
    sender = sender_to(source)

    def until(end: float) -> list[LiveFrame]:
        """Return what is played until then, read 60 times per second on the test's own clock."""
        frames = []
        while now[0] < end:
            now[0] += 1.0 / RATE
            frames += iter(lambda: source.read(0.0), None)
        return frames

    def sent(numbers: list[int]) -> list[LiveFrame]:
        """Return what is played while some frames are sent."""
        frames = []
        for number in numbers:
            before, patience = source.counts.accepted, time.monotonic() + PATIENCE
            sender.send(now[0], take.result(number), neutral)
            while source.counts.accepted == before and time.monotonic() < patience:
                frames += [frame for frame in [source.read(0.0)] if frame is not None]
            frames += until(now[0] + 1.0 / RATE)
        return frames

    with closing(source), closing(sender):
        live = sent(list(range(len(take))))
        assert live and all(frame.rest == 0.0 for frame in live)
        ended = now[0]
        rests = [(frame.taken - ended, frame.rest) for frame in until(ended + HOLD + EASE + 0.5) if frame.filled]
        assert max(rest for at, rest in rests if at < 0.8 * HOLD) == 0.0
        shares = [rest for _, rest in rests]
        assert shares == sorted(shares) and shares[-1] == 1.0
        back = [frame for frame in sent([5]) + until(now[0] + 0.1) if not frame.filled]
        assert back[0].rest > 0.5 and back[0].time > live[-1].time
        assert sent(list(range(30)) * 2)[-1].rest == 0.0


def test_a_puppet_returns_to_rest_in_the_worker_without_recording_it(opened):
    class Recorder:
        times: list[float] = []

        def append(self, frame, result):
            self.times.append(frame.time)

        def flush(self): ...

        def close(self): ...

    source, take = opened("livelink"), acted(20)
    sender = sender_to(source)
    worker = LiveWorker(source, heads=(LiveHead(built_in_head(), DriveSettings()),), options=LiveOptions(smoothing=0.0))
    worker.record(Recorder())
    worker.start()
    try:
        began = time.monotonic()
        while worker.latest is None or worker.latest.result.coefficients[COEFFICIENT_INDEX["jawOpen"]] < 0.1:
            number = int((time.monotonic() - began) * RATE) % len(take)
            sender.send(time.monotonic() - began, take.result(number), coefficient_face().neutral)
            time.sleep(1.0 / RATE)
            assert time.monotonic() - began < PATIENCE
        while (
            worker.counts.tracked <= len(Recorder.times)
            or np.abs(worker.latest.result.shape - coefficient_face().neutral.shape).max() > 1e-9
        ):
            time.sleep(0.05)
            assert time.monotonic() - began < PATIENCE
        assert worker.first.neutral.measured
        vertices = worker.latest.heads[0].vertices
        assert np.abs(vertices - built_in_head().all_vertices).max() < 1e-4
        assert Recorder.times == sorted(set(Recorder.times))
    finally:
        worker.close()
        sender.close()
    assert not worker.running


# Security, and strangers


def test_with_a_key_only_senders_that_have_it_get_through(opened, tmp_path):
    for name in ("shared.key", "other.key"):
        write_key(tmp_path / name)
    source, take = opened(key=tmp_path / "shared.key"), acted()
    stranger, anybody = sender_to(source, key=tmp_path / "other.key"), sender_to(source)
    friend = sender_to(source, key=tmp_path / "shared.key")

    def send(number: int) -> None:
        for each in (stranger, anybody, friend):
            each.send(take.times[number] + 1.0, take.result(number), None)

    began = time.monotonic()

    def feed() -> None:
        send(min(int((time.monotonic() - began) * RATE) % len(take), len(take) - 1))
        time.sleep(1.0 / RATE)

    frames = collected(source, 5, feed)
    assert stranger.sent == 0 and anybody.sent > 0 and friend.sent > 0
    assert frames and source.counts.refused > 5 and len(source.senders) == 1
    for each in (stranger, anybody, friend):
        each.close()


def test_senders_are_distinguished_and_one_is_followed_until_it_ends(opened):
    source, take = opened("livelink"), acted()
    neutral = coefficient_face().neutral
    one, other = (sender_to(source, subject=name) for name in ("One", "Other"))

    def both(number: int) -> None:
        one.send(take.times[number], take.result(0), neutral)
        other.send(take.times[number] + 50.0, take.result(20), neutral)

    frames = streamed(source, take, both)
    assert {float(frame.result.coefficients.sum()) for frame in frames} == {float(take.result(0).coefficients.sum())}
    assert source.senders == ("127.0.0.1 One", "127.0.0.1 Other")
    began = time.monotonic()

    def only_other() -> None:
        other.send(60.0 + time.monotonic() - began, take.result(20), neutral)
        time.sleep(1.0 / RATE)

    frames = collected(source, 10, only_other)
    assert frames[-1].result.coefficients.sum() == pytest.approx(take.result(20).coefficients.sum(), abs=1e-5)
    one.close()
    other.close()


def test_two_senders_drive_two_heads_in_one_worker(opened):
    source, take = opened("livelink", senders=("", "Ada")), acted(20)
    neutral, rig = coefficient_face().neutral, built_in_head()
    ada, ben = (sender_to(source, subject=name) for name in ("Ada", "Ben"))
    still = coefficient_face().result(np.zeros(N_COEFFICIENTS), np.zeros(3), None)
    recorded: list[LiveFrame] = []

    class Recorder:
        def append(self, frame, result):
            recorded.append(frame)

        def flush(self): ...

        def close(self): ...

    heads = (LiveHead(rig, DriveSettings()), LiveHead(rig, DriveSettings()))
    worker = LiveWorker(source, heads=heads, options=LiveOptions(smoothing=0.0))
    worker.record(Recorder())
    worker.start()
    try:
        began = time.monotonic()
        while len(recorded) < 40 or len({frame.sender for frame in recorded}) < 2:
            ada.send(time.monotonic() - began, take.result(10), neutral)
            ben.send(time.monotonic() - began + 500.0, still, neutral)
            time.sleep(1.0 / RATE)
            assert time.monotonic() - began < PATIENCE
        moved = [np.abs(frame.vertices - rig.all_vertices).max() for frame in worker.latest.heads]
    finally:
        worker.close()
        ada.close()
        ben.close()
    assert worker.error is None and moved[0] < 1e-4 < 1e-3 < moved[1]
    assert {(frame.sender, frame.heads) for frame in recorded} == {("127.0.0.1 Ada", (1,)), ("127.0.0.1 Ben", (0,))}
    times = {name: [f.time for f in recorded if f.sender == name] for name in {f.sender for f in recorded}}
    assert all(each == sorted(set(each)) for each in times.values())
    off = abs(times["127.0.0.1 Ada"][-1] - times["127.0.0.1 Ben"][-1])
    assert off < 5.0, "the senders' own clocks differ by 500 s"


def test_a_chosen_sender_is_the_only_one_that_is_played(opened):
    source, take = opened("livelink", sender="Other"), acted()
    neutral = coefficient_face().neutral
    one, other = (sender_to(source, subject=name) for name in ("One", "Other"))

    def both(number: int) -> None:
        one.send(take.times[number], take.result(0), neutral)
        other.send(take.times[number], take.result(20), neutral)

    frames = streamed(source, take, both)
    assert all(frame.result.coefficients.sum() > 0.5 for frame in frames)
    one.close()
    other.close()


@pytest.mark.parametrize("protocol", first_of(["own", "livelink", "vmc", "openseeface", "facecap"], 2))
def test_malformed_packets_are_counted_and_disturb_no_other_sender(opened, protocol):
    source, take = opened(protocol), acted()
    rng = np.random.default_rng(0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(300):
            out.sendto(rng.bytes(int(rng.integers(0, 3000))), source.address)
            source.read(0.0)
    assert source.counts.malformed + source.counts.refused >= 290 and source.counts.accepted == 0
    if protocol in SENT:
        sender = sender_to(source)
        frames = streamed(
            source, take, lambda n: sender.send(take.times[n], take.result(n), coefficient_face().neutral)
        )
        assert len(frames) == len(take)
        sender.close()


def test_a_flood_of_packets_is_not_processed(opened, monkeypatch):
    source = opened("livelink")
    monkeypatch.setattr("facemime.core.streams.source._RATE", 0.0)
    monkeypatch.setattr("facemime.core.streams.source._BURST", 20.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for _ in range(200):
            out.sendto(b"x" * 50, source.address)
            source.read(0.0)
    assert source.counts.malformed == 20 and source.counts.flooded == 180


# Opening and closing


def test_closing_wakes_a_reader_and_leaves_no_thread(opened):
    before, source = threading.active_count(), opened()
    reader = threading.Thread(target=source.read, args=(PATIENCE,))
    reader.start()
    time.sleep(0.05)
    source.close()
    reader.join(10.0)
    assert not reader.is_alive() and threading.active_count() == before
    assert source.read(1.0) is None
    source.close()


def test_rotation_and_translation_of_a_performer_are_those_of_the_head():
    neutral = calibrate(performance())
    rest = performance().result(0)
    np.testing.assert_allclose(turned_from(rest, neutral), 0.0, atol=1e-9)
    np.testing.assert_allclose(moved_from(rest, neutral), 0.0, atol=1e-9)

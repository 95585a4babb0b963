"""Streams are played evenly, whatever the network does."""

import numpy as np
import pytest

from facemime.core.face.rotation import euler_to_matrix
from facemime.core.streams.playout import ClockFollower, Playout, Shown
from facemime.core.streams.sender_times import SenderTimes
from facemime.core.takes.measured import coefficient_face
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.timing import at_rest, between
from lab.bench.link import Link
from tests.helpers.takes import performance

RATE = 30.0
DELAY = 0.025


def results(count: int):
    """A face whose head turns and whose mouth opens smoothly."""
    face, phase = coefficient_face(), np.arange(count) / RATE
    values = np.zeros((count, 52))
    values[:, 24] = 0.5 + 0.4 * np.sin(4.0 * phase)
    return [face.result(row, np.array([0.0, 0.3 * np.sin(2.0 * t), 0.0])) for row, t in zip(values, phase, strict=True)]


def played(arrivals, playout: Playout, end: float, step: float = 0.002) -> list[tuple[float, Shown]]:
    """Return the frames that are shown, and when, for packets (media time, result) with given arrivals."""
    shown, waiting, now = [], list(arrivals), 0.0
    while now < end:
        while waiting and waiting[0][0] <= now:
            arrival, (time, result) = waiting.pop(0)
            playout.push(result, time, arrival, None if time is None else round(time * RATE))
        while (frame := playout.pop(now)) is not None:
            shown.append((now, frame))
        now += step
    return shown


def sent(seconds: float):
    """Packets in the order of sending, each with its media time."""
    frames = results(int(seconds * RATE))
    return [(n / RATE, (1000.0 + n / RATE, result)) for n, result in enumerate(frames)]


def test_frames_come_out_evenly_and_all_of_them_despite_jitter():
    playout = Playout(DELAY)
    shown = played(Link().deliver(sent(10.0), 1), playout, 11.0)
    real = [(now, frame) for now, frame in shown if not frame.predicted]
    assert len(real) == 300 and playout.counts.late == playout.counts.doubled == playout.counts.lost == 0
    assert [frame.time for _, frame in real] == sorted(frame.time for _, frame in real)
    waits = np.diff([now for now, _ in real])[30:]
    assert np.abs(waits - 1.0 / RATE).max() < 0.006


def test_a_frame_is_shown_the_stated_delay_after_the_fastest_could_have_come():
    shown = played(Link(0.02, 0.01).deliver(sent(20.0), 2), Playout(DELAY), 21.0)
    delays = [now - (frame.time - 1000.0) for now, frame in shown if not frame.predicted][150:]
    assert np.median(delays) == pytest.approx(0.01 + DELAY, abs=0.004)


def test_duplicate_and_late_packets_are_dropped_and_counted():
    playout = Playout(DELAY)
    shown = played(Link(0.02, 0.1, double=0.3).deliver(sent(10.0), 3), playout, 11.0)
    times = [frame.time for _, frame in shown if not frame.predicted]
    assert len(set(times)) == len(times) and times == sorted(times)
    assert playout.counts.doubled + playout.counts.late > 30


def test_reordered_packets_come_out_in_order():
    frames = sent(4.0)
    swapped = [frames[n ^ 1] for n in range(len(frames))]
    arrivals = [(number / RATE, packet) for number, (_, packet) in enumerate(swapped)]
    playout = Playout(0.1)
    times = [frame.time for _, frame in played(arrivals, playout, 5.0) if not frame.predicted]
    assert times == sorted(times) and len(times) == len(frames)


@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_a_drifting_clock_is_followed_for_ten_minutes(drift):
    clock, worst = ClockFollower(), 0.0
    rng = np.random.default_rng(0)
    for number in range(int(600 * RATE)):
        time = number / RATE
        arrival = time / (1.0 + drift) + 0.02 + rng.uniform(-0.01, 0.01)
        assert not clock.update(time, arrival, 0.05 / RATE)
        if time > 20.0:
            worst = max(worst, abs(clock.offset - (time / (1.0 + drift) - time + 0.01)))
    assert worst < 0.005


def test_a_slower_network_is_followed_within_seconds():
    near, far = Link(0.02, 0.01).deliver(sent(5.0), 5), Link(0.12, 0.01).deliver(sent(12.0), 6)
    arrivals = [*near, *(arrival for arrival in far if arrival[1][0] >= 1005.0)]
    shown = played(arrivals, Playout(DELAY), 13.0)
    late = [now - frame.due for now, frame in shown if not frame.predicted and frame.time > 1009.5]
    assert len(late) > 60 and max(late) < 0.005


def test_a_restarted_sender_is_followed_at_once():
    playout = Playout(DELAY)
    first = [(n / RATE, (1000.0 + n / RATE, r)) for n, r in enumerate(results(60))]
    again = [(3.0 + n / RATE, (5.0 + n / RATE, r)) for n, r in enumerate(results(60))]
    shown = played(first + again, playout, 6.0)
    assert sum(not frame.predicted for _, frame in shown) == 120


def test_no_frame_counts_as_lost_if_a_sender_without_numbers_becomes_slower():
    playout = Playout(DELAY)
    for number, (at, (time, result)) in enumerate(sent(6.0)):
        if number < 60 or number % (2 if number < 120 else 3) == 0:
            playout.push(result, time, at + 0.02)
            while playout.pop(at + 0.02) is not None:
                pass
    assert playout.counts.lost == 0 and playout.due() is not None


def test_missing_frames_are_counted_and_predicted_but_never_more_than_two_in_a_row():
    frames = sent(4.0)
    kept = [packet for number, packet in enumerate(frames) if number % 10 != 5 and not 60 <= number < 90]
    playout = Playout(DELAY)
    shown = played([(at + 0.02, packet) for at, packet in kept], playout, 5.0)
    flags = "".join("p" if frame.predicted else "-" for _, frame in shown)
    assert "p" in flags and "ppp" not in flags
    assert playout.counts.lost == sum(number % 10 == 5 or 60 <= number < 90 for number in range(120))
    errors = [
        np.abs(frame.result.shape - frames[round((frame.time - 1000.0) * RATE)][1][1].shape).max()
        for _, frame in shown
        if frame.predicted and frame.time < 1001.9
    ]
    assert len(errors) > 3 and max(errors) < 0.01


def test_frames_without_times_are_assumed_to_be_sent_evenly():
    arrivals = [(at, (None, result)) for at, (_, result) in Link(0.02, 0.008).deliver(sent(10.0), 4)]
    shown = played(arrivals, Playout(DELAY), 11.0)
    waits = np.diff([frame.due for _, frame in shown if not frame.predicted])[60:]
    assert np.abs(waits - 1.0 / RATE).max() < 0.008


CLOCKS = {
    "stands still": lambda seconds, rate: np.full_like(seconds, 7.0),
    "counts whole seconds": lambda seconds, rate: np.floor(seconds),
    "is sent with every tenth frame": lambda seconds, rate: 10.0 / rate * np.floor(seconds * rate / 10.0 + 1e-6),
    "is sent with every second frame": lambda seconds, rate: 2.0 / rate * np.floor(seconds * rate / 2.0 + 1e-6),
    "counts seconds since 1970 in single precision": lambda seconds, rate: (1.75e9 + seconds).astype(np.float32),
    "is random within each second": lambda seconds, rate: np.floor(seconds) + shuffled(len(seconds)) / 60.0,
    "is random": lambda seconds, rate: 1e6 * np.random.default_rng(1).random(len(seconds)),
    "goes back every second": lambda seconds, rate: seconds % 1.0,
}


def shuffled(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 60, count)


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("clock", CLOCKS)
def test_frames_come_out_as_they_arrive_if_the_senders_clock_is_useless(clock, rate):
    seconds = np.arange(int(6.0 * rate)) / rate
    times = CLOCKS[clock](seconds, rate).astype(float)
    frames = [coefficient_face().result(np.full(52, n / len(times)), np.zeros(3)) for n in range(len(times))]
    packets = list(zip(seconds.tolist(), zip(times.tolist(), frames, strict=True), strict=True))
    shown = played(Link(0.02, 0.3 / rate).deliver(packets, 1), Playout(0.1), 7.0)
    values = np.array([frame.result.coefficients[0] for _, frame in shown if not frame.predicted])
    begun = values > 2.0 / 6.0
    assert len(values) >= len(times) - 0.3 * rate - 8 and len(values[begun]) == (seconds > 2.0).sum()
    assert (np.diff(values[begun]) > 0.0).all()
    due = np.diff([frame.due for _, frame in shown if not frame.predicted])[begun[1:]]
    assert np.abs(due - 1.0 / rate).max() < 0.3 / rate


@pytest.mark.parametrize("speed", [1.3, 3.0, 12.0, 0.4, 0.01])
def test_frames_come_out_as_they_arrive_if_the_senders_clock_runs_fast_or_slow(speed):
    packets = [(at, (1000.0 + speed * at, result)) for at, (_, result) in sent(9.0)]
    shown = played(Link(0.02, 0.01).deliver(packets, 1), Playout(0.1), 10.0)
    real = [frame for _, frame in shown if not frame.predicted][-int(2.5 * RATE) :]
    assert [frame.result for frame in real] == [result for _, (_, result) in packets[-len(real) :]]
    assert np.abs(np.diff([frame.due for frame in real]) - 1.0 / RATE).max() < 0.01


def test_a_clock_that_is_a_few_percent_fast_does_not_delay_what_is_shown():
    times = SenderTimes()
    face = results(1)[0]
    used = [not times.useless(7.0 + 1.04 * n / RATE, n / RATE, face) for n in range(int(14.0 * RATE))]
    assert all(used[:100]) and not used[-1]


@pytest.mark.parametrize("drift", [0.0, 1e-3, -1e-3])
def test_a_good_clock_is_kept_if_queues_of_the_network_fill_and_empty(drift):
    times, face, free, rng = SenderTimes(), results(1)[0], 0.0, np.random.default_rng(0)
    capacity = np.repeat(rng.uniform(20.0, 80.0, 61), 5)
    for number in range(int(300.0 * RATE)):
        sending = number / RATE
        free = max(free, sending) + 1.0 / capacity[int(max(free, sending))]
        if free - sending > 1.0:
            free = sending + 1.0
            continue
        assert not times.useless((1.0 + drift) * sending, free, face)


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("jitter", [0.05, 0.2])
def test_a_good_clock_is_kept_on_a_network_that_delays_doubles_and_reorders_packets(rate, jitter):
    frames = [coefficient_face().result(np.full(52, n / 600), np.zeros(3)) for n in range(600)]
    packets = [(n / rate, (1000.0 + n / rate, frame)) for n, frame in enumerate(frames)]
    link = Link(jitter, jitter, loss=0.05, double=0.3, cut=(5.0, 6.5))
    playout = Playout(2.0 * jitter + 0.05)
    shown = played(link.deliver(packets, 2), playout, 601 / rate)
    times = [frame.time for _, frame in shown if not frame.predicted]
    assert set(times) <= {time for _, (time, _) in packets} and times == sorted(set(times))
    assert len(times) > 0.9 * 600 - 1.5 * rate and playout.counts.doubled > 100


def test_frames_that_a_sender_repeats_with_their_times_are_shown_once():
    arrivals = [(n / 60.0, packet) for n, packet in enumerate(packet for packet in sent(4.0) for _ in (0, 1))]
    playout = Playout(DELAY)
    shown = played([(at, packet[1]) for at, packet in arrivals], playout, 5.0)
    assert sum(not frame.predicted for _, frame in shown) == playout.counts.doubled == 120


def test_a_flood_of_frames_is_bounded():
    playout, result = Playout(2.0), results(1)[0]
    for number in range(20_000):
        playout.push(result, number / 2e4, number / 2e4)
    assert len(playout._waiting) <= 240


# Interpolation


def test_results_are_interpolated_and_extrapolated():
    first, second = results(9)[0], results(9)[8]
    middle, beyond = between(first, second, 0.5), between(first, second, 1.5)
    np.testing.assert_allclose(middle.shape, (first.shape + second.shape) / 2.0)
    np.testing.assert_allclose(beyond.pose[2], 1.5 * second.pose[2], atol=1e-9)
    assert middle.confidence == 0.0
    turn = euler_to_matrix(*middle.pose[1:4])
    np.testing.assert_allclose(middle.landmarks, middle.pose[0] * (middle.shape @ turn.T)[:, :2] + middle.pose[4:])


def test_a_face_at_rest_is_the_neutral_one_looking_straight_ahead():
    take = performance()
    neutral = calibrate(take)
    rest = at_rest(neutral, take.result(40))
    np.testing.assert_allclose(rest.shape, neutral.shape)
    np.testing.assert_allclose(euler_to_matrix(*rest.pose[1:4]), neutral.rotation, atol=1e-9)
    np.testing.assert_allclose(at_rest(coefficient_face().neutral, results(5)[4]).coefficients, 0.0)

"""Timecodes of other programs give the times of frames, whatever the rate, which no table states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.takes import table_timecodes


def seconds_of_timecodes(texts: list[str]) -> np.ndarray:
    return table_timecodes.seconds_of_timecodes(texts)[0]


RATES = (12, 15, 20, 24, 25, 30, 48, 50, 60, 100, 120)


def stamps(rate: int, count: int, start: int = 0, separator: str = ":", every: int = 1) -> list[str]:
    """Timecodes of every n-th frame of a recording."""
    frames = start + every * np.arange(count)
    return [f"10:{f // rate // 60:02d}:{f // rate % 60:02d}{separator}{f % rate:02d}.000" for f in frames.tolist()]


@given(st.sampled_from(RATES), st.integers(0, 3000), st.floats(1.3, 6.0))
def test_steps_are_even_at_any_rate_as_soon_as_a_second_begins(rate, start, seconds):
    times = seconds_of_timecodes(stamps(rate, int(seconds * rate), start))
    np.testing.assert_allclose(np.diff(times), 1.0 / rate, atol=1e-9)


@given(st.sampled_from([30, 60, 120]), st.integers(2, 4))
def test_a_recording_of_every_nth_frame_keeps_its_rate(rate, every):
    times = seconds_of_timecodes(stamps(rate, 4 * rate // every, every=every))
    np.testing.assert_allclose(np.diff(times), every / rate, atol=1e-9)


@given(st.sampled_from(RATES), st.integers(0, 2**32 - 1))
def test_dropped_frames_do_not_change_the_rate(rate, seed):
    every = stamps(rate, 4 * rate)
    kept = np.flatnonzero(np.random.default_rng(seed).random(len(every)) > 0.1)
    times = seconds_of_timecodes([every[i] for i in kept])
    np.testing.assert_allclose(times - times[0], (kept - kept[0]) / rate, atol=1e-9)


def test_within_a_second_the_rate_is_the_apps():
    np.testing.assert_allclose(np.diff(seconds_of_timecodes(stamps(24, 20))), 1.0 / 60.0)


def test_midnight_drop_frame_and_times_without_frames_are_understood():
    assert np.diff(seconds_of_timecodes(["23:59:59:29.0", "00:00:00:00.0"]))[0] == pytest.approx(1 / 30)
    dropped = ["10:00:58;29", "10:00:59;00", *(f"10:00:59;{f:02d}" for f in range(1, 30)), "10:01:00;02"]
    assert np.diff(seconds_of_timecodes(dropped)).max() < 0.11
    np.testing.assert_allclose(seconds_of_timecodes(["0:00:01.5", "0:01:00.25"]), [1.5, 60.25])


@pytest.mark.parametrize("mark", [";", ":"])
@pytest.mark.parametrize(("rate", "dropped"), [(30, 2), (60, 4)])
def test_steps_are_even_where_drop_frame_timecodes_skip_numbers(rate, dropped, mark):
    numbers = np.arange(9 * 60 * rate, 11 * 60 * rate + rate)
    kept = numbers[(numbers % (60 * rate) >= dropped) | (numbers // (60 * rate) % 10 == 0)]
    texts = [f"01:{n // rate // 60:02d}:{n // rate % 60:02d}{mark}{n % rate:02d}" for n in kept.tolist()]
    np.testing.assert_allclose(np.diff(seconds_of_timecodes(texts)), 1.001 / rate, atol=1e-9)


def test_times_may_follow_a_date_and_have_no_hours():
    dated = [f"2026-01-02T10:59:{59 + i / 4:06.3f}Z" for i in range(4)]
    np.testing.assert_allclose(np.diff(seconds_of_timecodes(dated)), 0.25)
    np.testing.assert_allclose(np.diff(seconds_of_timecodes(["09:59.750", "10:00.000"])), 0.25)


@pytest.mark.parametrize("text", ["hello", "10:20", "1:2:3:4:5", "10:20:-3:00", ""])
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match="not a timecode"):
        seconds_of_timecodes([text])

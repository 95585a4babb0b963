"""Times are shown as minutes and seconds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.takes.table_times import timecode


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.0, "0:00.0"), (2.37, "0:02.4"), (59.96, "1:00.0"), (3725.0, "62:05.0"), (-0.5, "-0:00.5")]
)
def test_a_time_is_shown_in_minutes_and_seconds(seconds, text):
    assert timecode(seconds) == text


@given(st.floats(-1e5, 1e5))
def test_a_time_is_rounded_to_tenths(seconds):
    minutes, rest = timecode(seconds).lstrip("-").split(":")
    assert 60 * int(minutes) + float(rest) == pytest.approx(abs(seconds), abs=0.0501)
    assert len(rest) == 4 and float(rest) < 60.0

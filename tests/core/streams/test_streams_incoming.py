"""The values that arrive are shown as they come, before they are played."""

from __future__ import annotations

import re
import time
from contextlib import closing

import numpy as np

from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS
from facemime.core.streams.diagnosis import incoming, table
from facemime.core.streams.protocols.frames import FaceValues
from facemime.core.streams.protocols.openseeface import OpenSeeFaceDecoder
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from lab.bench.packets import packets
from tests.helpers.clocks import PATIENCE
from tests.helpers.links import free_port, sending_phone


def test_a_table_shows_every_value_of_every_sender_within_80_columns():
    values = np.linspace(0.0, 1.0, 52)
    face = FaceValues(values, np.radians([10.0, -20.0, 5.0]))
    text = table([incoming("192.168.1.8 Ada", 59.9, face), incoming("192.168.1.9 Ben", 30.0, None)])
    lines = text.splitlines()
    assert lines[0] == "192.168.1.8 Ada: 60 frames/s, Pitch 10°, Yaw -20°, Roll 5°"
    assert lines[-1] == "192.168.1.9 Ben: 30 frames/s, no face"
    assert max(map(len, lines)) <= 80 and len(lines) == 21
    shown = {name: float(value) for name, value in re.findall(r"([a-z]\w+) +(\d\.\d\d)", text)}
    assert shown == {name: round(values[column], 2) for name, column in COEFFICIENT_INDEX.items()}


def test_landmarks_without_values_show_the_pose_alone():
    (frame,) = OpenSeeFaceDecoder().decode(packets("openseeface")[0])
    one = incoming("127.0.0.1 0", 30.0, frame.face)
    assert one.found and not one.rows() and "Yaw" in table([one])


def test_what_a_phone_sends_is_shown_with_its_rate():
    port = free_port()
    with closing(StreamSource(StreamSettings("livelink", port=port, sender="Nobody"))) as source:
        source.read(0.0)
        assert source.incoming == []
        with sending_phone(port) as take:
            end, seen = time.monotonic() + PATIENCE, []
            while len(seen) < 40:
                assert time.monotonic() < end
                source.read(0.01)
                seen += source.incoming
    assert {one.sender for one in seen} == {"127.0.0.1 Phone"} and all(one.found for one in seen)
    assert seen[-1].rate > 5.0
    for one in seen:
        values = np.array([value for _, value in one.rows()])
        assert [name for name, _ in one.rows()] == list(COEFFICIENTS)
        assert np.abs(take.coefficients - values).max(axis=1).min() < 1e-6

"""Facemime's own packets follow their documentation, survive encoding, and are refused if invalid."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from facemime.core.streams.protocols.frames import PacketError
from facemime.core.streams.transport import datagram
from facemime.core.takes.measured import coefficient_face
from tests.helpers.stream_values import ANGLES, SHARES, distinct
from tests.helpers.takes import performance


def own(result, sequence=7, time=2.5) -> bytes:
    kind, body = datagram.encode_face(result)
    return datagram.pack(datagram.Packet(kind, b"sessions", sequence, time, body), signed=False)


def test_an_own_packet_is_laid_out_as_documented():
    take = performance()
    data = own(take.result(0))
    assert data[:8] == b"FMIM\1\1\0\0" and data[8:16] == b"sessions" and len(data) == 482
    assert struct.unpack(">Qd", data[16:32]) == (7, 2.5)
    np.testing.assert_allclose(struct.unpack(">6f", data[32:56]), take.pose[0], rtol=1e-6)
    shape = np.frombuffer(data, ">i2", 198, 56).reshape(66, 3) / 8192.0
    np.testing.assert_allclose(shape, take.shape[0], atol=2.0**-14)


def test_30_frames_per_second_take_at_most_150_kilobits_with_all_headers():
    for result in (performance().result(0), coefficient_face().result(distinct(), np.zeros(3))):
        bytes_sent = len(own(result)) + 16 + 28  # the signature, and the headers of UDP and IP
        assert 30 * 8 * bytes_sent <= 150_000


def test_landmarks_come_back_to_a_step_of_a_take():
    take = performance()
    for number in range(0, len(take), 7):
        result = take.result(number)
        frame = datagram.decode_face(datagram.unpack(own(result, number, 0.1 * number)))
        assert frame.sequence == number and frame.time == 0.1 * number
        if not result.found:
            assert frame.face is None
            continue
        np.testing.assert_allclose(frame.face.shape, result.shape, atol=2.0**-14)
        np.testing.assert_allclose(frame.face.pose, result.pose, rtol=1e-6)
        assert np.isnan(frame.face.gaze).all() and np.isnan(frame.face.actions).all()


@pytest.mark.parametrize("teeth", [0.0, 0.3, 1.0, np.nan])
def test_shut_teeth_come_back_to_a_step(teeth):
    result = replace(performance().result(0), teeth=teeth)
    found = datagram.decode_face(datagram.unpack(own(result))).face
    np.testing.assert_allclose(found.teeth, teeth, atol=0.5 / 128.0)


def test_teeth_of_earlier_senders_are_not_shut():
    data = own(performance().result(0))
    assert datagram.decode_face(datagram.unpack(data[:-1] + b"\0")).face.teeth == 0.0


@given(SHARES, ANGLES)
def test_coefficients_come_back_to_a_step_of_16_bits(values, angles):
    result = coefficient_face().result(np.array(values), np.array(angles))
    found = datagram.decode_face(datagram.unpack(own(result))).face
    np.testing.assert_allclose(found.coefficients, values, atol=0.6 / 65535.0)
    np.testing.assert_allclose(found.pose, result.pose, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("size", [0, 3, 31, 481])
def test_own_packets_that_are_truncated_or_too_long_are_refused(size):
    data = own(performance().result(0))
    for wrong in (
        data[:size],
        data + b"\0",
        b"X" + data[1:],
        data[:4] + b"\2" + data[5:],
        data[:6] + b"\0\2" + data[8:],
    ):
        with pytest.raises(PacketError):
            datagram.unpack(wrong)


@pytest.mark.parametrize(("at", "value"), [(32, np.nan), (32, -1.0), (36, np.inf), (44, 50.0), (48, 1e9)])
def test_own_packets_with_impossible_poses_are_refused(at, value):
    data = own(performance().result(0))
    with pytest.raises(PacketError):
        datagram.decode_face(datagram.unpack(data[:at] + struct.pack(">f", value) + data[at + 4 :]))


def test_an_own_packet_with_an_unknown_landmark_is_refused():
    data = own(performance().result(0))
    with pytest.raises(PacketError):
        datagram.decode_face(datagram.unpack(data[:56] + b"\x80\0" + data[58:]))

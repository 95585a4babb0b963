"""Face Motion 3, used by newer phone apps, follows its specification, also with a phone on a real socket."""

import struct

import numpy as np
import pytest

from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS
from facemime.core.face.rotation import from_face_axes
from facemime.core.streams.protocols import ifacialmocap
from facemime.core.streams.protocols.face_motion import REFUSALS, FaceMotionReceiver
from facemime.core.streams.protocols.frames import PacketError
from tests.helpers.face_motion_packets import (
    ACK_HEX,
    GOOD,
    HELLO_HEX,
    NONCE,
    POSE,
    STATED,
    VALUES,
    changed,
    datagrams,
    frame,
    played_as_sent,
    schema,
    schema_payload,
)
from tests.helpers.links import Phone
from tests.helpers.stream_values import value_of
from tests.helpers.takes import coefficient_take


@pytest.fixture
def receiver(monkeypatch) -> FaceMotionReceiver:
    monkeypatch.setattr("secrets.randbits", lambda bits: NONCE)
    return FaceMotionReceiver()


@pytest.fixture
def begun(receiver) -> FaceMotionReceiver:
    for packet in schema(NONCE):
        receiver.receive(packet, 0.0)
    return receiver


def test_a_phone_is_asked_and_its_schema_acknowledged_as_published(receiver):
    assert receiver.hello().hex() == HELLO_HEX and receiver.hello() == receiver.hello()
    first, second, third = schema(NONCE)
    for packet in (third, first, first):
        assert receiver.receive(packet, 0.0) == ([], [])
    frames, answers = receiver.receive(second, 0.0)
    assert not frames and [answer.hex() for answer in answers] == [ACK_HEX]


@pytest.mark.parametrize(("encoding", "kind"), [("i16", "h"), ("i32", "i")])
def test_a_frame_is_read_by_its_schema(receiver, encoding, kind):
    for packet in schema(0, blend_encoding=encoding):
        receiver.receive(packet, 0.0)
    ((got,), answers) = receiver.receive(frame(VALUES, 0, encoding=kind), 0.1)
    assert not answers
    np.testing.assert_allclose(got.face.coefficients, np.arange(52) / 100.0)
    np.testing.assert_allclose(got.face.rotation, from_face_axes(*np.radians(POSE[:3])), atol=1e-7)
    np.testing.assert_allclose(got.face.position, [-0.03, 0.1, 0.66], atol=1e-7)


def test_a_face_with_few_or_only_names_of_its_own_is_read(receiver):
    """The author's simulated phone has three names and his golden schemas one, or none that others know."""
    names = ["jawOpen", "eyeBlinkLeft", "myCustomSmile", "独自の笑顔"]
    for number, (own, opened) in enumerate([(names, 0.4), (names[2:], 0.0)], 1):
        for packet in schema(0, number, blend_names=own):
            receiver.receive(packet, float(number))
        values = [40, 0, -25, 150][-len(own) :]
        ((read,), _) = receiver.receive(frame(values, number, number), float(number))
        assert value_of(read.face, "jawOpen") == pytest.approx(opened)
        np.testing.assert_allclose(read.face.rotation, from_face_axes(*np.radians(POSE[:3])), atol=1e-6)


def test_values_beyond_a_face_are_clipped(begun):
    ((got,), _) = begun.receive(frame([-25, 150, *VALUES[2:]], 1), 0.1)
    assert value_of(got.face, COEFFICIENTS[0]) == 0.0 and value_of(got.face, COEFFICIENTS[1]) == 1.0


def test_a_lost_face_is_reported_and_a_recording_is_played(begun):
    assert begun.receive(frame(VALUES, 1, flags=0), 0.1)[0][0].face is None
    assert begun.receive(frame(VALUES, 2, flags=3), 0.1)[0][0].face is not None


def test_old_and_duplicate_frames_are_dropped_even_when_the_counter_restarts(begun):
    numbers = (2**32 - 2, 2**32 - 1, 2**32 - 1, 0, 2**32 - 1, 2)
    assert [len(begun.receive(frame(VALUES, n), 0.1)[0]) for n in numbers] == [1, 1, 0, 1, 0, 1]


def test_a_changed_schema_reads_later_frames_and_an_unknown_one_is_asked_for_once(begun):
    assert begun.receive(frame([1, *VALUES], 1, 2), 0.0) == ([], datagrams(5))
    assert begun.receive(frame([1, *VALUES], 2, 2), 0.5) == ([], [])
    packets = schema(NONCE, 2, blend_names=["new", *STATED["blend_names"]])
    answers = [answer for packet in packets for answer in begun.receive(packet, 0.6)[1]]
    assert answers == datagrams(3, schema=2)
    assert begun.receive(frame(VALUES, 3, 1), 0.7) == ([], [])
    ((got,), _) = begun.receive(frame([99, *VALUES], 4, 2), 0.7)
    np.testing.assert_allclose(got.face.coefficients, np.arange(52) / 100.0)


def test_a_repeated_schema_is_acknowledged_again_once_per_second(begun):
    counts = [sum(len(begun.receive(p, now)[1]) for p in schema(NONCE)) for now in (0.5, 1.2, 1.9, 2.3)]
    assert counts == [0, 1, 0, 1]
    with pytest.raises(PacketError):
        for packet in schema(NONCE, app="Another"):
            begun.receive(packet, 9.0)


def test_the_phone_is_pinged_and_reminded_when_nothing_comes(begun):
    sent = {now: begun.due(now) for now in np.arange(0.5, 14.0, 0.5).tolist()}
    pings = [now for now, packets in sent.items() if any(p[4] == 6 for p in packets)]
    reminders = [now for now, packets in sent.items() if any(p[4] == 5 for p in packets)]
    assert pings == [3.0, 6.0, 9.0] and reminders == [3.0, 4.0, 5.0, 6.0]
    assert sent[4.0] == datagrams(3, schema=1) + datagrams(5)
    assert begun.active(11.9) and not begun.active(12.1)
    assert begun.stop() == datagrams(8)


def test_another_session_waits_until_the_running_one_is_silent(begun):
    others = schema(0, session=77)
    for packet in others:
        with pytest.raises(PacketError, match="another session"):
            begun.receive(packet, 2.9)
    answers = [answer for packet in others for answer in begun.receive(packet, 3.1)[1]]
    assert answers == datagrams(3, session=77, schema=1)
    with pytest.raises(PacketError):
        begun.receive(frame(VALUES, 1), 3.2)
    assert len(begun.receive(frame(VALUES, 1, session=77), 3.2)[0]) == 1


def test_a_refusal_is_reported_with_advice(receiver):
    receiver.receive(datagrams(9, b"BUSY", session=NONCE)[0], 0.0)
    assert receiver.message == REFUSALS["BUSY"]
    receiver.receive(datagrams(9, b"SOMETHING_ELSE", session=NONCE)[0], 0.0)
    assert receiver.message == REFUSALS[""]
    for packet in schema(NONCE):
        receiver.receive(packet, 0.0)
    assert receiver.message == ""


@pytest.mark.parametrize(
    "packets",
    [
        [b"FMV3"],
        [GOOD[:-1]],
        [GOOD + b"\0"],
        [changed(GOOD, 4, 10)],
        [changed(GOOD, 4, 1)],
        [changed(GOOD, 5, 4)],
        [changed(GOOD, 6, 41)],
        [changed(GOOD, 32, 1)],
        [changed(GOOD, 34, 2)],
        [frame(VALUES[:-1], 5)],
        [frame(VALUES, 5, encoding="i")],
        [frame(VALUES, 5, session=0)],
        [frame(VALUES, 5, pose=(float("nan"), *POSE[1:]))],
        [frame(VALUES, 5, pose=(1e9, *POSE[1:]))],
        datagrams(7, b"x"),
        datagrams(9, b"x" * 513),
        schema(NONCE, 0),
        schema(1234, 2, session=9),
        schema(0, 2, start=(60, 1200, 10_000, 4)),
        schema(0, 2, start=(0, 1200, 10_000, 5)),
        schema(0, 2, start=(60, 1201, 10_000, 5)),
        schema(0, 2, start=(60, 1200, 1, 5)),
        schema(0, 2, schema_version=2),
        schema(0, 2, blend_unit="unit"),
        schema(0, 2, blend_encoding="f32"),
        schema(0, 2, blend_encoding=["i16"]),
        schema(0, 2, blend_names=[*COEFFICIENTS, "jawOpen"]),
        schema(0, 2, blend_names=[*COEFFICIENTS, 5]),
        schema(0, 2, blend_names=[*COEFFICIENTS, "x" * 300]),
        datagrams(2, struct.pack("<QHHII", 0, 60, 1200, 10_000, 5) + b"[1]", schema=2, largest=576),
        datagrams(2, struct.pack("<QHHII", 0, 60, 1200, 10_000, 5) + b"{" * 90, schema=2, largest=576),
    ],
)
def test_invalid_packets_are_refused_and_change_nothing(begun, packets):
    with pytest.raises(PacketError):
        for packet in packets:
            begun.receive(packet, 3.5)
    assert len(begun.receive(GOOD, 3.6)[0]) == 1


def test_over_tcp_messages_are_whole_and_not_acknowledged(monkeypatch):
    monkeypatch.setattr("secrets.randbits", lambda bits: NONCE)
    connected = FaceMotionReceiver(connected=True)
    (packet,) = datagrams(2, schema_payload(NONCE), schema=1, largest=10_000)
    assert connected.receive(packet, 0.0) == ([], [])
    assert len(connected.receive(frame(VALUES, 1), 0.1)[0]) == 1
    assert connected.due(3.2) == datagrams(6, sequence=1) + datagrams(5)
    with pytest.raises(PacketError, match="divided"):
        connected.receive(schema(NONCE, 2)[0], 3.3)
    for empty in datagrams(4, schema=1, sequence=2, flags=1):
        with pytest.raises(PacketError):
            connected.receive(empty, 3.3)
    connected.end()
    assert not connected.active(3.4) and connected.due(3.4) == connected.stop() == []


class MotionPhone(Phone):
    """A phone that sends a second of coefficients: version 3 after HELLO if it is `new`, otherwise text after START."""

    def __init__(self, monkeypatch, protocol: str, *, new: bool, deaf: int = 0) -> None:
        super().__init__(monkeypatch, protocol, "phone_port", "motion_port")
        self.values = np.round(coefficient_take(12).coefficients, 2)
        self.heard: list[int] = []
        self._new, self._deaf = new, deaf

    def run(self) -> None:
        number, where, sends, nonce = 0, None, False, None
        while not self._ended.is_set():
            try:
                data, where = self._socket.recvfrom(4096)
            except TimeoutError:
                if sends:
                    self._send(self._packet(number), where)
                    number += 1
                elif nonce is not None:
                    for packet in schema(nonce):
                        self._send(packet, where)
                continue
            if data.startswith(b"FMV3"):
                self.heard.append(data[4])
                if self._new and data[4] == 1:
                    nonce = struct.unpack_from("<Q", data, 8)[0]
                sends = self._new and (sends or (data[4] == 3 and self.heard.count(3) > self._deaf))
            else:
                self.heard.append(0)
                sends = sends or not self._new

    def _packet(self, number: int) -> bytes:
        values = self.values[number % len(self.values)]
        if self._new:
            return frame([*np.round(100 * values).astype(int).tolist(), 7], number)
        parts = [f"{name}-{round(100 * values[i])}" for name, i in COEFFICIENT_INDEX.items()]
        return ("|".join(parts) + "|=head#5.0,-10.0,2.0,0.0,0.0,-0.5|").encode()

    def _send(self, packet: bytes, where) -> None:
        self._socket.sendto(packet, where)


@pytest.mark.parametrize("protocol", ["ifacialmocap", "facemotion3d"])
def test_a_new_app_sends_version_3_until_the_session_is_ended(opened, monkeypatch, protocol):
    phone = MotionPhone(monkeypatch, protocol, new=True)
    phone.start()
    try:
        source = opened(protocol, phone="127.0.0.1")
        assert played_as_sent(source, phone)
        source.close()
        phone.join(0.1)
    finally:
        phone.close()
    assert phone.heard[0] == 1 and 3 in phone.heard and phone.heard[-1] == 8
    assert 0 not in phone.heard, "asked for the text, an app would end its version 3"


def test_a_lost_acknowledgement_is_sent_again(opened, monkeypatch):
    phone = MotionPhone(monkeypatch, "ifacialmocap", new=True, deaf=1)
    phone.start()
    try:
        assert played_as_sent(opened("ifacialmocap", phone="127.0.0.1"), phone)
    finally:
        phone.close()
    assert phone.heard.count(3) >= 2


def test_an_old_app_is_asked_for_its_text(opened, monkeypatch):
    phone = MotionPhone(monkeypatch, "ifacialmocap", new=False)
    phone.start()
    try:
        assert played_as_sent(opened("ifacialmocap", phone="127.0.0.1"), phone)
    finally:
        phone.close()
    assert phone.heard[:2] == [1, 0] and ifacialmocap.START.endswith(b"v2")

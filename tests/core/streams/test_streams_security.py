"""Facemime's own stream with a key: strangers, replays and other keys are refused, and all else gets through."""

import struct
from itertools import chain

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.errors import OutputError, SourceError
from facemime.core.streams.protocols.frames import PacketError
from facemime.core.streams.transport.datagram import OwnReceiver, OwnSender, RefusedError, encode_face
from facemime.core.streams.transport.security import ReplayWindow, read_key, write_key
from tests.helpers.owners import who_can_open
from tests.helpers.takes import performance

KEY, OTHER = b"k" * 32, b"o" * 32
FACE = encode_face(performance().result(0))


def greeted(receiver: OwnReceiver, sender: OwnSender, now: float = 0.0) -> None:
    """Carry the handshake to the receiver and back."""
    _, answers = receiver.receive(sender.hello(), now)
    sender.answer(*answers)


def frames(receiver: OwnReceiver, data: bytes, now: float = 0.0) -> int:
    return len(receiver.receive(data, now)[0])


def test_after_the_handshake_packets_get_through():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    assert not sender.ready
    greeted(receiver, sender)
    assert sender.ready and all(frames(receiver, sender.packet(*FACE, 0.1 * n)) == 1 for n in range(50))


def test_without_a_key_there_is_no_handshake():
    receiver, sender = OwnReceiver(None), OwnSender(None)
    assert sender.ready and sender.hello() == b"" and frames(receiver, sender.packet(*FACE, 0.0)) == 1


def test_a_replay_is_refused_in_the_session_and_in_any_other():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    hello = sender.hello()
    sender.answer(*receiver.receive(hello, 0.0)[1])
    recorded = [sender.packet(*FACE, 0.1 * n) for n in range(5)]
    for data in recorded:
        assert frames(receiver, data) == 1
    for data in recorded:
        with pytest.raises(RefusedError):
            receiver.receive(data, 0.0)
    # The receiver restarts, and a recording of the session is replayed to it, beginning with the handshake.
    receiver = OwnReceiver(KEY)
    receiver.receive(hello, 10.0)
    for data in recorded:
        with pytest.raises(RefusedError):
            receiver.receive(data, 10.0)


def test_a_replayed_handshake_does_not_end_a_session():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    hello = sender.hello()
    sender.answer(*receiver.receive(hello, 0.0)[1])
    assert frames(receiver, sender.packet(*FACE, 0.0)) == 1
    for now in (0.1, 5.0, 9.0):
        receiver.receive(hello, now)
        assert frames(receiver, sender.packet(*FACE, now), now) == 1


def test_reordered_packets_are_not_replays_but_very_old_ones_are():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    greeted(receiver, sender)
    packets = [sender.packet(*FACE, 0.1 * n) for n in range(100)]
    assert all(frames(receiver, packets[n]) for n in (3, 1, 2, 0, 70, 69))
    with pytest.raises(RefusedError):
        receiver.receive(packets[4], 0.0)


def test_packets_with_another_key_or_none_are_refused_as_are_changed_ones():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    greeted(receiver, sender)
    data = sender.packet(*FACE, 0.0)
    for stranger in (OwnSender(OTHER), OwnSender(None)):
        if stranger.hello():
            with pytest.raises(RefusedError):
                receiver.receive(stranger.hello(), 0.0)
        with pytest.raises(PacketError):
            receiver.receive(stranger.packet(*FACE, 0.0), 0.0)
    for at in range(0, len(data), 7):
        with pytest.raises(PacketError):
            receiver.receive(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :], 0.0)
    assert frames(receiver, data) == 1


def test_a_signed_packet_is_refused_where_there_is_no_key():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    greeted(receiver, sender)
    with pytest.raises(RefusedError):
        OwnReceiver(None).receive(sender.packet(*FACE, 0.0), 0.0)


def test_an_answer_to_another_handshake_is_not_accepted():
    receiver, sender = OwnReceiver(KEY), OwnSender(KEY)
    _, old = receiver.receive(sender.hello(), 0.0)
    sender.hello()
    with pytest.raises(RefusedError):
        sender.answer(*old)
    with pytest.raises(RefusedError):
        OwnSender(OTHER).answer(*old)
    assert not sender.ready


def test_a_restarted_receiver_is_found_by_the_next_handshake():
    sender = OwnSender(KEY)
    greeted(OwnReceiver(KEY), sender)
    receiver = OwnReceiver(KEY)
    with pytest.raises(RefusedError):
        receiver.receive(sender.packet(*FACE, 0.0), 0.0)
    greeted(receiver, sender)
    assert frames(receiver, sender.packet(*FACE, 0.1)) == 1


def test_answers_are_hardly_longer_than_requests_and_limited_in_rate():
    receiver, hello = OwnReceiver(KEY), OwnSender(KEY).hello()
    answers = [receiver.receive(hello, 0.0)[1] for _ in range(200)]
    assert sum(map(len, answers)) <= 20 and max(map(len, chain(*answers))) <= 2 * len(hello)


def test_old_handshakes_of_many_sessions_do_not_lock_a_sender_out():
    receiver = OwnReceiver(KEY)
    for number in range(40):
        receiver.receive(OwnSender(KEY).hello(), number / 10.0)
    sender = OwnSender(KEY)
    greeted(receiver, sender, 4.0)
    assert frames(receiver, sender.packet(*FACE, 0.0), 4.0) == 1


@given(st.lists(st.integers(0, 200), max_size=60))
def test_every_number_is_accepted_at_most_once(numbers):
    window, accepted = ReplayWindow(), []
    for number in numbers:
        if window.accept(number):
            accepted.append(number)
    assert len(set(accepted)) == len(accepted)
    assert not numbers or numbers[0] in accepted


def test_enormous_numbers_cost_nothing():
    window = ReplayWindow()
    assert window.accept(0) and window.accept(2**64 - 1) and not window.accept(2**64 - 1) and not window.accept(5)


def test_a_new_key_can_be_read_by_its_owner_alone(tmp_path):
    path, other = tmp_path / "stream.key", tmp_path / "other.key"
    write_key(path)
    write_key(other)
    with pytest.raises(OutputError):
        write_key(path)
    assert len(read_key(path)) == 32 and read_key(path) != read_key(other)
    assert who_can_open(path) == {"owner"}


def test_a_key_that_is_missing_short_or_huge_is_refused(tmp_path):
    (tmp_path / "short.key").write_text("secret\n")
    (tmp_path / "huge.key").write_bytes(b"x" * 10_000)
    for name in ("none.key", "short.key", "huge.key"):
        with pytest.raises(SourceError):
            read_key(tmp_path / name)


def test_kinds_that_are_not_faces_are_refused_after_the_handshake():
    receiver, sender = OwnReceiver(None), OwnSender(None)
    data = bytearray(sender.packet(*FACE, 0.0))
    data[5] = 99
    with pytest.raises(PacketError):
        receiver.receive(bytes(data), 0.0)
    data[5:6] = struct.pack("B", 17)
    with pytest.raises(PacketError):
        receiver.receive(bytes(data), 0.0)

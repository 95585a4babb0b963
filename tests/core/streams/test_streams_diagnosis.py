"""If packets arrive but move nothing, the message says why: another protocol, another key, or another sender."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from facemime.core.streams.diagnosis import recognise
from facemime.core.streams.protocols import osc
from facemime.core.streams.sender import SendSettings, StreamSender
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import PROTOCOLS, StreamSettings
from facemime.core.streams.transport.security import write_key
from facemime.core.takes.measured import coefficient_face
from lab.bench.packets import packets
from tests.helpers.clocks import PATIENCE
from tests.helpers.links import all_the_time, collected, free_port, performing
from tests.helpers.takes import coefficient_take

DATAGRAMS = ["own", "livelink", "vmc", "openseeface", "ifacialmocap", "vtubestudio", "vrcfacetracking", "facecap"]


def said(source: StreamSource) -> str:
    """Read until the source says why nothing is played."""
    end = time.monotonic() + PATIENCE
    while not source.message:
        assert time.monotonic() < end, source.counts
        source.read(0.02)
    return source.message


@contextmanager
def performed(protocol: str = "own", **settings) -> Iterator[None]:
    """Send faces, again and again, within the context."""
    sender, neutral = StreamSender(SendSettings(protocol, **settings)), coefficient_face().neutral
    with closing(sender), performing(sender, coefficient_take(30), neutral):
        yield


@contextmanager
def flooded(port: int, data: bytes) -> Iterator[None]:
    """Send a packet, again and again, within the context."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with sender, all_the_time(lambda seconds: [sender.sendto(data, ("127.0.0.1", port)) for _ in range(20)]):
        yield


@pytest.fixture
def keys(tmp_path) -> list[Path]:
    paths = [tmp_path / "a.key", tmp_path / "b.key"]
    for path in paths:
        write_key(path)
    return paths


@pytest.mark.parametrize("sent", DATAGRAMS)
def test_packets_of_every_protocol_are_recognised_by_a_receiver_of_any_other(sent):
    for received in DATAGRAMS:
        if received != sent:
            found = {recognise(data, StreamSettings(received, port=1)) for data in packets(sent)}
            assert found == {sent}, received


def test_packets_of_a_newer_phone_app_are_recognised():
    assert recognise(packets("face_motion")[0], StreamSettings("livelink")) == "ifacialmocap"


def test_noise_is_recognised_as_nothing():
    noise = (b"", b"hello", bytes(2000), b"{}", b"jawOpen", packets("vmc")[0][:40])
    assert not any(recognise(data, StreamSettings("livelink")) for data in noise)


def test_another_protocol_is_named_over_a_real_socket():
    port = free_port()
    with closing(StreamSource(StreamSettings("livelink", port=port))) as source, performed("vmc", port=port):
        message = said(source)
    assert message == source.problem
    assert message == "What arrives from 127.0.0.1 looks like VMC, not Live Link Face. Choose protocol vmc."


@pytest.mark.parametrize(
    ("there", "here", "wanted"),
    [(0, None, "none is set here"), (None, 0, "but one is set here"), (0, 1, "a different key")],
)
def test_keys_that_do_not_match_are_told_apart(keys, there, here, wanted):
    port = free_port()
    source = StreamSource(StreamSettings(port=port, key=None if here is None else keys[here]))
    with closing(source), performed(port=port, key=None if there is None else keys[there]):
        assert wanted in said(source)
    assert source.counts.refused and not source.counts.malformed


def test_the_message_ends_when_faces_arrive(keys):
    port = free_port()
    with closing(StreamSource(StreamSettings(port=port, key=keys[0]))) as source:
        with performed(port=port, key=keys[1]):
            said(source)
        with performed(port=port, key=keys[0]):
            collected(source, 5)
        assert source.message == ""


def test_packets_without_a_face_are_told_from_no_packets():
    port, bones = free_port(), osc.encode_message("/VMC/Ext/Bone/Pos", "Hips", *[0.0] * 6, 1.0)
    with closing(StreamSource(StreamSettings("vmc", port=port))) as source, flooded(port, bones):
        assert said(source).startswith("Packets arrive from 127.0.0.1, but no face in them.")


def test_a_few_packets_without_a_face_are_told_from_no_packets_as_well():
    port, now = free_port(), [0.0]
    bones = osc.encode_message("/VMC/Ext/Bone/Pos", "Hips", *[0.0] * 6, 1.0)
    source = StreamSource(StreamSettings("vmc", port=port), clock=lambda: now[0])
    with closing(source), closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
        end = time.monotonic() + PATIENCE
        while not source.counts.accepted:
            assert time.monotonic() < end
            sender.sendto(bones, ("127.0.0.1", port))
            time.sleep(0.02)
            source.read(0.0)
        assert source.problem.startswith("Packets arrive from 127.0.0.1, but no face in them.")


def test_packets_that_are_not_the_phones_are_told_with_both_addresses():
    port = free_port()
    source = StreamSource(StreamSettings("ifacialmocap", port=port, phone="127.0.0.9"))
    with closing(source), flooded(port, b"x"):
        assert said(source).startswith("Packets arrive from 127.0.0.1, but the phone is 127.0.0.9.")


def test_a_sender_that_was_not_chosen_is_named():
    port = free_port()
    source = StreamSource(StreamSettings("livelink", port=port, sender="Ada"))
    with closing(source), performed("livelink", port=port, subject="Ben"):
        end = time.monotonic() + PATIENCE
        while not source.senders:
            assert time.monotonic() < end
            source.read(0.02)
        assert source.problem.startswith("Faces arrive from 127.0.0.1 Ben, but not from Ada.")


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        (StreamSettings("livelink"), "which only this computer can send to"),
        (StreamSettings("livelink", host="0.0.0.0"), "Check the address and the port in the app, and the firewall."),
        (StreamSettings("ifacialmocap", phone="192.0.2.1"), "the phone 192.0.2.1"),
    ],
)
def test_without_any_packet_the_address_is_what_to_check(settings, wanted):
    now = [0.0]
    with closing(StreamSource(replace(settings, port=free_port()), clock=lambda: now[0])) as source:
        source.read(0.0)
        assert wanted in source.problem and source.message == ""
        now[0] = 60.0
        source.read(0.0)
        assert source.message == source.problem
    assert set(DATAGRAMS) <= set(PROTOCOLS)

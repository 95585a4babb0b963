"""Addresses, ports and settings of streams that cannot be used are refused or reported."""

import socket
from contextlib import closing
from pathlib import Path

import pytest

from facemime.core.errors import SourceError
from facemime.core.streams.sender import StreamSender
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import SendSettings, StreamSettings
from facemime.core.streams.transport.security import write_key
from facemime.core.takes.measured import coefficient_face
from tests.helpers.links import collected, free_port
from tests.helpers.owners import UNDER_WINE
from tests.helpers.takes import coefficient_take as acted


@pytest.mark.parametrize(
    "protocol",
    [
        pytest.param("livelink", marks=pytest.mark.skipif(UNDER_WINE, reason="wine listens on any address")),
        "vertices",
    ],
)
def test_an_address_of_another_computer_is_reported_as_such(protocol):
    source = StreamSource(StreamSettings(protocol, "192.0.2.7"))
    with closing(source), pytest.raises(SourceError, match=r"192.0.2.7 is not an address of this computer"):
        source.read(0.0)


def test_a_port_in_use_is_a_clear_error(opened):
    source = opened("livelink")
    with pytest.raises(SourceError, match="Cannot listen"):
        StreamSource(StreamSettings("livelink", port=source.address[1])).read(0.0)


@pytest.mark.parametrize(("protocol", "kind"), [("livelink", socket.SOCK_DGRAM), ("vertices", socket.SOCK_STREAM)])
def test_no_other_program_can_take_a_port_over(opened, protocol, kind):
    host, port = opened(protocol).address
    with socket.socket(socket.AF_INET, kind) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError):
            other.bind((host, port))


@pytest.mark.parametrize(("protocol", "answers"), [("livelink", 2.0), ("vmc", 0.0)])
def test_sending_to_a_port_that_nobody_listens_on_is_reported_until_somebody_does(monkeypatch, protocol, answers):
    monkeypatch.setattr("facemime.core.streams.sender._ANSWER", answers)
    port = free_port()
    with closing(StreamSender(SendSettings(protocol, port=port))) as sender:
        for number in range(6):
            sender.send(0.1 * number, acted(6).result(number), coefficient_face().neutral)
        assert sender.message.startswith(f"No program receives at 127.0.0.1:{port}.")
        monkeypatch.setattr("facemime.core.streams.sender._ANSWER", 0.0)
        with closing(StreamSource(StreamSettings(protocol, port=port))) as source:
            take = acted(30)
            collected(source, 5, lambda: sender.send(source._clock(), take.result(3), coefficient_face().neutral))
            assert sender.message == ""


def test_sending_with_a_key_to_a_port_that_nobody_listens_on_is_reported(tmp_path):
    write_key(tmp_path / "a.key")
    with closing(StreamSender(SendSettings(port=free_port(), key=tmp_path / "a.key"))) as sender:
        for number in range(6):
            sender._greeted = float("-inf")
            sender.send(0.1 * number, acted(6).result(number), coefficient_face().neutral)
    assert sender.message.startswith("No program receives at 127.0.0.1:")


def test_an_address_that_refuses_packets_is_reported_with_advice():
    sender = StreamSender(SendSettings("livelink", host="255.255.255.255"))
    sender.send(0.0, acted(5).result(0), coefficient_face().neutral)
    assert sender.message.startswith("Cannot send to 255.255.255.255:") and "Check the address" in sender.message
    assert sender.sent == 0
    sender.close()


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        (StreamSettings("nothing"), "no protocol"),
        (StreamSettings(port=99_999), "no port"),
        (StreamSettings(delay=-1.0), "delay"),
        (StreamSettings(delay=float("nan")), "delay"),
        (StreamSettings("livelink", angles="turns"), "radians"),
        (StreamSettings("livelink", flip=("up",)), "radians"),
        (StreamSettings("ifacialmocap"), "address of the phone"),
        (StreamSettings(host="0.0.0.0"), "shared key"),
        (StreamSettings(key=Path("/nowhere.key")), "no key"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(settings, match):
    with pytest.raises(SourceError, match=match):
        StreamSource(settings)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        (SendSettings("facecap"), "no protocol"),
        (SendSettings(host="192.168.1.7"), "shared key"),
        (SendSettings("vmc", host="no.such.host.invalid"), "was not found"),
    ],
)
def test_senders_that_cannot_be_used_are_refused(settings, match):
    with pytest.raises(SourceError, match=match):
        StreamSender(settings)

"""Addresses: which of them are this computer's, and how they are written."""

import errno
import socket
from typing import ClassVar

import pytest

from facemime.core.errors import SourceError
from facemime.core.streams.transport import addresses
from facemime.core.streams.transport.addresses import cannot_listen, is_loopback, parse_address


@pytest.mark.parametrize(
    ("host", "local"),
    [
        ("127.0.0.1", True),
        ("localhost", True),
        ("::1", True),
        ("127.9.9.9", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.7", False),
        ("phone.local", False),
        ("localhost.example.org", False),
        ("", False),
        ("127.1", False),
    ],
)
def test_only_addresses_of_this_computer_count_as_local(host, local):
    assert is_loopback(host) == local


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("192.168.1.7:39539", ("192.168.1.7", 39539)),
        ("phone.local", ("phone.local", 7)),
        (":5", ("127.0.0.1", 5)),
        ("[::1]:9", ("::1", 9)),
        ("::1", ("::1", 7)),
        ("", ("127.0.0.1", 7)),
    ],
)
def test_addresses_are_parsed(text, wanted):
    assert parse_address(text, 7) == wanted


@pytest.mark.parametrize("text", ["host:x", "host:99999", "http://host:5", "a b:5", "host:-1", "user@host:1"])
def test_invalid_addresses_are_refused(text):
    with pytest.raises(SourceError):
        parse_address(text)


def test_a_port_that_only_administrators_may_use_is_reported_as_such():
    denied = PermissionError(errno.EACCES, "Permission denied")
    assert "listen on port 443. Choose one of 1024 or above." in str(cannot_listen("127.0.0.1", 443, denied))
    assert "Permission denied" in str(cannot_listen("127.0.0.1", 8443, denied))


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_no_other_program_can_take_a_port_over_on_windows(monkeypatch, kind):
    class Opened:
        type = kind
        options: ClassVar[list[tuple[int, int, int]]] = []

        def setsockopt(self, *option: int) -> None:
            self.options.append(option)

        def bind(self, address: tuple[str, int]) -> None:
            assert self.options == [(socket.SOL_SOCKET, -5, 1)], "before the port is taken, and without SO_REUSEADDR"

    monkeypatch.setattr(addresses.sys, "platform", "win32")
    monkeypatch.setattr(socket, "SO_EXCLUSIVEADDRUSE", -5, raising=False)
    Opened.options.clear()
    addresses.bind(Opened(), ("127.0.0.1", 1))
    assert Opened.options

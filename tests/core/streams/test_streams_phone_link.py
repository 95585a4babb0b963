"""Face Motion 3 over TCP: the phone is called, or connects by itself, on real sockets."""

import socket
import struct
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from facemime.core.streams.stream_settings import PROTOCOLS
from tests.helpers.clocks import PATIENCE
from tests.helpers.face_motion_packets import GOOD, changed, datagrams, frame, played_as_sent, schema_payload
from tests.helpers.links import Phone, collected, free_port
from tests.helpers.takes import coefficient_take


class ConnectedPhone(Phone):
    """A phone that answers HELLO on a connection with whole messages.

    It connects to the port `calls` by itself, unless that is 0, and ends each connection after `frames` frames.
    """

    def __init__(self, monkeypatch, protocol: str, *, calls: int = 0, frames: int = 1000) -> None:
        super().__init__(monkeypatch, protocol, "phone_port")
        self.values = np.round(coefficient_take(12).coefficients, 2)
        self.heard: list[int] = []
        self.sessions = 0
        self._calls, self._frames = calls, frames
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.02)
        moved = replace(PROTOCOLS[protocol], motion_port=self._listener.getsockname()[1])
        monkeypatch.setitem(PROTOCOLS, protocol, moved)

    def run(self) -> None:
        while not self._ended.is_set():
            with suppress(OSError):
                if self._calls:
                    connection = socket.create_connection(("127.0.0.1", self._calls))
                else:
                    connection, _ = self._listener.accept()
                with connection:
                    connection.settimeout(0.02)
                    self._serve(connection)

    def close(self) -> None:
        super().close()
        self._listener.close()

    def _serve(self, connection: socket.socket) -> None:
        self.sessions += 1
        session, sent, waiting = 100 + self.sessions, 0, b""
        if self._calls:
            connection.sendall(self._schema(0, session))
        while not self._ended.is_set() and sent < self._frames:
            with suppress(TimeoutError):
                waiting += connection.recv(4096)
            while len(waiting) >= 40:
                length = 40 + struct.unpack_from("<I", waiting, 36)[0]
                message, waiting = waiting[:length], waiting[length:]
                self.heard.append(message[4])
                if message[4] == 1:
                    connection.sendall(self._schema(struct.unpack_from("<Q", message, 8)[0], session))
                if message[4] == 8:
                    self._ended.set()
            if self._calls or 1 in self.heard:
                values = np.round(100 * self.values[sent % len(self.values)]).astype(int).tolist()
                data = frame([*values, 7], sent, session=session)
                for piece in (data[:3], data[3:60], data[60:]):
                    connection.sendall(piece)
                sent += 1

    def _schema(self, nonce: int, session: int) -> bytes:
        (data,) = datagrams(2, schema_payload(nonce), session=session, schema=1, largest=10_000)
        return data


@pytest.mark.parametrize("protocol", ["ifacialmocap-tcp", "facemotion3d-tcp"])
def test_a_new_app_is_called_over_tcp_and_told_to_end(opened, monkeypatch, protocol):
    phone = ConnectedPhone(monkeypatch, protocol)
    phone.start()
    try:
        source = opened(protocol, phone="127.0.0.1", port=free_port(), host="127.0.0.1")
        assert played_as_sent(source, phone)
        source.close()
        phone.join(PATIENCE)
    finally:
        phone.close()
    assert phone.heard[0] == 1 and phone.heard[-1] == 8 and 3 not in phone.heard
    assert source.counts.malformed == source.counts.refused == 0


def test_a_lost_connection_is_called_again(opened, monkeypatch):
    phone = ConnectedPhone(monkeypatch, "ifacialmocap-tcp", frames=15)
    phone.start()
    try:
        source = opened("ifacialmocap-tcp", phone="127.0.0.1", port=free_port(), host="127.0.0.1")
        collected(source, 20)
    finally:
        phone.close()
    assert phone.sessions >= 2 and phone.heard.count(1) >= 2
    assert source.counts.malformed == 0


@pytest.mark.parametrize("second", [False, True])
def test_an_app_that_is_started_by_hand_connects_over_tcp(opened, monkeypatch, second):
    ports = free_port(), free_port()
    phone = ConnectedPhone(monkeypatch, "ifacialmocap-tcp", calls=ports[second])
    monkeypatch.setitem(PROTOCOLS, "ifacialmocap-tcp", replace(PROTOCOLS["ifacialmocap-tcp"], motion_port=ports[1]))
    source = opened("ifacialmocap-tcp", phone="127.0.0.1", port=ports[0], host="127.0.0.1")
    phone.start()
    try:
        assert played_as_sent(source, phone)
    finally:
        phone.close()
    assert 1 not in phone.heard and 3 not in phone.heard


def test_a_connection_with_an_impossible_header_is_closed(opened):
    source = opened("ifacialmocap-tcp", phone="127.0.0.1", port=free_port(), host="127.0.0.1")
    source.read(0.0)
    with socket.create_connection(source.address) as wrong:
        wrong.settimeout(PATIENCE)
        wrong.sendall(changed(GOOD, 39, 255))
        for _ in range(20):
            source.read(0.01)
        with suppress(ConnectionResetError):
            assert wrong.recv(1) == b""
    assert source.counts.accepted == 0

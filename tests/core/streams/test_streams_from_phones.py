"""Phones and Face Cap on real sockets: their faces are played, and packets of others are not."""

import json
import socket
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.face.names import COEFFICIENT_INDEX, N_COEFFICIENTS
from facemime.core.puppet.sources import LiveFrame
from facemime.core.streams.protocols import ifacialmocap, osc
from facemime.core.streams.protocols.face_cap import NAMES
from facemime.core.streams.stream_settings import PROTOCOLS, StreamProtocol
from facemime.core.takes.neutral import calibrate
from tests.helpers.clocks import PATIENCE, wait_for
from tests.helpers.links import Phone, collected, free_port, recorded, streamed
from tests.helpers.takes import coefficient_take as acted


def phone_text(values: np.ndarray) -> bytes:
    names = [name.replace("Left", "_L").replace("Right", "_R") for name in COEFFICIENT_INDEX]
    parts = [f"{name}-{round(100 * value)}" for name, value in zip(names, values.tolist(), strict=True)]
    return ("|".join(parts) + "|=head#5.0,-10.0,2.0,0.0,0.0,-0.5|rightEye#0,0,0|leftEye#0,0,0|").encode()


def phone_json(values: np.ndarray) -> bytes:
    entries = [{"k": name, "v": value} for name, value in zip(COEFFICIENT_INDEX, values.tolist(), strict=True)]
    vector = {"x": 0.0, "y": 0.0, "z": 0.0}
    stamp = int(1e3 * time.monotonic())
    packet = {"Timestamp": stamp, "FaceFound": True, "Rotation": vector, "Position": vector, "BlendShapes": entries}
    return json.dumps(packet).encode()


class AskedPhone(Phone):
    """A phone that sends only on request, to the address that the request came from."""

    def __init__(self, monkeypatch, protocol: str, packet, values: np.ndarray) -> None:
        super().__init__(monkeypatch, protocol, "phone_port")
        self.asked: list[bytes] = []
        self._packet, self._values = packet, values

    def run(self) -> None:
        number, where = 0, None
        while not self._ended.is_set():
            try:
                question, where = self._socket.recvfrom(4096)
                self.asked.append(question)
            except TimeoutError:
                if where is not None:
                    self._socket.sendto(self._packet(self._values[number % len(self._values)]), where)
                    number += 1


STORED = 1e-5
"""Precision of the values in a take."""


def check_bake(frames: list[LiveFrame], values: np.ndarray, precision: float, folder: Path) -> None:
    """Check that the take of these frames bakes to the values that were sent in turn, (N, 52)."""
    saved = recorded(frames, folder / "stream.facetake")
    sent = values[np.arange(len(frames)) % len(values)]
    np.testing.assert_allclose(arkit_coefficients(saved, calibrate(saved)), sent, atol=max(precision, STORED))


@pytest.mark.parametrize(
    ("protocol", "packet", "precision"),
    [("ifacialmocap", phone_text, 0.0051), ("facemotion3d", phone_text, 0.0051), ("vtubestudio", phone_json, 1e-6)],
)
def test_a_phone_is_asked_to_send_and_its_faces_are_played(opened, monkeypatch, tmp_path, protocol, packet, precision):
    values = acted(12).coefficients
    phone = AskedPhone(monkeypatch, protocol, packet, values)
    phone.start()
    try:
        source = opened(protocol, phone="127.0.0.1")
        frames = collected(source, 20)
        source.close()
        if stop := PROTOCOLS[protocol].stop:
            wait_for(lambda: phone.asked[-1] == stop)
    finally:
        phone.close()
    first = frames[0].result.coefficients
    at = int(np.abs(values - first).max(axis=1).argmin())
    for number, frame in enumerate(frames):
        np.testing.assert_allclose(frame.result.coefficients, values[(at + number) % len(values)], atol=precision)
    check_bake(frames, np.roll(values, -at, axis=0), precision, tmp_path)
    assert phone.asked and (protocol != "vtubestudio" or json.loads(phone.asked[0])["ports"] == [source.address[1]])


class ConnectingPhone(AskedPhone):
    """A phone that connects when it is asked to, and sends packets in pieces until it is asked to end."""

    def __init__(self, monkeypatch, protocol: str, values: np.ndarray, lead: bytes) -> None:
        super().__init__(monkeypatch, protocol, phone_text, values)
        self._protocol, self._lead = PROTOCOLS[protocol], lead

    def run(self) -> None:
        number, connected = 0, None
        while not self._ended.is_set():
            try:
                question, _ = self._socket.recvfrom(4096)
            except TimeoutError:
                question = b""
            if question:
                self.asked.append(question)
            if question == self._protocol.request(0) and connected is None:
                connected = socket.create_connection(("127.0.0.1", self._protocol.port))
            elif question == self._protocol.stop:
                break
            if connected is not None:
                data = self._lead + self._packet(self._values[number % len(self._values)]) + self._protocol.end
                with suppress(ConnectionError):  # closed, and the request to end comes next
                    for piece in (data[:100], data[100:-5], data[-5:]):
                        connected.sendall(piece)
                number += 1
        if connected is not None:
            connected.close()


@pytest.mark.parametrize(
    ("protocol", "lead", "asked"),
    [
        ("ifacialmocap-tcp", b"", (ifacialmocap.TCP_START, ifacialmocap.TCP_STOP)),
        ("facemotion3d-tcp", b"", (b"FACEMOTION3D_OtherStreaming|protocol=tcp", b"StopStreaming_FACEMOTION3D")),
        ("facemotion3d-tcp", b"___FACEMOTION3D", (ifacialmocap.FACEMOTION_TCP_START, ifacialmocap.FACEMOTION_STOP)),
    ],
)
def test_a_phone_is_asked_to_connect_and_to_end_and_its_packets_are_put_together(
    opened, monkeypatch, protocol, lead, asked
):
    values = acted(12).coefficients
    changed = PROTOCOLS[protocol].__dict__ | {"port": free_port(), "motion_port": free_port()}
    monkeypatch.setitem(PROTOCOLS, protocol, StreamProtocol(**changed))
    phone = ConnectingPhone(monkeypatch, protocol, values, lead)
    phone.start()
    try:
        source = opened(protocol, phone="127.0.0.1", port=changed["port"], host="127.0.0.1")
        frames = collected(source, 20)
        source.close()
        phone.join(PATIENCE)
        assert not phone.is_alive(), "it was asked to end"
    finally:
        phone.close()
    first = frames[0].result.coefficients
    at = int(np.abs(values - first).max(axis=1).argmin())
    for number, frame in enumerate(frames):
        np.testing.assert_allclose(frame.result.coefficients, values[(at + number) % len(values)], atol=0.0051)
    assert (phone.asked[0], phone.asked[-1]) == asked
    assert source.counts.accepted >= 20 and source.counts.malformed == 0


def test_a_connection_that_never_ends_a_packet_is_closed(opened):
    source = opened("ifacialmocap-tcp", phone="127.0.0.1", port=free_port(), host="127.0.0.1")
    source.read(0.0)
    with socket.create_connection(source.address) as endless:
        endless.settimeout(PATIENCE)
        for _ in range(50):
            with suppress(ConnectionError):
                endless.sendall(b"x" * 40_000)
            source.read(0.01)
        with suppress(ConnectionResetError):
            assert endless.recv(1) == b"", "the connection was closed"
    assert source.counts.accepted == 0


def test_face_cap_is_played(opened, tmp_path):
    take, source = acted(), opened("facecap")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def send(number: int) -> None:
            out.sendto(osc.encode_message("/HR", 0.0, 0.0, 0.0), source.address)
            for place, name in enumerate(NAMES):
                value = float(take.coefficients[number, COEFFICIENT_INDEX[name]])
                out.sendto(osc.encode_message("/W", place, value), source.address)

        frames = streamed(source, take, send)
    for number, frame in enumerate(frames):
        np.testing.assert_allclose(frame.result.coefficients, take.coefficients[number], atol=1e-6)
    check_bake(frames, take.coefficients, 1e-6, tmp_path)


def test_packets_that_are_not_the_phones_are_refused(opened):
    source = opened("ifacialmocap", phone="127.0.0.2", host="127.0.0.1")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.sendto(phone_text(np.zeros(N_COEFFICIENTS)), source.address)
    for _ in range(50):
        source.read(0.01)
    assert source.counts.refused == 1 and source.counts.accepted == 0
    assert ifacialmocap.PORT == 49983

"""Streams over TLS: only paired computers exchange faces, and lost connections are restored."""

from __future__ import annotations

import asyncio
import os
import socket
import ssl
import threading
import time
from contextlib import closing, suppress
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.errors import SourceError
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.core.streams.transport.addresses import ANSWER, GREETING, LENGTH, MAGIC, VERSION, Pairing, parse_pairing
from facemime.core.streams.transport.security import der_time, load_identity, renew_identity
from facemime.core.streams.transport.tls_server import TlsSender
from tests.helpers.clocks import PATIENCE, wait_for
from tests.helpers.links import performing
from tests.helpers.owners import who_can_open
from tests.helpers.takes import performance


@pytest.fixture(scope="module")
def identity(tmp_path_factory):
    """A certificate and a token."""
    return load_identity(tmp_path_factory.mktemp("tls"))


@pytest.fixture
def server(identity):
    """A sender, and a thread that keeps sending the frames of a take."""
    with (
        closing(TlsSender("127.0.0.1", 0, identity.context, identity.token)) as sender,
        performing(sender, performance()),
    ):
        yield sender


def pairing_of(identity, port: int) -> Pairing:
    return identity.pairing("127.0.0.1", port)


def opened(pairing: Pairing) -> StreamSource:
    return StreamSource(StreamSettings(pairing=pairing))


def frames_from(source: StreamSource, count: int) -> list:
    frames, end = [], time.monotonic() + PATIENCE
    while len(frames) < count:
        assert time.monotonic() < end, source.message
        frame = source.read(0.05)
        if frame is not None and not frame.filled:
            frames.append(frame)
    return frames


def error_of(source: StreamSource) -> str:
    end = time.monotonic() + PATIENCE
    with pytest.raises(SourceError) as raised:
        while time.monotonic() < end:
            source.read(0.05)
    return str(raised.value)


def message_of(source: StreamSource) -> str:
    end = time.monotonic() + PATIENCE
    while not source.message:
        assert time.monotonic() < end and source.read(0.05) is None
    return source.message


@given(st.binary(min_size=16, max_size=16), st.binary(min_size=32, max_size=32), st.integers(1, 65535))
def test_a_pairing_line_contains_the_whole_pairing(token, fingerprint, port):
    for host in ("192.168.1.7", "studio.example", "2001:db8::1"):
        pairing = Pairing(host, port, fingerprint, token)
        assert parse_pairing(f"  {pairing.line}\n") == pairing


@pytest.mark.parametrize(
    "text", ["", "facemime://", "192.168.1.7:21576", "https://example.org/", "facemime://ab@h:1/cd"]
)
def test_anything_else_is_not_a_pairing_line(text):
    with pytest.raises(SourceError, match="pairing line"):
        parse_pairing(text)


def test_landmarks_arrive_over_tls(identity, server):
    take = performance()
    with closing(opened(pairing_of(identity, server.port))) as source:
        frames = frames_from(source, 30)
        assert source.message == "" and source.counts.malformed == source.counts.refused == 0
        assert server.receivers == 1
    for frame in (frame for frame in frames if frame.result.found):
        assert np.nanmin(np.abs(take.shape - frame.result.shape).max(axis=(1, 2))) <= 2.0**-13
    assert all(after.time > before.time for before, after in pairwise(frames))
    wait_for(lambda: server.receivers == 0)


def test_another_certificate_is_refused_before_the_token_is_shown(identity, tmp_path):
    impostor = load_identity(tmp_path / "impostor")
    with closing(TlsSender("127.0.0.1", 0, impostor.context, identity.token)) as server:
        with closing(opened(pairing_of(identity, server.port))) as source:
            assert "certificate is different" in error_of(source)
        assert server.receivers == server.sent == 0


def test_another_token_is_refused(identity, server):
    wrong = replace(pairing_of(identity, server.port), token=os.urandom(16))
    with closing(opened(wrong)) as source:
        assert "does not know this token" in error_of(source)
    assert server.sent == 0 and server.refused == 1


def test_a_lost_connection_is_restored(identity):
    take = performance()
    first = TlsSender("127.0.0.1", 0, identity.context, identity.token)
    over = threading.Event()
    senders = [first]

    def send() -> None:
        began = time.monotonic()
        while not over.wait(1.0 / 60.0):
            for sender in tuple(senders):
                sender.send(time.monotonic() - began, take.result(0), None)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        with closing(opened(pairing_of(identity, first.port))) as source:
            frames_from(source, 5)
            senders.clear()
            first.close()
            end = time.monotonic() + PATIENCE
            while not source.message and time.monotonic() < end:
                source.read(0.05)
            assert "keeps trying" in source.message
            senders.append(TlsSender("127.0.0.1", first.port, identity.context, identity.token))
            frames_from(source, 5)
            assert source.message == ""
    finally:
        over.set()
        thread.join()
        for sender in senders:
            sender.close()


def test_a_lost_cancellation_does_not_keep_the_server_running(identity, monkeypatch):
    waits, lost = asyncio.wait_for, []

    async def forgetful(future, seconds):
        """Behave like `wait_for` of Python 3.11 if the future is done at the moment of the cancellation."""
        try:
            return await waits(future, seconds)
        except asyncio.CancelledError:
            lost.append(seconds)

    monkeypatch.setattr(asyncio, "wait_for", forgetful)
    sender = TlsSender("127.0.0.1", 0, identity.context, identity.token)
    with closing(opened(pairing_of(identity, sender.port))) as source:
        end = time.monotonic() + PATIENCE
        while not sender.receivers and time.monotonic() < end:
            source.read(0.05)
        sender.close()
        assert lost and not sender._thread.is_alive()
        assert "keeps trying" in message_of(source)


def test_a_peer_that_is_absent_or_lacks_tls_is_reported_and_retried(identity):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with closing(opened(pairing_of(identity, port))) as source:
            source.read(0.05)
            connection, _ = listener.accept()
            with connection:
                connection.sendall(b"220 mail.example\r\n" * 8)
                assert "does not support TLS" in message_of(source)
    with closing(opened(pairing_of(identity, port))) as source:
        assert "No data from 127.0.0.1" in message_of(source)


def test_a_silent_peer_is_abandoned(identity, monkeypatch):
    monkeypatch.setattr("facemime.core.streams.tls_client._PATIENCE", 0.2)
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        closing(opened(pairing_of(identity, listener.getsockname()[1]))) as source,
    ):
        assert "does not answer" in message_of(source)


@pytest.mark.parametrize("flood", [b"\xff" * 4096, LENGTH.pack(100) + bytes(100), LENGTH.pack(0)])
def test_a_flooding_peer_takes_no_memory(identity, flood):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.1)
        over = threading.Event()

        def serve() -> None:
            while not over.is_set():
                try:
                    connection, _ = listener.accept()
                    with identity.context.wrap_socket(connection, server_side=True) as secured:
                        secured.recv(GREETING.size)
                        secured.sendall(ANSWER.pack(MAGIC, VERSION, 0))
                        while not over.is_set():
                            secured.sendall(flood * 16)
                except OSError:
                    continue

        thread = threading.Thread(target=serve)
        thread.start()
        with closing(opened(pairing_of(identity, listener.getsockname()[1]))) as source:
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                assert source.read(0.02) is None
            assert len(source._link._data) <= 1 << 15
            assert source.counts.accepted == 0 and not source.senders
        over.set()
        thread.join(PATIENCE)


def test_unknown_clients_that_send_nothing_or_too_much_do_not_block_others(identity, server):
    silent = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(12)]
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    wait_for(lambda: server.refused >= 8)
    for each in silent:
        each.close()
    with closing(opened(pairing_of(identity, server.port))) as source:
        frames_from(source, 3)
        with context.wrap_socket(socket.create_connection(("127.0.0.1", server.port))) as talker:
            talker.settimeout(PATIENCE)
            answer = b""
            with suppress(OSError):
                talker.sendall(b"GET / HTTP/1.1\r\nHost: a.example\r\n\r\n" + b"x" * 100_000)
            with suppress(OSError):
                while portion := talker.recv(100):
                    answer += portion
            assert len(answer) <= ANSWER.size
        frames_from(source, 3)
        assert server.receivers == 1


def test_the_identity_stays_and_only_its_owner_can_read_it(tmp_path):
    first, again = load_identity(tmp_path / "mine"), load_identity(tmp_path / "mine")
    other = load_identity(tmp_path / "other")
    assert (first.fingerprint, first.token) == (again.fingerprint, again.token)
    assert first.fingerprint != other.fingerprint and first.token != other.token
    assert all(who_can_open(path) == {"owner"} for path in (tmp_path / "mine").iterdir())


def verified_by_openssl(folder) -> bool:
    """Whether OpenSSL verifies the certificate of an identity, if it trusts it, with the signature on itself."""
    identity, stored = load_identity(folder), folder / "certificate.pem"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_flags |= 0x4000  # X509_V_FLAG_CHECK_SS_SIGNATURE
    context.load_verify_locations(cadata=stored.read_text())
    with (
        closing(TlsSender("127.0.0.1", 0, identity.context, identity.token)) as sender,
        socket.create_connection(("127.0.0.1", sender.port), PATIENCE) as connection,
    ):
        try:
            with context.wrap_socket(connection) as secured:
                return secured.version() == "TLSv1.3"
        except ssl.SSLCertVerificationError:
            return False


def test_openssl_verifies_the_certificate_with_its_own_signature(tmp_path):
    load_identity(tmp_path)
    assert verified_by_openssl(tmp_path)
    stored = tmp_path / "certificate.pem"
    damaged = bytearray(ssl.PEM_cert_to_DER_cert(stored.read_text()))
    damaged[-1] ^= 1
    stored.write_text(ssl.DER_cert_to_PEM_cert(bytes(damaged)))
    assert not verified_by_openssl(tmp_path)


@pytest.mark.parametrize(("year", "expected"), [(2049, (0x17, b"490102030405Z")), (2050, (0x18, b"20500102030405Z"))])
def test_times_are_written_with_four_digits_of_the_year_from_2050_on(year, expected):
    assert der_time(datetime(year, 1, 2, 3, 4, 5, tzinfo=UTC)) == expected


def test_a_renewed_identity_revokes_earlier_lines(tmp_path):
    before = load_identity(tmp_path)
    renew_identity(tmp_path)
    after = load_identity(tmp_path)
    assert after.fingerprint != before.fingerprint and after.token != before.token


def test_the_line_states_the_public_address_or_else_this_computers(identity):
    assert identity.pairing("192.168.1.7", 21576).address == "192.168.1.7:21576"
    assert identity.pairing("0.0.0.0", 21576, "studio.example").address == "studio.example:21576"
    assert identity.pairing("0.0.0.0", 21576, "studio.example:443").address == "studio.example:443"
    with pytest.raises(SourceError, match="not an address"):
        identity.pairing("0.0.0.0", 21576, "http://studio.example")


def test_a_damaged_identity_is_a_clear_error(tmp_path):
    load_identity(tmp_path)
    for name, content in (("token", b"00\n"), ("token", b"none"), ("key.pem", b""), ("certificate.pem", b"x" * 100)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SourceError, match="pair again"):
            load_identity(tmp_path)


def test_pairing_works_only_with_facemimes_own_protocol(identity):
    with pytest.raises(SourceError, match="only with Facemime's own protocol"):
        StreamSource(StreamSettings("vmc", pairing=pairing_of(identity, 1)))

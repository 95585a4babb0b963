"""The viewer's server over real sockets: who may watch, what is streamed, and that nobody can hold it up."""

from __future__ import annotations

import gzip
import http.client
import json
import re
import shutil
import socket
import ssl
import struct
import subprocess
import threading
from contextlib import ExitStack, closing
from time import perf_counter
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from facemime.core.errors import ModelError, OutputError, SourceError
from facemime.core.viewer import page
from facemime.core.viewer.gate import MAX_STRANGERS
from facemime.core.viewer.messages import CLOCK, FRAME
from facemime.core.viewer.server import ViewerServer
from facemime.core.viewer.viewer_settings import MAX_VIEWERS, ViewerSettings, as_text, kept_token, new_token, qr_code
from tests.helpers.clocks import PATIENCE, wait_for
from tests.helpers.owners import who_can_open
from tests.helpers.viewer.watching import Watched, face, plain

pytestmark = pytest.mark.skipif(not (page.PAGE / page.BUILT).is_file(), reason="the page is not built: make viewer")


@pytest.fixture
def shown():
    """A server with the built-in head, one frame of which has been shown."""
    watched = Watched()
    watched.show(face())
    yield watched
    watched.close()


def get(address: str, path: str = "", method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    parts = urlsplit(address)
    with closing(http.client.HTTPConnection(parts.hostname, parts.port, timeout=PATIENCE)) as connection:
        connection.request(method, parts.path + path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def stream(address: str, **options):
    return connect(address.replace("http", "ws", 1) + "stream", open_timeout=PATIENCE, **options)


def messages(viewer, kind: int):
    """Return the next binary message of a kind."""
    while True:
        data = viewer.recv(timeout=PATIENCE)
        if isinstance(data, bytes) and data[0] == kind:
            return data


def test_the_page_comes_with_headers_that_isolate_it(shown):
    status, headers, body = get(shown.address)
    assert status == 200 and b"viewer." in body and headers["Content-Type"].startswith("text/html")
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src") and "unsafe" not in policy
    assert headers["Referrer-Policy"] == "no-referrer" and headers["Cache-Control"] == "no-store"


def names_of(shown) -> list[str]:
    """Names of everything that the page loads, as its HTML and the stream state them."""
    files = re.findall(r'(?:href|src)="([^"]+)"', get(shown.address)[2].decode())
    with stream(shown.address) as viewer:
        place = json.loads(viewer.recv(timeout=PATIENCE))["path"]
    return [*files, f"{place}/0/model", *(f"{place}/0/{number}" for number in range(5))]


def test_everything_that_the_page_loads_is_compressed_and_kept_under_a_name_of_its_content(shown):
    names = names_of(shown)
    assert len(names) == 9 and [name.rpartition(".")[2] for name in names[:3]] == ["svg", "css", "js"]
    kept = "private, max-age=31536000, immutable"
    plain = packed = 0
    for name in names:
        status, headers, body = get(shown.address, name)
        assert status == 200 and headers["Cache-Control"] == kept and "Content-Encoding" not in headers, name
        status, headers, small = get(shown.address, name, **{"Accept-Encoding": "br;q=1.0, gzip;q=0.8"})
        assert status == 200 and headers["Vary"] == "Accept-Encoding" and len(small) == int(headers["Content-Length"])
        assert (gzip.decompress(small) if headers.get("Content-Encoding") == "gzip" else small) == body, name
        plain, packed = plain + len(body), packed + len(small)
    assert packed < 0.6 * plain
    assert names_of(shown) == names


def test_another_head_has_other_names_and_the_same_head_the_same_in_another_server(shown):
    names = names_of(shown)
    watched, other = Watched(), Watched((shown.drivers[0], plain(shown.drivers[0].rig)))
    with closing(watched), closing(other):
        watched.show(face(2))
        assert names_of(watched) == names
        other.show(face())
        with stream(other.address) as viewer:
            assert json.loads(viewer.recv(timeout=PATIENCE))["path"] != names[3].partition("/")[0]


@pytest.mark.parametrize("name", ("{0}/1/model", "{0}/0/9", "{0}/-1/0", "{0}/0/99999999", "1/0/model", "/0/model"))
def test_other_heads_and_images_are_not_found(shown, name):
    assert get(shown.address, name.format(names_of(shown)[3].partition("/")[0]))[0] == 404


@pytest.mark.parametrize("path", ("../index.html", "//", "%2e%2e/", "built/viewer.js", "viewer.js", "index.html"))
def test_any_other_path_is_not_found(shown, path):
    assert get(shown.address, path)[0] == 404


@pytest.mark.parametrize(
    "change",
    (lambda t: "", lambda t: t[:-1], lambda t: t + "a", lambda t: "ab"[t[0] == "a"] + t[1:], lambda t: "=" + t),
)
def test_without_the_token_nothing_is_found(shown, change):
    token = urlsplit(shown.address).path.strip("/")
    address = shown.address.replace(token, change(token))
    assert get(address)[0] == 404
    with pytest.raises(InvalidStatus, match="404"), stream(address):
        pass


@pytest.mark.parametrize("host", ("evil.example", "evil.example:21574", "192.168.1.7", "127.0.0.1.evil.example", ""))
def test_a_foreign_name_that_resolves_here_is_refused(shown, host):
    assert get(shown.address, Host=host)[0] == 421


@pytest.mark.parametrize(
    "host",
    (
        "127.0.0.1:80; script-src *",
        "localhost:1 evil.example",
        "localhost:",
        "localhost:1:2",
        "[::1]x:5",
        "local\thost",
        "localhost, localhost",
    ),
)
def test_a_host_that_is_more_than_a_name_and_a_port_is_refused_rather_than_repeated(shown, host):
    status, headers, _ = get(shown.address, Host=host)
    assert status == 421 and not [value for value in headers.values() if host in value]


def test_a_request_with_two_hosts_is_refused(shown):
    parts = urlsplit(shown.address)
    with socket.create_connection((parts.hostname, parts.port), PATIENCE) as connection:
        connection.sendall(f"GET {parts.path} HTTP/1.1\r\nHost: localhost\r\nHost: 127.0.0.1\r\n\r\n".encode())
        assert connection.recv(4096).startswith(b"HTTP/1.1 421 ")


@pytest.mark.parametrize("method", ("POST", "PUT", "TRACE", "DELETE", "OPTIONS", "CONNECT", "HEAD", "get"))
def test_a_page_can_only_be_got(shown, method):
    status, headers, body = get(shown.address, method=method)
    assert status == 405 and headers["Allow"] == "GET" and b"viewer." not in body


@pytest.mark.parametrize("what", (b"", b"GET / HTTP/1.1\r\nHost:", b"\x16\x03\x01\x02\x00", b"GET"))
def test_strangers_who_say_nothing_give_way_to_a_page(shown, what):
    parts = urlsplit(shown.address)
    with ExitStack() as strangers, stream(shown.address) as viewer:
        kept = []
        for _ in range(5 * MAX_STRANGERS):
            kept.append(strangers.enter_context(socket.create_connection((parts.hostname, parts.port), PATIENCE)))
            kept[-1].sendall(what)
        assert get(shown.address)[0] == 200
        shown.show(face(1))
        messages(viewer, FRAME)
        assert len(shown.server._gate._guests) <= MAX_STRANGERS + 1
    wait_for(lambda: not shown.server._gate._guests)


@pytest.mark.parametrize("host", ("localhost", "127.0.0.1:5", "[::1]:5", socket.gethostname()))
def test_names_of_this_computer_are_accepted(shown, host):
    assert get(shown.address, Host=host)[0] == 200


def test_a_page_of_another_site_cannot_watch(shown):
    with pytest.raises(InvalidStatus, match="403"), stream(shown.address, origin="http://evil.example"):
        pass
    own = urlsplit(shown.address)
    with stream(shown.address, origin=f"http://{own.netloc}") as viewer:
        assert json.loads(viewer.recv(timeout=PATIENCE))["images"] == [5]


def test_a_frame_is_small_and_as_exact_as_documented(shown):
    with stream(shown.address) as viewer:
        messages(viewer, FRAME)
        (frame,) = shown.show(face(1))
        data = messages(viewer, FRAME)
    assert len(data) == 16 + 64 + 2 * 198 + 2 * 15 + 2
    kind, heads, scene, number, _ = struct.unpack_from("<BBHId", data)
    assert (kind, heads, scene, number) == (FRAME, 1, 1, 2)
    unit = shown.drivers[0].rig.eye_distance
    moved = np.frombuffer(data, "<i2", 198, 80).reshape(66, 3) * 2.0**-14 * unit
    np.testing.assert_allclose(moved, frame.displacements, atol=2.0**-15 * unit * 1.01)
    turned = np.frombuffer(data, "<f4", 3, 16).astype(float)
    np.testing.assert_allclose(cv2.Rodrigues(turned)[0], frame.rotation, atol=1e-6)
    np.testing.assert_allclose(np.frombuffer(data, "<i2", 15, 476) * 2.0**-13, frame.actions, atol=2.0**-14 * 1.01)


def test_the_server_tells_its_clock(shown):
    with stream(shown.address) as viewer:
        before = perf_counter()
        viewer.send(struct.pack("<d", 123.5))
        data = messages(viewer, CLOCK)
    sent, now = struct.unpack_from("<dd", data, 8)
    assert sent == 123.5 and before <= now <= perf_counter()


@pytest.mark.parametrize("message", ("text", b"123456789", b"x" * 65, b"x" * 1_000_000))
def test_a_page_that_sends_anything_else_is_disconnected(shown, message):
    with stream(shown.address, max_size=None) as viewer, pytest.raises(ConnectionClosed):
        viewer.send(message)
        while True:
            viewer.recv(timeout=PATIENCE)
    wait_for(lambda: shown.server.viewers == 0)


def test_a_page_that_asks_too_often_is_disconnected(shown):
    with stream(shown.address) as viewer, pytest.raises(ConnectionClosed):
        for _ in range(1000):
            viewer.send(struct.pack("<d", 0.0))
        while True:
            viewer.recv(timeout=PATIENCE)


def test_the_number_of_viewers_is_limited(shown):
    with ExitStack() as open_pages:
        for _ in range(MAX_VIEWERS - 1):
            open_pages.enter_context(stream(shown.address))
        with stream(shown.address):
            wait_for(lambda: shown.server.viewers == MAX_VIEWERS)
            with pytest.raises(InvalidStatus, match="503"), stream(shown.address):
                pass
        wait_for(lambda: shown.server.viewers == MAX_VIEWERS - 1)
        with stream(shown.address):
            pass


@pytest.mark.thorough
def test_a_viewer_that_does_not_read_gets_the_newest_frame_and_delays_nobody(shown):
    with stream(shown.address) as quick, stream(shown.address, max_queue=1) as slow:
        frames = shown.drivers[0].frame(face(1))
        for _ in range(20_000):
            shown.server.show(perf_counter(), shown.drivers, [frames])
        last = shown.server.sent

        def number(viewer) -> int:
            return struct.unpack_from("<BBHI", messages(viewer, FRAME))[3]

        received = 0
        while number(quick) != last:
            pass
        while number(slow) != last:
            received += 1
    assert received < 20_000


def test_a_port_in_use_is_a_clear_error(shown):
    port = urlsplit(shown.address).port
    with pytest.raises(SourceError, match=f"Cannot listen on 127.0.0.1:{port}"):
        ViewerServer(ViewerSettings(port=port), [])


def test_nothing_is_left_when_it_is_closed():
    before = threading.active_count()
    watched = Watched()
    with stream(watched.address) as viewer:
        watched.close()
        watched.close()
        with pytest.raises(ConnectionClosed):
            while True:
                viewer.recv(timeout=PATIENCE)
    wait_for(lambda: threading.active_count() == before)
    watched.show(face())


def test_a_page_without_three_js_is_a_clear_error(monkeypatch, tmp_path):
    monkeypatch.setattr(page, "PAGE", tmp_path)
    page.page_files.cache_clear()
    try:
        with pytest.raises(ModelError, match="make viewer"):
            ViewerServer(ViewerSettings(port=0), [])
    finally:
        page.page_files.cache_clear()


@pytest.fixture
def certificate(tmp_path):
    """A certificate of localhost and its key."""
    files = tmp_path / "cert.pem", tmp_path / "key.pem"
    line = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    line += ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-out", str(files[0]), "-keyout", str(files[1])]
    if not shutil.which("openssl") or subprocess.run(line, capture_output=True, check=False).returncode:
        pytest.skip("openssl is missing")
    return files


def test_https_serves_with_the_users_certificate(certificate):
    watched = Watched(certificate=certificate[0], key=certificate[1])
    trusting = ssl.create_default_context(cafile=str(certificate[0]))
    assert watched.address.startswith("https://")
    with connect(watched.address.replace("https", "wss") + "stream", ssl=trusting, open_timeout=PATIENCE) as viewer:
        assert json.loads(viewer.recv(timeout=PATIENCE))["scene"] == 0
    watched.close()


def test_certificates_that_cannot_be_used_are_clear_errors(certificate, tmp_path):
    (tmp_path / "none.pem").write_text("nothing")
    for cert, key, message in (
        (tmp_path / "missing.pem", None, "There is no certificate"),
        (tmp_path / "none.pem", certificate[1], "cannot be used"),
        (None, certificate[1], "Give the certificate, too"),
    ):
        with pytest.raises(SourceError, match=message):
            ViewerSettings(certificate=cert, key=key).context()


def test_a_token_is_kept_in_a_file_that_only_its_owner_reads(tmp_path):
    path = tmp_path / "token"
    token = kept_token(path)
    assert kept_token(path) == token and len(token) >= 22 and token != new_token()
    assert who_can_open(path) == {"owner"}
    path.write_text("short")
    with pytest.raises(SourceError, match="has no token"):
        kept_token(path)
    with pytest.raises(OutputError, match="cannot be written"):
        kept_token(tmp_path / "nowhere" / "token")


def test_the_qr_code_contains_the_address():
    address = "https://192.168.1.7:21574/abcDEF-_1234567890xyz/"
    code = qr_code(address)
    image = np.where(np.kron(code, np.ones((8, 8))), 0, 255).astype(np.uint8)
    assert cv2.QRCodeDetector().detectAndDecode(image)[0] == address
    assert len({len(line) for line in as_text(code).split("\n")}) == 1

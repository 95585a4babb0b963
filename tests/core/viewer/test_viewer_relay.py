"""A relay passes frames on to viewers, who can only watch; the page and the heads are static files."""

from __future__ import annotations

import html
import json
import shutil
import subprocess
from contextlib import closing, suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import OutputError, SourceError
from facemime.core.viewer.messages import (
    MAX_PAYLOAD,
    NatsError,
    NatsReader,
    connecting,
    encode_frame,
    publishing,
    subscribing,
)
from facemime.core.viewer.model import viewer_model
from facemime.core.viewer.page import PAGE
from facemime.core.viewer.relay import RelaySender
from facemime.core.viewer.site import SENDER, SUBJECT, VIEWER, Relay, Site
from tests.helpers.clocks import PATIENCE, wait_for
from tests.helpers.commands import START, run
from tests.helpers.links import free_port
from tests.helpers.owners import who_can_open
from tests.helpers.relays import new_site, relaying, watching
from tests.helpers.viewer.watching import NEUTRAL, built_in, face

pytestmark = pytest.mark.skipif(not (PAGE / "built").is_dir(), reason="the page is not built: make viewer")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A site whose relay runs."""
    made = new_site(tmp_path_factory.mktemp("site"))
    with relaying(made):
        yield made


def test_viewers_receive_the_frames_that_were_sent_once(site):
    driver, looks = built_in()
    frame = driver.frame(face(3))
    with closing(RelaySender(site, [looks])) as sender, watching(site) as ada, watching(site) as ben:
        received = []
        for number in range(1, 4):
            sender.show(float(number), [driver], [frame])
            wait_for(lambda: sender.sent == number)  # noqa: B023 - called at once
            received.append((ada.next("MSG", PATIENCE), ben.next("MSG", PATIENCE)))
        assert sender.sent == 3 and not sender.message
        described = json.loads((site.page / "scene.json").read_text())
        models = [viewer_model(driver, looks)]
        for number, frames in enumerate(received, 1):
            expected = encode_frame(described["scene"], number, float(number), models, [frame], (True, False))
            assert frames == (expected, expected)
        assert (site.page / described["path"] / "0" / "model").read_bytes() == models[0].data
        assert described["images"] == [len(models[0].images)]


def test_another_head_is_another_scene_whose_files_are_there_before_its_frames(site):
    driver, looks = built_in()
    larger = HeadDriver(replace(driver.rig, vertices=2.0 * driver.rig.vertices), NEUTRAL)
    scenes = []
    with closing(RelaySender(site, [looks])) as sender, watching(site) as viewer:
        for one in (driver, larger):
            sender.show(0.0, [one], [one.frame(face(1))])
            data = viewer.next("MSG", PATIENCE)
            described = json.loads((site.page / "scene.json").read_text())
            assert described["scene"] == int.from_bytes(data[2:4], "little")
            assert (site.page / described["path"] / "0" / "model").is_file()
            scenes.append(described)
    assert scenes[0]["scene"] != scenes[1]["scene"] and scenes[0]["path"] != scenes[1]["path"]


def test_a_relay_that_starts_later_or_again_gets_the_newest_frame(tmp_path):
    made, (driver, looks) = new_site(tmp_path), built_in()
    with closing(RelaySender(made, [looks])) as sender:
        wait_for(lambda: "does not answer" in sender.message)
        assert str(made.configuration) in sender.message
        for taken in (1.0, 2.0):
            sender.show(taken, [driver], [driver.frame(face(1))])
        for _ in range(2):
            with relaying(made):
                wait_for(lambda: not sender.message)
                with watching(made) as viewer:
                    sender.show(3.0, [driver], [driver.frame(face(1))])
                    while int.from_bytes(viewer.next("MSG", PATIENCE)[4:8], "little") < 3:
                        pass
            wait_for(lambda: bool(sender.message))


@pytest.mark.parametrize("subject", [">", "*", "facemime.>", "$SYS.>", "another"])
def test_a_viewer_can_subscribe_to_nothing_else(site, subject):
    with watching(site, subject=subject) as viewer:
        assert "Permissions Violation" in viewer.next("-ERR", PATIENCE)


def test_a_viewer_cannot_send_and_the_sender_cannot_watch(site):
    with watching(site) as viewer:
        viewer.connection.send(publishing(SUBJECT, b"forged"))
        assert "Permissions Violation" in viewer.next("-ERR", PATIENCE)
        with pytest.raises(TimeoutError):
            viewer.next("MSG", 0.2)
    with watching(site, SENDER, password=site.password) as sender:
        assert "Permissions Violation" in sender.next("-ERR", PATIENCE)


@pytest.mark.parametrize(("user", "password"), [(VIEWER, "0" * 32), (SENDER, ""), ("", ""), ("admin", "")])
def test_nobody_connects_with_another_password(site, user, password):
    with watching(site, user, password=password or "1") as viewer:
        assert "Authorization Violation" in viewer.next("-ERR", PATIENCE)
        with pytest.raises(ConnectionClosed):
            viewer.next("MSG", PATIENCE)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_a_relay_with_a_certificate_is_reached_over_tls(tmp_path):
    files = tmp_path / "certificate.pem", tmp_path / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=relay", "-addext"]
        + ["subjectAltName=DNS:localhost", "-out", str(files[0]), "-keyout", str(files[1])],
        check=True,
        capture_output=True,
    )
    made = Site(tmp_path, Relay(f"wss://localhost:{free_port()}/", *files))
    driver, looks = built_in()
    with relaying(made), closing(RelaySender(made, [looks])) as sender:
        sender.show(1.0, [driver], [driver.frame(face(3))])
        wait_for(lambda: sender.sent == 1)
    page = html.unescape((made.page / "index.html").read_text())
    assert f"connect-src 'self' {made.relay.url};" in page


def test_a_refused_sender_says_so(site, tmp_path):
    _, looks = built_in()
    other = Site(tmp_path, site.relay)
    with closing(RelaySender(other, [looks])) as sender:
        wait_for(lambda: "refused: authorization violation" in sender.message)
        assert sender.sent == 0


def test_a_viewer_that_falls_behind_is_disconnected_and_another_gets_every_frame(tmp_path):
    made, count, repeated = new_site(tmp_path), 5000, 1000
    with (
        relaying(made),
        watching(made) as prompt,
        connect(made.relay.url, compression=None, proxy=None) as sender,
        connect(made.relay.url, compression=None, proxy=None, max_queue=1) as slow,
    ):
        slow.send(connecting(VIEWER, made.page.name) + subscribing(SUBJECT))  # and reads nothing
        sender.send(connecting(SENDER, made.password))
        for number in range(count):
            sender.send(publishing(SUBJECT, number.to_bytes(4, "little") * repeated))
            assert int.from_bytes(prompt.next("MSG", PATIENCE)[:4], "little") == number
        read = 0
        with pytest.raises(ConnectionClosed):
            while read < count * repeated * 4:
                read += len(slow.recv(PATIENCE))


@pytest.mark.parametrize(
    "url", ["", "nats://a:4222", "http://a", "ws://", "ws://a:0", "ws://a:99999", "ws://u:p@a", "ws://a b", "ws://a?b"]
)
def test_an_address_that_is_no_relay_is_a_clear_error(url, tmp_path):
    with pytest.raises(SourceError, match="not the address of a relay"):
        Site(tmp_path / "site", Relay(url))
    assert not (tmp_path / "site").exists()


def test_secrets_stay_and_only_their_owner_can_read_them(tmp_path):
    first, again = new_site(tmp_path), new_site(tmp_path)
    assert (first.page, first.password) == (again.page, again.password) and first.password != first.page.name
    assert all(who_can_open(path) == {"owner"} for path in (first.configuration, tmp_path / "secrets.json"))
    public = "".join(path.read_text(errors="replace") for path in first.public.rglob("*.html"))
    assert first.password not in public and first.page.name in public


@pytest.mark.parametrize("content", [b"", b"[]", b'{"send": 1}', b'{"send": "\\"}", "watch": "../.."}', b"x" * 5000])
def test_damaged_secrets_are_a_clear_error(content, tmp_path):
    (tmp_path / "secrets.json").write_bytes(content)
    with pytest.raises(SourceError, match="Delete the folder"):
        new_site(tmp_path)


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Choose another folder"):
        new_site(tmp_path / "file" / "site")


@given(st.lists(st.binary(max_size=300), max_size=5), st.integers(1, 50))
def test_messages_are_read_whatever_portions_they_arrive_in(payloads, portion):
    data = b"INFO {}\r\n" + b"".join(b"MSG facemime 1 %d\r\n%s\r\nPING\r\n" % (len(one), one) for one in payloads)
    reader = NatsReader()
    found = [one for at in range(0, len(data), portion) for one in reader.feed(data[at : at + portion])]
    assert [one.payload for one in found if one.verb == "MSG"] == payloads
    assert [one.verb for one in found].count("PING") == len(payloads)


@given(st.binary(max_size=400))
def test_anything_else_is_refused_or_ignored(data):
    with suppress(NatsError):
        NatsReader().feed(b"MSG facemime 1 4\r\nabcd\r\n" + data + b"\r\n")


@pytest.mark.parametrize(
    "line", [b"MSG facemime 1 x\r\n", b"MSG\r\n", b"MSG a 1 %d\r\n" % (MAX_PAYLOAD + 1), b"a" * 9000]
)
def test_impossible_sizes_take_no_memory(line):
    with pytest.raises(NatsError):
        NatsReader().feed(line)


def test_the_command_serves_a_relay_that_the_printed_command_starts(take, tmp_path):
    url = f"ws://127.0.0.1:{free_port()}"
    line = [*map(str, START), "serve", "--video", str(take), "--loop", "--relay", url, "--site", str(tmp_path / "site")]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as command:
        try:
            page = command.stdout.readline().strip()
            start = next(text for text in command.stderr if "start the relay: " in text).split("start the relay: ")[1]
            made = Site(tmp_path / "site", Relay(url))
            assert start.strip() == f"nats-server --config {made.configuration}" and page == str(made.page)
            with relaying(made), watching(made) as viewer:
                numbers = [int.from_bytes(viewer.next("MSG", PATIENCE)[4:8], "little") for _ in range(5)]
        finally:
            command.terminate()
            command.communicate()
    assert numbers == sorted(set(numbers)) and (made.page / "index.html").is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--site", "a"), "Give both"),
        *(
            pytest.param(*case, marks=pytest.mark.thorough)
            for case in (
                (("--relay", "ws://127.0.0.1:1"), "Give both"),
                (("--relay", "ws://127.0.0.1:1", "--site", "a", "--listen", "0.0.0.0"), "Leave them out"),
                (("--relay", "ftp://a", "--site", "a"), "not the address of a relay"),
                (("--relay", "wss://a", "--site", "a", "--cert", "a.pem"), "Give both, or neither"),
            )
        ),
    ],
)
def test_options_that_do_not_belong_together_are_clear_errors(take, options, message, tmp_path):
    done = run("serve", "--video", take, *options, cwd=tmp_path)
    assert done.returncode == 1 and message in done.stderr and "Traceback" not in done.stderr

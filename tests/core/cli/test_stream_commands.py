"""The commands `send` and `receive`, in separate processes and over real sockets."""

import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import facemime
from facemime.cli.main import main
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.streams.protocols.live_link import LiveLinkDecoder
from facemime.core.streams.sender import SENT, StreamSender
from facemime.core.streams.stream_settings import PROTOCOLS, SendSettings
from facemime.core.streams.vertices import VERTICES
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from tests.helpers.commands import SAMPLE, START, needs_posix, run
from tests.helpers.links import free_port, sending_phone
from tests.helpers.takes import coefficient_take, performance
from tests.helpers.thorough import first_of
from tests.helpers.vtube_studio import TOKEN, Studio, running


def sent_and_received(tmp_path: Path, protocol: str, source: Path, *more: object) -> tuple[Path, str]:
    """Return the take that `receive` records of the output of `send`, and the messages of `receive`."""
    port, out = free_port(), tmp_path / "received.facetake"
    line = [*START, "receive", "--protocol", protocol, "--listen", f":{port}", "-o", out, *more]
    with subprocess.Popen([*map(str, line)], stderr=subprocess.PIPE, text=True) as receiver:
        _wait_for(port)
        to = ("--to", f"127.0.0.1:{port}", "--protocol", protocol, "--expressions", "arkit")
        sending = run("send", "--video", source, *to, *more)
        assert sending.returncode == 0, sending.stderr
        time.sleep(0.5)
        receiver.send_signal(signal.SIGINT)
        said = receiver.stderr.read()
    assert receiver.returncode == 0, said
    return out, said


def same(sent: Take, received: Take, name: str) -> np.ndarray:
    """Match sent frames to received ones by time, as a player skips frames for which it is late."""
    first = getattr(received, name)[0]
    shift = int(np.argmin([np.abs(values - first).max() for values in getattr(sent, name)]))
    times = received.times + sent.times[shift]
    frames = np.abs(sent.times[:, None] - times).argmin(axis=0)
    np.testing.assert_allclose(sent.times[frames], times, atol=1e-4)
    return frames


def _wait_for(port: int) -> None:
    """Wait until a port is listened on."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return
        time.sleep(0.05)
    raise AssertionError("nobody listens")


@needs_posix
@pytest.mark.parametrize("protocol", first_of(["own", "vmc", "livelink"]))
def test_a_take_of_coefficients_arrives_as_it_was(tmp_path, protocol):
    save_take(coefficient_take(60), tmp_path / "sent.facetake")
    sent = load_take(tmp_path / "sent.facetake")
    path, said = sent_and_received(tmp_path, protocol, tmp_path / "sent.facetake")
    received = load_take(path)
    assert len(received) >= 5 and "packets" in said
    found = arkit_coefficients(received, calibrate(received))
    np.testing.assert_allclose(found, sent.coefficients[same(sent, received, "coefficients")], atol=5e-5)


@pytest.mark.thorough
@needs_posix
def test_with_a_key_landmarks_arrive_as_they_were_tracked(tmp_path):
    key = tmp_path / "shared.key"
    assert run("receive", "--new-key", key).returncode == 0
    take = coefficient_take(90, 30.0)
    tracked = replace(take, coefficients=np.full_like(take.coefficients, np.nan), info={"source": "camera"})
    save_take(tracked, tmp_path / "sent.facetake")
    path, said = sent_and_received(tmp_path, "own", tmp_path / "sent.facetake", "--key", key)
    sent, received = load_take(tmp_path / "sent.facetake"), load_take(path)
    assert len(received) >= 5 and "refused" not in said
    np.testing.assert_allclose(received.shape, sent.shape[same(sent, received, "shape")], atol=2.0**-12)


@pytest.mark.thorough
@needs_posix
def test_two_senders_become_two_takes(tmp_path):
    save_take(coefficient_take(60), tmp_path / "sent.facetake")
    port, outputs = free_port(), [tmp_path / "ben.facetake", tmp_path / "ada.facetake"]
    line = [*START, "receive", "--protocol", "livelink", "--listen", f":{port}", "--sender", "Ben"]
    for output in outputs:
        line += ["-o", output]
    with subprocess.Popen([*map(str, line)], stderr=subprocess.PIPE, text=True) as receiver:
        _wait_for(port)
        to = ("--to", f"127.0.0.1:{port}", "--protocol", "livelink", "--smoothing", "0", "--subject")
        send = [*map(str, START), "send", "--video", str(tmp_path / "sent.facetake"), *to]
        with subprocess.Popen([*send, "Ada"]) as ada, subprocess.Popen([*send, "Ben"]) as ben:
            assert ada.wait() == ben.wait() == 0
        time.sleep(0.5)
        receiver.send_signal(signal.SIGINT)
        said = receiver.stderr.read()
    assert receiver.returncode == 0, said
    for output, name in zip(outputs, ("Ben", "Ada"), strict=True):
        take = load_take(output)
        assert len(take) >= 10 and take.info["sender"] == f"127.0.0.1 {name}"
        assert take.times[-1] < 5.0


@pytest.mark.thorough
@needs_posix
def test_a_pairing_line_is_all_that_a_receiver_needs(tmp_path):
    save_take(coefficient_take(60), tmp_path / "sent.facetake")
    serve = ("--video", tmp_path / "sent.facetake", "--loop", "--serve", "127.0.0.1:0", "--tls", tmp_path / "tls")
    line = [*map(str, START), "send", *map(str, serve)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sender:
        pairing = sender.stdout.readline().strip()
        out = tmp_path / "received.facetake"
        done = run("receive", "--pairing", pairing, "-o", out, "--seconds", 2)
        wrong = pairing[:-4] + ("0000" if pairing[-4:] != "0000" else "1111")
        refused = run("receive", "--pairing", wrong, "-o", tmp_path / "no.facetake", "--seconds", 20)
        sender.send_signal(signal.SIGINT)
        said = sender.stderr.read()
    assert sender.returncode == 0 and done.returncode == 0, said + done.stderr
    assert len(load_take(out)) >= 20 and load_take(out).info["sender"].startswith("127.0.0.1")
    assert refused.returncode != 0 and "not the paired computer" in refused.stderr
    assert not (tmp_path / "no.facetake").exists()


def test_vtube_studio_receives_the_face_and_its_permission_is_kept(tmp_path):
    save_take(coefficient_take(60), tmp_path / "sent.facetake")
    with running(studio := Studio()) as port:
        to = ("--to", f"127.0.0.1:{port}", "--protocol", "vtubestudio")
        done = run("send", "--video", tmp_path / "sent.facetake", *to, "--token", tmp_path / "token")
    assert done.returncode == 0, done.stderr
    assert studio.kinds()[:2] == ["AuthenticationTokenRequest", "AuthenticationRequest"]
    assert len(studio.injected()) >= 10 and (tmp_path / "token").read_text() == TOKEN + "\n"


@needs_posix
def test_a_video_is_tracked_and_sent_without_blender():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unreal:
        unreal.bind(("127.0.0.1", 0))
        unreal.settimeout(90.0)
        to = f"127.0.0.1:{unreal.getsockname()[1]}"
        line = [
            *START,
            "send",
            "--video",
            SAMPLE,
            "--to",
            to,
            "--protocol",
            "livelink",
            "--subject",
            "Sample",
            "--loop",
        ]
        with subprocess.Popen([*map(str, line)], stderr=subprocess.PIPE, text=True) as sender:
            decoder, opened = LiveLinkDecoder(), []
            while len(opened) < 60:
                (frame,) = decoder.decode(unreal.recv(4096))
                assert frame.subject == "Sample"
                opened.append(frame.face.coefficients[COEFFICIENT_INDEX["jawOpen"]] if frame.face else 0.0)
            sender.send_signal(signal.SIGINT)
            said = sender.stderr.read()
        assert sender.returncode == 0, said
    assert max(opened) > 0.0


@needs_posix
def test_the_values_that_arrive_can_be_watched_without_a_take(tmp_path):
    port = free_port()
    with sending_phone(port):
        done = run("receive", "--protocol", "livelink", "--listen", f":{port}", "--watch", "--seconds", 2)
    assert done.returncode == 0, done.stderr
    assert "127.0.0.1 Phone: " in done.stdout and "mouthSmileLeft " in done.stdout
    assert "frames in" in done.stderr


@needs_posix
def test_receiving_nothing_is_a_clear_error(tmp_path):
    done = run("receive", "--listen", f":{free_port()}", "-o", tmp_path / "a.facetake", "--seconds", 0.3)
    assert (
        done.returncode == 1
        and "Nothing arrived at 127.0.0.1:" in done.stderr
        and not (tmp_path / "a.facetake").exists()
    )


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("receive",), "There is no output"),
        (("receive", "-o", "a.facetake", "--pairing", "facemime://a"), "not a complete pairing line"),
        (("send", "--video", SAMPLE, "--serve", "0.0.0.0"), "There is no certificate"),
        (("send", "--video", SAMPLE, "--serve", "0.0.0.0", "--tls", "a", "--protocol", "vmc"), "without a key"),
        (("send", "--video", SAMPLE, "--to", "127.0.0.1", "--tls", "a"), "are for --serve"),
        (("receive", "-o", "a.facetake", "--sender", "Ada", "--sender", "Ben"), "more senders than takes"),
        (("receive", "-o", "a.facetake", "--listen", "0.0.0.0"), "needs a shared key"),
        (("receive", "-o", "a.facetake", "--flip", "up"), "cannot be flipped"),
        (("receive", "-o", "a.facetake", "--protocol", "ifacialmocap"), "address of the phone"),
        (("receive", "-o", "a.txt"), "facetake"),
        (("send", "--video", "a.mp4", "--to", "192.168.1.7"), "needs a shared key"),
        (("send", "--video", "a.mp4", "--to", "a b"), "is not an address"),
        (("send", "--video", "none.facetake", "--to", ":5"), "none.facetake"),
        (("send", "--video", "none.mp4", "--to", ":5"), "none.mp4"),
    ],
)
def test_invalid_commands_are_refused_with_the_reason(arguments, wanted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*map(str, arguments)]) == 1
    assert wanted in capsys.readouterr().err


def test_the_documented_receiver_reads_what_is_sent_and_needs_only_numpy(tmp_path):
    document = (Path(facemime.__file__).parent / "docs" / "guides" / "streams.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", document, flags=re.DOTALL)
    port, out, take = free_port(), tmp_path / "shapes.npy", performance()
    line = [sys.executable, "-I", "-c", code, str(port), "20", str(out)]
    with subprocess.Popen(line) as receiver:
        _wait_for(port)
        sender = StreamSender(SendSettings(port=port))
        for number in range(20):
            sender.send(0.1 * number, take.result(number), None)
        sender.close()
        assert receiver.wait(60) == 0
    np.testing.assert_allclose(np.load(out), take.shape[:20], atol=2.0**-14)


def test_every_protocol_is_documented_with_its_port():
    document = (Path(facemime.__file__).parent / "docs" / "guides" / "streams.md").read_text(encoding="utf-8")
    for name, protocol in PROTOCOLS.items():
        rows = [line for line in document.splitlines() if line.startswith("|") and f"`{name}`" in line]
        (row,) = [row for row in rows if protocol.connected or "TCP" not in row]
        way = "TCP" if protocol.connected else "UDP"
        assert f"{way} {protocol.port} " in row and ("sends" in row) == (name in (*SENT, VERTICES))

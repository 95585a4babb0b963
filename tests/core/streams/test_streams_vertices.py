"""Moved vertices over TCP are the driver's, for the receivers in the documentation."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.sources import LiveFrame
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.core.streams.vertices import VertexSender, encode_frame, encode_mesh
from tests.helpers.clocks import PATIENCE
from tests.helpers.commands import run
from tests.helpers.links import all_the_time, free_port
from tests.helpers.programs import program
from tests.helpers.viewer.watching import NEUTRAL, built_in, face

RECEIVERS = Path(__file__).resolve().parents[3] / "docs" / "receivers"
PROGRAM = """
using System;
public static class Program {
    public static void Main(string[] arguments) {
        using (FacemimeStream stream = new FacemimeStream(System.Net.IPAddress.Loopback, int.Parse(arguments[0]))) {
            Console.WriteLine("ready");
            bool done = false;
            while (!done) {
                stream.Update(
                    mesh => Console.WriteLine("{0} {1} {2}", mesh.Name, mesh.Rest.Length / 3, mesh.Corners.Length / 3),
                    frame => {
                        double sum = 0.0;
                        foreach (float value in frame.Vertices) sum += Math.Abs(value);
                        Console.WriteLine("{0:R} {1:R}", sum, frame.Rotation[1]);
                        done = true;
                    });
                System.Threading.Thread.Sleep(5);
            }
        }
    }
}
"""


def python_receiver():
    """Load the documented script as a module."""
    spec = importlib.util.spec_from_file_location("receive_vertices", RECEIVERS / "receive_vertices.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as opened:
        opened.settimeout(PATIENCE)
        yield opened


def in_receivers_axes(points: np.ndarray) -> np.ndarray:
    return points * (1.0, -1.0, -1.0)


def test_the_received_vertices_are_the_drivers_with_eyes_teeth_and_tongue(listener):
    receiver = python_receiver()
    driver, looks = built_in()
    with VertexSender(*listener.getsockname(), [looks]) as sender:
        connection, _ = listener.accept()
        frame = driver.frame(face(1, tongueOut=1.0))
        sender.show(12.5, [driver], [frame])
        with connection:
            messages = receiver.receive(connection)
            mesh, moved = next(messages), next(messages)
            sender.close()
            assert next(messages, None) is None
    count = len(frame.vertices)
    assert (mesh.head, mesh.name, moved.head, moved.time) == (0, looks.name, 0, 12.5)
    np.testing.assert_array_equal(in_receivers_axes(moved.vertices[:count]), frame.vertices)
    assert len(mesh.rest) == len(moved.vertices) == count + sum(len(part.vertices) for part in looks.parts)
    assert mesh.triangles.max() == len(mesh.rest) - 1
    (tongue,) = (part for part in looks.parts if part.out is not None)
    first = count + sum(len(part.vertices) for part in looks.parts[: looks.parts.index(tongue)])
    expected = tongue.posed(frame.jaw, frame.gaze, frame.tongue)
    np.testing.assert_allclose(in_receivers_axes(moved.vertices[first:][: len(expected)]), expected, atol=1e-6)
    turned = np.diag((1.0, -1.0, -1.0)) @ frame.rotation @ np.diag((1.0, -1.0, -1.0))
    np.testing.assert_allclose(moved.rotation, turned, atol=1e-6)


@pytest.mark.thorough
def test_a_returning_receiver_gets_the_mesh_again_and_a_changed_mesh_is_sent(listener):
    receiver = python_receiver()
    driver, looks = built_in()
    larger = HeadDriver(replace(driver.rig, vertices=2.0 * driver.rig.vertices), NEUTRAL)
    driven = [driver]
    with (
        VertexSender(*listener.getsockname(), [looks]) as sender,
        all_the_time(lambda _: sender.show(0.0, driven, [driven[0].frame(face(1))]), pause=0.01),
    ):
        for _ in range(2):
            connection, _ = listener.accept()
            with connection:
                messages = receiver.receive(connection)
                assert isinstance(next(messages), receiver.Mesh) and isinstance(next(messages), receiver.Frame)
        connection, _ = listener.accept()
        with connection:
            messages = receiver.receive(connection)
            before = next(messages)
            driven[0] = larger
            after = next(message for message in messages if isinstance(message, receiver.Mesh))
    count = len(driver.rig.vertices)
    np.testing.assert_allclose(after.rest[:count], 2.0 * before.rest[:count], rtol=1e-6)


@pytest.fixture
def source():
    """A listening source of moved vertices."""
    with closing(StreamSource(StreamSettings("vertices", port=free_port()), every=True)) as opened:
        opened.read(0.0)
        yield opened


def next_frame(source: StreamSource) -> LiveFrame:
    """Return the next frame with a face."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        if (frame := source.read(0.1)) is not None and frame.result.found:
            return frame
    raise AssertionError("nothing came")


def test_vertices_that_come_in_drive_another_head_as_they_moved_the_first(source):
    driver, looks = built_in()
    sent = driver.frame(face(3))
    with VertexSender(*source.address, [looks]) as sender:
        sender.show(2.0, [driver], [sent])
        came = next_frame(source)
    larger = replace(built_in_head(), vertices=2.0 * built_in_head().vertices, eyeballs=())
    shown = HeadDriver(larger, came.neutral).frame(came.result)
    landmarks = built_in_head().landmarks
    true = 2.0 * (sent.vertices[landmarks] - driver.rest[landmarks])
    np.testing.assert_allclose(shown.displacements, true, atol=5e-5)
    np.testing.assert_allclose(shown.rotation, sent.rotation, atol=1e-5)
    np.testing.assert_allclose(shown.gaze, sent.gaze, atol=1e-4)
    np.testing.assert_allclose(shown.translation, 2.0 * sent.translation, atol=1e-5)


def test_a_mesh_without_landmarks_and_an_overlong_message_are_refused_and_other_senders_are_heard(source):
    driver, looks = built_in()
    sent = driver.frame(face(3))
    with socket.create_connection(source.address) as stranger:
        stranger.sendall(encode_mesh(0, looks, driver.rest) + encode_frame(0, 1.0, looks, sent))
        until = time.monotonic() + PATIENCE
        while source.counts.malformed < 1 and time.monotonic() < until:
            assert source.read(0.05) is None
    assert source.counts.malformed == 1
    with socket.create_connection(source.address) as stranger:
        stranger.settimeout(PATIENCE)
        stranger.sendall(b"\xff\xff\xff\xff" + bytes(100))
        source.read(0.3)
        with suppress(ConnectionResetError):
            assert stranger.recv(1) == b"", "the connection is ended before anything is stored"
    with VertexSender(*source.address, [looks]) as sender:
        sender.show(2.0, [driver], [sent])
        assert next_frame(source).result.found


def test_a_missing_receiver_is_a_message_rather_than_an_error():
    driver, looks = built_in()
    with VertexSender("127.0.0.1", free_port(), [looks]) as sender:
        sender.show(0.0, [driver], [driver.frame(face(1))])
        waiting = threading.Event()
        while not sender.message:
            waiting.wait(0.01)
        assert "Cannot send to 127.0.0.1:" in sender.message and sender.sent == 0


def test_the_command_sends_to_the_documented_script(take):
    port = free_port()
    script = [sys.executable, "-u", str(RECEIVERS / "receive_vertices.py"), str(port)]
    with subprocess.Popen(script, stdout=subprocess.PIPE, text=True) as receiver:
        sending = run("send", "--video", take, "--to", f"127.0.0.1:{port}", "--protocol", "vertices")
        said = receiver.stdout.read()
    assert sending.returncode == 0, sending.stderr
    first, *frames = said.splitlines()
    assert first.startswith("Facemime Head: ") and first.endswith(" vertices from 127.0.0.1")
    assert len(frames) > 5 and max(float(line.split()[-1]) for line in frames) > 0.002


def test_the_script_for_unity_receives_the_same(tmp_path):
    (tmp_path / "Program.cs").write_text(PROGRAM)
    built, port = tmp_path / "receive.exe", free_port()
    sources = [str(RECEIVERS / "FacemimeReceiver.cs"), str(tmp_path / "Program.cs")]
    subprocess.run([program("mcs"), "-warnaserror", f"-out:{built}", *sources], check=True)
    driver, looks = built_in()
    frame = driver.frame(face(1))
    with subprocess.Popen(["mono", str(built), str(port)], stdout=subprocess.PIPE, text=True) as receiver:
        assert receiver.stdout.readline() == "ready\n"
        with socket.create_connection(("127.0.0.1", port), PATIENCE) as stranger:
            stranger.sendall(b"\xff" * 64)
        with VertexSender("127.0.0.1", port, [looks]) as sender:
            sender.show(0.0, [driver], [frame])
            name = receiver.stdout.readline()
            total, turned = map(float, receiver.stdout.readline().split())
    parts = [part.posed(frame.jaw, frame.gaze, frame.tongue) for part in looks.parts]
    expected = np.abs(np.concatenate([frame.vertices, *parts]).astype(float)).sum()
    assert name.startswith(f"{looks.name} {len(frame.vertices) + sum(map(len, parts))} ")
    assert total == pytest.approx(expected, rel=1e-6) and turned == pytest.approx(-frame.rotation[0, 1], abs=1e-6)

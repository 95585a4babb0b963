"""A phone's stream drives a head in Blender's own window, and what is shown is sent on."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from conftest import install, started
from facemime.core.coefficient_names import COEFFICIENT_INDEX
from facemime.core.streams.live_link import LiveLinkDecoder
from facemime.core.streams.sender import SendSettings, StreamSender
from facemime.core.takes.from_coefficients import coefficient_face
from links import free_port
from sidebar import Sidebar
from takes import coefficient_take
from window import Blender

pytestmark = pytest.mark.thorough

_SETTINGS = """
settings = bpy.context.scene.facemime
settings.source.kind, settings.source.stream.protocol, settings.source.stream.port = "STREAM", "livelink", {port}
settings.output.enabled, settings.output.protocol, settings.output.port = True, "livelink", {output}
"""


@pytest.fixture(scope="module")
def blender() -> Iterator[Blender]:
    """The newest Blender with the extension."""
    with started("sid", "streams", size=(1100, 1000)) as window:
        install(window)
        yield window


@pytest.fixture
def phone() -> Iterator[int]:
    """The port to which a phone sends all the time."""
    port, over = free_port(), threading.Event()
    sender, take = StreamSender(SendSettings("livelink", port=port, subject="Phone")), coefficient_take(60)

    def send() -> None:
        number, began = 0, time.monotonic()
        while not over.wait(1.0 / 60.0):
            sender.send(time.monotonic() - began, take.result(number % len(take)), coefficient_face().neutral)
            number += 1

    thread = threading.Thread(target=send)
    thread.start()
    yield port
    over.set()
    thread.join()
    sender.close()


def test_a_phone_drives_a_head_and_is_passed_on(blender, phone):
    sidebar = Sidebar(blender)
    sidebar.press("bpy.ops.facemime.add_head")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(120.0)
        blender.do(_SETTINGS.format(port=phone, output=other.getsockname()[1]))
        sidebar.open_panel("FACEMIME_PT_source")
        blender.shot("source")
        sidebar.press("bpy.ops.facemime.puppet")
        decoder, opened = LiveLinkDecoder(), 0.0
        while opened < 0.3:
            (frame,) = decoder.decode(other.recv(4096))
            opened = max(opened, frame.face.coefficients[COEFFICIENT_INDEX["jawOpen"]] if frame.face else 0.0)
    sidebar.open_panel("FACEMIME_PT_puppet", children=True)
    blender.shot("puppet")
    sidebar.press("bpy.ops.facemime.stop_puppet")
    assert "Traceback" not in blender.printed()

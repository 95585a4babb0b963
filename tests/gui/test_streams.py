"""A phone's stream drives a head in Blender's own window, and what is shown is sent on."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.streams.protocols.live_link import LiveLinkDecoder
from tests.gui.conftest import installed
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.window import Blender
from tests.helpers.links import free_port, sending_phone

pytestmark = pytest.mark.thorough

_SETTINGS = """
settings = bpy.context.scene.facemime
settings.source.kind, settings.source.stream.protocol, settings.source.stream.port = "STREAM", "livelink", {port}
settings.output.enabled, settings.output.protocol, settings.output.port = True, "livelink", {output}
"""


@pytest.fixture(scope="module")
def blender() -> Iterator[Blender]:
    """The newest Blender with the extension."""
    with installed("sid", "streams", size=(1100, 1000)) as window:
        yield window


@pytest.fixture
def phone() -> Iterator[int]:
    """The port to which a phone sends all the time."""
    port = free_port()
    with sending_phone(port):
        yield port


def test_a_phone_drives_a_head_and_is_passed_on(blender, phone):
    sidebar = Sidebar(blender)
    sidebar.press("bpy.ops.facemime.add_head")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(120.0)
        blender.do(_SETTINGS.format(port=phone, output=other.getsockname()[1]))
        sidebar.open_panel("FACEMIME_PT_source")
        blender.shot("source")
        sidebar.press("bpy.ops.facemime.puppet(")
        decoder, opened = LiveLinkDecoder(), 0.0
        while opened < 0.3:
            (frame,) = decoder.decode(other.recv(4096))
            opened = max(opened, frame.face.coefficients[COEFFICIENT_INDEX["jawOpen"]] if frame.face else 0.0)
    sidebar.open_panel("FACEMIME_PT_puppet", children=True)
    blender.shot("puppet")
    sidebar.press("bpy.ops.facemime.stop_puppet")
    assert "Traceback" not in blender.printed()

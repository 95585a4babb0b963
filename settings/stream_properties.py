"""Properties of streams: where a face comes from over the network, and where it is sent."""

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..core.streams.sender import SENT
from ..core.streams.stream_settings import PROTOCOLS, SendSettings, StreamSettings
from ..core.streams.transport.addresses import EVERYWHERE, LOOPBACK
from ..core.streams.transport.identity import load_identity
from ..core.streams.transport.pairing import PORT as PAIRING_PORT
from ..core.viewer.viewer_settings import PORT
from .rna import with_settings
from .storage import private_folder

if TYPE_CHECKING:
    from ..core.streams.transport.tls_server import TlsSender


_ITEMS = {name: (name, of.label, of.description, of.number) for name, of in PROTOCOLS.items()}
"""Items of the menu of protocols."""


@with_settings(StreamSettings)
class FacemimeStream(bpy.types.PropertyGroup):
    """A stream from the network as the source of the performance."""

    protocol: EnumProperty(
        name="From",
        description="App or program that sends the face",
        items=tuple(_ITEMS.values()),
        default="livelink",
    )
    host: StringProperty(
        name="Listen On",
        description="Address of this computer on which the stream is received; 0.0.0.0 for all of its networks",
        default=LOOPBACK,
    )
    port: IntProperty(name="Port", description="Port of the stream; 0 for the default", min=0, max=65535)
    phone: StringProperty(name="Phone", description="Address of the phone, which the app shows")
    key: StringProperty(
        name="Key", description="File with the key that this computer shares with the sender", subtype="FILE_PATH"
    )
    sender: StringProperty(
        name="Sender", description="Address or name of the sender to follow; if empty, the first sender"
    )
    flip: EnumProperty(
        name="Flip",
        description="Rotations of the head to reverse, if it turns the wrong way",
        items=(
            ("pitch", "Pitch", "Reverse looking up and down"),
            ("yaw", "Yaw", "Reverse turning left and right"),
            ("roll", "Roll", "Reverse tilting left and right"),
        ),
        options={"ENUM_FLAG"},
        default=set(),
    )


class FacemimeHead(bpy.types.PropertyGroup):
    """Settings of one head among several."""

    sender: StringProperty(
        name="Sender",
        description=(
            "Address or name of the sender that drives this head; by default, the first sender drives the first head, "
            "the second the second, and so on"
        ),
    )


@with_settings(SendSettings)
class FacemimeOutput(bpy.types.PropertyGroup):
    """Where the performance is sent while a puppet is running."""

    enabled: BoolProperty(
        name="Send", description="Send the performance to another computer or program while the puppet is running"
    )
    protocol: EnumProperty(
        name="To",
        description="Program that receives the face",
        items=(
            *(_ITEMS[name] for name in SENT),
            ("vertices", "Vertices", "An engine that receives the moved vertices over TCP", 4),
            ("vtubestudio", "VTube Studio", "VTube Studio on a computer, which asks you for permission once", 5),
        ),
    )
    across: BoolProperty(
        name="Across Networks",
        description=(
            "Wait for paired computers, which connect over TLS from any network, instead of sending to one address"
        ),
    )
    listen: StringProperty(
        name="Listen On",
        description="Address of this computer to which paired computers connect; 0.0.0.0 for all of its networks",
        default=EVERYWHERE,
    )
    public: StringProperty(
        name="Public Address",
        description=(
            "Address by which other networks reach this computer, such as that of its router, optionally with a port; "
            "if empty, this computer's own"
        ),
    )
    host: StringProperty(name="Host", description="Address of the computer that receives the face", default=LOOPBACK)
    port: IntProperty(name="Port", description="Port of the stream; 0 for the default", min=0, max=65535)
    key: StringProperty(
        name="Key", description="File with the key that this computer shares with the receiver", subtype="FILE_PATH"
    )
    subject: StringProperty(
        name="Subject", description="Name of the face in Unreal Engine", default=SendSettings.subject
    )


class FacemimeViewer(bpy.types.PropertyGroup):
    """Where the running puppet is shown in browsers."""

    enabled: BoolProperty(
        name="Viewer", description="Show the running puppet in browsers, on this computer or on others"
    )
    host: StringProperty(
        name="Listen On",
        description="Address of this computer at which browsers open the page; 0.0.0.0 for all of its networks",
        default=LOOPBACK,
    )
    port: IntProperty(name="Port", description="Port of the page; 0 for any free port", default=PORT, min=0, max=65535)
    certificate: StringProperty(
        name="Certificate",
        description="Certificate for HTTPS, as a PEM file; without it, the page uses HTTP",
        subtype="FILE_PATH",
    )
    key: StringProperty(
        name="Private Key", description="Private key of the certificate, as a PEM file", subtype="FILE_PATH"
    )


def pairing_folder() -> Path:
    """Return the folder of this computer's certificate and token."""
    return private_folder("pairing")


def listening_host(output: FacemimeOutput) -> str:
    """Return the address on which paired computers are awaited."""
    return output.listen.strip() or EVERYWHERE


def pairing_line(output: FacemimeOutput) -> str:
    """Return the line to paste on another computer.

    Raises
    ------
    SourceError
        If the public address is not an address, or the stored certificate cannot be used.
    OutputError
        If the certificate cannot be written.
    """
    pairing = load_identity(pairing_folder()).pairing(
        listening_host(output), output.port or PAIRING_PORT, output.public
    )
    return pairing.line


def open_paired_sender(output: FacemimeOutput) -> "TlsSender":
    """Return the sender to paired computers.

    Raises
    ------
    SourceError
        If the address cannot be listened on, or the stored certificate cannot be used.
    OutputError
        If the certificate cannot be written.
    """
    from ..core.streams.transport.tls_server import TlsSender  # only now, as its libraries take a moment

    identity = load_identity(pairing_folder())
    return TlsSender(listening_host(output), output.port or PAIRING_PORT, identity.context, identity.token)


CLASSES = (
    FacemimeStream,
    FacemimeHead,
    FacemimeOutput,
    FacemimeViewer,
)
POINTERS = ((bpy.types.Object, "facemime", FacemimeHead),)

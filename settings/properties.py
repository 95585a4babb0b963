"""Properties of the scene; `values.py` converts them to plain values."""

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..core.drive.drive_settings import DriveSettings, PosingSettings
from ..core.errors import messages
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.streams.sender import SENT
from ..core.streams.stream_settings import PROTOCOLS, SendSettings, StreamSettings
from ..core.streams.transport.addresses import EVERYWHERE, LOOPBACK
from ..core.streams.transport.addresses import PORT as PAIRING_PORT
from ..core.streams.transport.security import load_identity, renew_identity
from ..core.tracking.tracker import TrackingSettings
from ..core.viewer.viewer_settings import PORT
from .callbacks import refit_last_bake
from .rna import with_settings
from .storage import private_folder

if TYPE_CHECKING:
    from ..core.streams.transport.tls_server import TlsSender


_ITEMS = {
    name: (name, of.label, of.description, place if of.number < 0 else of.number)
    for place, (name, of) in enumerate(PROTOCOLS.items())
}
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


_STRENGTHS = messages(
    {
        "strength_brows": "Brows",
        "strength_eyes": "Eyes",
        "strength_cheeks": "Cheeks and Nose",
        "strength_jaw": "Jaw",
        "strength_mouth": "Mouth",
        "strength_gaze": "Gaze",
    }
)


def _with_strengths(owner: type) -> type:
    """Decorate a property group with the strengths of the parts of a face in bakes."""
    properties = {
        name: FloatProperty(
            name=label.template,
            description="Factor of this part of the face in bakes. It can be animated; the last bake follows it until "
            "you change a keyframe of it, and another bake does in any case",
            default=1.0,
            min=0.0,
            max=4.0,
            soft_max=2.0,
            update=refit_last_bake,
        )
        for name, label in _STRENGTHS.items()
    }
    owner.__annotations__ = properties | owner.__annotations__
    return owner


@_with_strengths
class FacemimeHead(bpy.types.PropertyGroup):
    """Settings of one head among several."""

    sender: StringProperty(
        name="Sender",
        description=(
            "Address or name of the sender that drives this head; by default, the first sender drives the first head, "
            "the second the second, and so on"
        ),
    )
    person: IntProperty(
        name="Person",
        description=(
            "Person in view who drives this head, in order of appearance; 0 for whoever comes and drives no other head"
        ),
        default=0,
        min=0,
        max=99,
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

    Raises SourceError if the public address is not an address, or the stored certificate cannot be used, and
    OutputError if the certificate cannot be written.
    """
    pairing = load_identity(pairing_folder()).pairing(
        listening_host(output), output.port or PAIRING_PORT, output.public
    )
    return pairing.line


def renew_pairing_line() -> None:
    """Make a new pairing line, so that earlier ones are no longer valid; may raise OutputError."""
    renew_identity(pairing_folder())


def open_paired_sender(output: FacemimeOutput) -> "TlsSender":
    """Return the sender to paired computers.

    Raises SourceError if the address cannot be listened on, or the stored certificate cannot be used, and OutputError
    if the certificate cannot be written.
    """
    from ..core.streams.transport.tls_server import TlsSender  # only now, as its libraries take a moment

    identity = load_identity(pairing_folder())
    return TlsSender(listening_host(output), output.port or PAIRING_PORT, identity.context, identity.token)


class FacemimeSource(bpy.types.PropertyGroup):
    """Source of the performance; the camera is in `preferences.py`."""

    kind: EnumProperty(
        name="Source",
        description="Where the performer's face comes from",
        items=(
            ("CAMERA", "Camera", "Use a webcam, or a phone's video stream", "CAMERA_DATA", 0),
            ("VIDEO", "Video", "Use a video file", "FILE_MOVIE", 1),
            ("PICTURES", "Image Sequence", "Use the images in a folder, sorted by name", "IMAGE_DATA", 2),
            ("TAKE", "Take", "Play a recorded take", "ACTION", 3),
            ("SAMPLE", "Sample Clip", "Use the clip that comes with Facemime, to try it without a camera", "PLAY", 4),
            ("STREAM", "Stream", "Use the face sent by a phone, a VTuber program or another computer", "URL", 5),
        ),
        default="SAMPLE",
    )
    rate: FloatProperty(
        name="Rate", description="Frames per second of the image sequence", default=30.0, min=1.0, max=240.0
    )
    video: StringProperty(name="Video", description="Video file", subtype="FILE_PATH")
    folder: StringProperty(name="Folder", description="Folder of the image sequence", subtype="DIR_PATH")
    take: StringProperty(name="Take", description="Take file", subtype="FILE_PATH")
    loop: BoolProperty(name="Loop", description="Start again at the end", default=True)
    speed: FloatProperty(
        name="Speed", description="Playback speed; 1 plays as recorded", default=1.0, min=0.05, max=20.0, soft_max=4.0
    )
    face: EnumProperty(
        name="Face",
        description="Face to track when several are in view",
        items=(
            ("LARGEST", "Largest", "Track the largest face, usually the one nearest to the camera"),
            ("LEFT", "Leftmost", "Track the face furthest to the left in the image"),
            ("RIGHT", "Rightmost", "Track the face furthest to the right in the image"),
            ("ALL", "Everybody", "Track everybody in view; each head follows a person of its own"),
        ),
    )
    stream: PointerProperty(type=FacemimeStream)


@with_settings(PosingSettings)
class FacemimePosing(bpy.types.PropertyGroup):
    """Strength and limits of the pose of the head and eyes, and the objects or bones that follow it."""

    object: PointerProperty(
        name="Pose Object",
        description="Object that follows the pose instead of the head, such as an empty or an armature",
        type=bpy.types.Object,
    )
    bone: StringProperty(name="Bone", description="Bone of the armature that follows the pose of the head")
    eye_left: PointerProperty(
        name="Left Eye", description="Object that follows the gaze of the left eye", type=bpy.types.Object
    )
    eye_left_bone: StringProperty(name="Left Bone", description="Bone that follows the gaze of the left eye")
    eye_right: PointerProperty(
        name="Right Eye", description="Object that follows the gaze of the right eye", type=bpy.types.Object
    )
    eye_right_bone: StringProperty(name="Right Bone", description="Bone that follows the gaze of the right eye")


class FacemimePerformer(bpy.types.PropertyGroup):
    """A performer: a name, a calibration, and what was learnt from pins."""

    key: StringProperty(options={"HIDDEN"})
    calibration: StringProperty(options={"HIDDEN"})
    learnt: StringProperty(options={"HIDDEN"})


@with_settings(DriveSettings, PuppetSettings, TrackingSettings)
class FacemimeSettings(bpy.types.PropertyGroup):
    """Settings that control how a performance moves the heads."""

    find_neutral: BoolProperty(
        name="Find Neutral",
        description="Find or estimate the performer's neutral face; otherwise set the time when the face is neutral",
        default=True,
    )
    neutral: FloatProperty(
        name="Neutral At (s)",
        description="Start of the second in which the performer's face is neutral, in seconds",
        min=0.0,
    )
    drive_by: EnumProperty(
        name="Driven By",
        description="What a live puppet moves",
        items=(
            (
                "AUTOMATIC",
                "Automatic",
                "Drive the shape keys of a character with a known set, such as ARKit's or VRM's; otherwise the skin",
            ),
            ("SKIN", "Skin", "Move the skin with the performer's landmarks"),
            ("KEYS", "Shape Keys", "Drive existing shape keys by the key mapping, which is detected if it is empty"),
            ("CONTROLS", "Controls", "Set the controls of the character's own rig, which Learn Controls has found"),
        ),
    )
    learn: BoolProperty(
        name="Learn Performer",
        description=(
            "While the puppet is running, learn when the performer's eyes are shut, and improve the neutral face "
            "unless it was calibrated"
        ),
        default=True,
    )
    keep_calibrations: BoolProperty(
        name="Keep in File",
        description=(
            "Store the calibrations, which contain the shapes of the performers' faces, in the .blend file; otherwise "
            "they are forgotten when Blender quits"
        ),
        default=False,
    )
    hide_bones: BoolProperty(
        name="Hide Bones",
        description="While the puppet is running, hide bones, which may cover the face, except in Pose Mode",
        default=True,
    )
    keep_pose: BoolProperty(
        name="Keep Pose",
        description="Keep the pose when the puppet is stopped; otherwise the head returns to rest",
        default=False,
    )
    performer: IntProperty(name="Performer", default=-1, min=-1)
    performers: CollectionProperty(type=FacemimePerformer)
    source: PointerProperty(type=FacemimeSource)
    posing: PointerProperty(type=FacemimePosing)
    output: PointerProperty(type=FacemimeOutput)
    viewer: PointerProperty(type=FacemimeViewer)


POINTERS = (
    (bpy.types.Object, "facemime", FacemimeHead),
    (bpy.types.Scene, "facemime", FacemimeSettings),
)

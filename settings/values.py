"""Conversion of the scene's properties to plain values.

These are functions rather than methods of the property groups, as Blender 4.2 crashes after an extension is removed if
one of its property groups has a method.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..blender.animation.scene_range import start_frame
from ..blender.animation.targets import PoseTarget, own_targets
from ..blender.timeline import keyed_frame
from ..core.bake.bake_settings import AUTOMATIC, CURRENT_FRAME, BakeSettings
from ..core.drive.drive_settings import DriveSettings, PosingSettings
from ..core.errors import Message, SourceError
from ..core.files.assets import SAMPLE
from ..core.files.capture import is_address
from ..core.puppet.camera import Camera, CameraSettings
from ..core.puppet.camera_list import number_and_name
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.puppet.sources import LiveSource, PicturePlayer, TakePlayer, VideoPlayer
from ..core.streams.sender import VTUBE_STUDIO, StreamSender
from ..core.streams.source import StreamSource
from ..core.streams.stream_settings import OWN, PROTOCOLS, SendSettings, StreamSettings
from ..core.streams.transport.addresses import LOOPBACK, is_loopback, parse_pairing
from ..core.streams.vertices import VERTICES
from ..core.takes.file import load_take
from ..core.tracking.identity import LEFTMOST, RIGHTMOST
from ..core.tracking.tracker import TrackingSettings
from ..core.viewer.viewer_settings import ViewerSettings
from .preferences import preferences
from .properties import (
    FacemimeOutput,
    FacemimePosing,
    FacemimeSettings,
    FacemimeSource,
    FacemimeStream,
    FacemimeViewer,
    listening_host,
    open_paired_sender,
)
from .rna import read
from .storage import private_folder, project_folder
from .takes_properties import FacemimeBake, read_table

if TYPE_CHECKING:
    from ..core.streams.transport.tls_server import TlsSender
    from ..core.streams.vtube_studio_api import VTubeStudioSender

_DEFAULT_BAKE = BakeSettings()
_FACES = {"LARGEST": None, "LEFT": LEFTMOST, "RIGHT": RIGHTMOST}


def drive_settings(settings: FacemimeSettings) -> DriveSettings:
    """Return the settings of how a frame moves a head."""
    return read(DriveSettings, settings, posing=read(PosingSettings, settings.posing))


def puppet_settings(settings: FacemimeSettings, bake: BakeSettings = _DEFAULT_BAKE) -> PuppetSettings:
    """Return the settings of how a take moves a head and is baked, by default to new shape keys."""
    return read(
        PuppetSettings,
        settings,
        drive=drive_settings(settings),
        neutral=None if settings.find_neutral else settings.neutral,
        tracking=read(TrackingSettings, settings),
        bake=bake,
    )


def bake_settings(bake: FacemimeBake, name: str) -> BakeSettings:
    """Return the settings of a bake of the named take, after which a cache is named.

    Raises FacemimeError if a row of the key mapping has no shape key.
    """
    table = read_table(bake) if bake.keys in (AUTOMATIC, "mapped") and len(bake.rows) else None
    return read(BakeSettings, bake, table=table, path=project_folder("caches") / bpy.path.clean_name(name))


def placing_of(scene: bpy.types.Scene) -> BakeSettings:
    """Return the default settings of a bake, with the user's choices of its place and of what else plays."""
    bake = scene.facemime_takes.bake
    place_take(scene)
    return BakeSettings(keep_animation=bake.keep_animation, start=bake.start, fit_range=bake.fit_range)


def place_take(scene: bpy.types.Scene) -> float:
    """Return the frame at 0 s of a take that is baked or previewed, and remember it if that is the current frame."""
    bake = scene.facemime_takes.bake
    if bake.start == CURRENT_FRAME:
        bake.placed = scene.frame_current
    return take_start(scene)


def take_start(scene: bpy.types.Scene) -> float:
    """Return the frame at 0 s of a take, at which the last one was placed if it started at the current frame."""
    bake = scene.facemime_takes.bake
    return keyed_frame(scene, bake.placed) if bake.start == CURRENT_FRAME else start_frame(scene, bake.start)


def face_of(source: FacemimeSource) -> tuple[float, float] | None:
    """Return the face to track when several are in view, as for `FaceTracker.choose`; None for the largest."""
    return _FACES.get(source.face)


def people_of(source: FacemimeSource, objects: Sequence[bpy.types.Object | None]) -> tuple[int, ...] | None:
    """Return who drives each head, as for `LiveOptions.people`; None if one face drives all."""
    return tuple(0 if obj is None else obj.facemime.person for obj in objects) if source.face == "ALL" else None


def source_text(source: FacemimeSource) -> str:
    """Return the settings that determine what is opened as the source, as a text."""
    user = preferences()
    camera = [user.camera, user.width, user.height, user.rate] if source.kind == "CAMERA" else []
    groups = [source, source.stream] if source.kind == "STREAM" else [source]
    values = [
        getattr(group, prop.identifier)
        for group in groups
        for prop in group.bl_rna.properties
        if prop.type != "POINTER" and not prop.is_readonly
    ]
    return "|".join(map(str, [*values, *camera]))


FILE_OF = {"VIDEO": "video", "PICTURES": "folder", "TAKE": "take"}
"""The property with the file or folder of each kind of source that has one."""


def open_source(source: FacemimeSource) -> LiveSource:
    """Open the source of a live session. A camera is opened only by its first `read`.

    Raises SourceError if nothing is selected, or the file is missing.
    """
    loop, speed = source.loop, source.speed
    if source.kind == "CAMERA":
        return _camera()
    if source.kind == "SAMPLE":
        return VideoPlayer(SAMPLE, loop=loop, speed=speed)
    if source.kind == "VIDEO":
        video = _chosen(source.video, Message("No video is selected. Select one under Source."))
        return VideoPlayer(video, loop=loop, speed=speed)
    if source.kind == "PICTURES":
        return PicturePlayer(
            _chosen(source.folder, Message("No folder of images is selected. Select one under Source.")),
            rate=source.rate,
            loop=loop,
            speed=speed,
        )
    if source.kind == "STREAM":
        return StreamSource(stream_settings(source.stream))
    path = _chosen(source.take, Message("No take is selected. Select one under Source."))
    return TakePlayer(load_take(path), path.name, loop=loop, speed=speed)


def whole_file(source: FacemimeSource) -> str:
    """Return the video or take that is chosen as the source; "" if it is something else, or nothing is chosen."""
    chosen = {"SAMPLE": str(SAMPLE), "VIDEO": source.video, "TAKE": source.take}.get(source.kind, "")
    return bpy.path.abspath(chosen) if chosen else ""


def is_tracked(source: FacemimeSource) -> bool:
    """Whether Facemime tracked the face, here or elsewhere, so that a performer's calibration is valid for it."""
    return source.kind != "STREAM" or source.stream.protocol == OWN


def _camera() -> Camera:
    chosen = preferences()
    device, _ = number_and_name(chosen.camera)
    if not device:
        raise SourceError("No camera is selected. Enter its number under Source; 0 is the first.")
    if is_address(device):
        _require_online(device)
    return Camera(CameraSettings(chosen.camera.strip(), chosen.width, chosen.height, chosen.rate))


def _require_online(device: str) -> None:
    if not bpy.app.online_access:
        raise SourceError(
            "Cannot open {device}: online access is turned off. Enable Allow Online Access in Preferences > System.",
            device=device,
        )


def stream_settings(stream: FacemimeStream) -> StreamSettings:
    """Return where a stream comes from.

    Raises SourceError if it may come from another computer, and Blender's online access is turned off; or the pairing
    is no pairing line.
    """
    line = preferences().pairing.strip() if stream.protocol == OWN else ""
    pairing = parse_pairing(line) if line else None
    settings = read(
        StreamSettings,
        stream,
        protocol=stream.protocol,
        host=stream.host.strip() or LOOPBACK,
        port=stream.port,
        phone=stream.phone.strip() if PROTOCOLS[stream.protocol].phone_port else "",
        key=_key(stream.key) if stream.protocol == OWN and pairing is None else None,
        sender=stream.sender.strip(),
        flip=tuple(sorted(stream.flip)),
        pairing=pairing,
    )
    if not settings.is_local:
        _require_online(pairing.host if pairing is not None else settings.phone or settings.host)
    return settings


def open_sender(settings: FacemimeSettings) -> StreamSender | VTubeStudioSender | TlsSender | None:
    """Return the sender of a live session; None if nothing is to be sent.

    Raises SourceError if the receiver is not known; if it is another computer, and Blender's online access is turned
    off; or if this computer cannot be listened on for paired ones. Raises OutputError if the certificate for paired
    computers cannot be written.
    """
    output = settings.output
    if not output.enabled or output.protocol == VERTICES:
        return None
    if output.protocol == OWN and output.across:
        if not is_loopback(host := listening_host(output)):
            _require_online(host)
        return open_paired_sender(output)
    key = _key(output.key) if output.protocol == OWN else None
    host = output.host.strip() or LOOPBACK
    if not is_loopback(host):
        _require_online(host)
    if output.protocol == VTUBE_STUDIO:
        from ..core.streams.vtube_studio_api import VTubeStudioSender  # only now, as its libraries take a moment

        return VTubeStudioSender(host, output.port, private_folder("vtube_studio") / "token", drive_settings(settings))
    wanted = read(
        SendSettings,
        output,
        protocol=output.protocol,
        host=host,
        port=output.port,
        key=key,
        subject=output.subject or SendSettings.subject,
    )
    return StreamSender(wanted, drive_settings(settings))


def sends_vertices(output: FacemimeOutput) -> bool:
    """Return whether the moved vertices are sent.

    Raises SourceError if they would go to another computer, and Blender's online access is turned off.
    """
    if not output.enabled or output.protocol != VERTICES:
        return False
    if not is_loopback(host := output.host.strip() or LOOPBACK):
        _require_online(host)
    return True


def viewer_settings(viewer: FacemimeViewer, token: str) -> ViewerSettings | None:
    """Return where the puppet is shown in browsers, with the secret in the address; None if it is not.

    Raises SourceError if other computers may connect, and Blender's online access is turned off.
    """
    if not viewer.enabled:
        return None
    host = viewer.host.strip() or LOOPBACK
    wanted = ViewerSettings(host, viewer.port, token, _key(viewer.certificate), _key(viewer.key))
    if not wanted.is_local:
        _require_online(host)
    return wanted


def _key(path: str) -> Path | None:
    return Path(bpy.path.abspath(path)) if path else None


def _chosen(path: str, message: Message) -> Path:
    if not path:
        raise SourceError(message)
    return Path(bpy.path.abspath(path))


def pose_targets(posing: FacemimePosing, head: bpy.types.Object) -> dict[str, PoseTarget]:
    """Return the objects or bones that follow the pose: "head", and "eye_left" and "eye_right" if they are set.

    If no pose object is set, the bones of the head, or the head itself, follow. Raises HeadError if the armature does
    not have the bone.
    """
    targets = own_targets(head)
    if posing.object is not None:
        targets["head"] = PoseTarget.of(posing.object, posing.bone, head)
    for eye in ("eye_left", "eye_right"):
        if (obj := getattr(posing, eye)) is not None:
            targets[eye] = PoseTarget.of(obj, getattr(posing, f"{eye}_bone"), head)
    return targets

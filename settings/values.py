"""The scene's settings as the plain values that functions take.

Functions, not methods of the property groups: Blender 4.2 ends in a crash after an extension was removed whose property
group had one.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from ..blender.animation.targets import PoseTarget
from ..core.assets import ASSETS
from ..core.bake.settings import BakeSettings
from ..core.capture import is_address
from ..core.drive.settings import DriveSettings, PosingSettings
from ..core.errors import FacemimeError, SourceError
from ..core.live.camera import Camera, CameraSettings, device_of, list_cameras
from ..core.live.sources import LiveSource, PicturePlayer, TakePlayer, VideoPlayer
from ..core.puppet.settings import PuppetSettings
from ..core.takes.file import load_take
from ..core.takes.neutral import Neutral
from ..core.tracking.choice import LEFTMOST, RIGHTMOST
from .bake_table import read_table
from .preferences import preferences
from .properties import FacemimePosing, FacemimeSettings, FacemimeSource
from .rna import read
from .storage import project_folder
from .takes_properties import FacemimeBake

_TO_NEW_KEYS = BakeSettings()
_FACES = {"LARGEST": None, "LEFT": LEFTMOST, "RIGHT": RIGHTMOST}
SAMPLE = ASSETS / "sample" / "sample.mp4"


def drive_settings(settings: FacemimeSettings) -> DriveSettings:
    """How a frame moves a head."""
    return read(DriveSettings, settings, posing=read(PosingSettings, settings.posing))


def puppet_settings(settings: FacemimeSettings, bake: BakeSettings = _TO_NEW_KEYS) -> PuppetSettings:
    """How a take is baked."""
    neutral = None if settings.find_neutral else settings.neutral
    return read(PuppetSettings, settings, drive=drive_settings(settings), neutral=neutral, bake=bake)


def bake_settings(bake: FacemimeBake, name: str) -> BakeSettings:
    """What the take `name` is baked to; FacemimeError where the table has a row that makes no sense."""
    table = read_table(bake) if bake.keys == "mapped" and len(bake.rows) else None
    return read(BakeSettings, bake, table=table, path=project_folder("caches") / bpy.path.clean_name(name))


def face_of(source: FacemimeSource) -> tuple[float, float] | None:
    """Whom to follow of several people, as for `FaceTracker.choose`; None for the largest."""
    return _FACES[source.face]


def open_source(source: FacemimeSource) -> LiveSource:
    """What a live session is to look at.

    Raises
    ------
    SourceError
        Where nothing is chosen, or what is chosen is not there. A camera is opened only by its first `read`.
    """
    playing = {"loop": source.loop, "speed": source.speed}
    if source.kind == "CAMERA":
        return _camera()
    if source.kind == "SAMPLE":
        return VideoPlayer(SAMPLE, **playing)
    if source.kind == "VIDEO":
        return VideoPlayer(_chosen(source.video, "video"), **playing)
    if source.kind == "PICTURES":
        return PicturePlayer(_chosen(source.folder, "folder of pictures"), rate=source.rate, **playing)
    path = _chosen(source.take, "take")
    return TakePlayer(load_take(path), path.name, **playing)


def _camera() -> Camera:
    chosen = preferences()
    device = device_of(chosen.camera, list_cameras())
    if not device:
        raise SourceError("No camera is named. Give its number: 0 is the first.")
    if is_address(device) and not bpy.app.online_access:
        raise SourceError(
            f"{device} is on the network, and Blender may not go there. Allow Online Access in Preferences > System."
        )
    return Camera(CameraSettings(device, chosen.width, chosen.height, chosen.rate))


def _chosen(path: str, what: str) -> Path:
    if not path:
        raise SourceError(f"No {what} is chosen. Choose one under Source.")
    return Path(bpy.path.abspath(path))


def pose_targets(posing: FacemimePosing, head: bpy.types.Object) -> dict[str, PoseTarget]:
    """What takes the pose of the head, "head", and where they are named of the eyes, "eye_left" and "eye_right".

    Raises
    ------
    HeadError
        Where a bone is named that the object does not have.
    """
    targets = {"head": PoseTarget.of(posing.object or head, posing.bone if posing.object else "")}
    for eye in ("eye_left", "eye_right"):
        if (obj := getattr(posing, eye)) is not None:
            targets[eye] = PoseTarget.of(obj, getattr(posing, f"{eye}_bone"))
    return targets


def read_calibration(settings: FacemimeSettings) -> Neutral | None:
    """The neutral of the performer who is chosen; None where nobody is, or calibrated nothing yet.

    Raises
    ------
    SourceError
        Where what is stored is damaged.
    """
    if not 0 <= settings.performer < len(settings.performers):
        return None
    text = settings.performers[settings.performer].calibration
    return Neutral.from_json(text) if text else None


def write_calibration(settings: FacemimeSettings, neutral: Neutral) -> str:
    """Keep `neutral` for the performer who is chosen, or for a new one; returns the performer's name."""
    if not 0 <= settings.performer < len(settings.performers):
        add_performer(settings)
    performer = settings.performers[settings.performer]
    performer.calibration = json.dumps(neutral.to_dict())
    return str(performer.name)


def add_performer(settings: FacemimeSettings, name: str = "") -> None:
    """Add a performer, who is chosen then."""
    taken = {performer.name for performer in settings.performers}
    performer = settings.performers.add()
    number = len(settings.performers)
    performer.name = name or next(f"Performer {n}" for n in range(number, number + 99) if f"Performer {n}" not in taken)
    settings.performer = len(settings.performers) - 1


def remove_performer(settings: FacemimeSettings) -> None:
    """Remove the performer who is chosen; FacemimeError where none is."""
    if not 0 <= settings.performer < len(settings.performers):
        raise FacemimeError("No performer is chosen. Choose one in the list.")
    settings.performers.remove(settings.performer)
    settings.performer = min(settings.performer, len(settings.performers) - 1)

"""Properties of the scene; `values.py` converts them to plain values."""

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
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.tracking.tracking_settings import TrackingSettings
from .rna import with_settings
from .stream_properties import FacemimeOutput, FacemimeStream, FacemimeViewer


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
    """A performer, with name and calibration."""

    key: StringProperty(options={"HIDDEN"})
    calibration: StringProperty(options={"HIDDEN"})


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


CLASSES = (FacemimeSource, FacemimePosing, FacemimePerformer, FacemimeSettings)
POINTERS = ((bpy.types.Scene, "facemime", FacemimeSettings),)

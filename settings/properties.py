"""Settings that belong to the scene. Plain values for the functions that use them come from `values.py`."""

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

from ..core.drive.settings import DriveSettings, PosingSettings
from ..core.puppet.settings import PuppetSettings
from .rna import with_settings


class FacemimeSource(bpy.types.PropertyGroup):
    """Where the face is seen; which camera is the user's, see `preferences.py`."""

    kind: EnumProperty(
        name="Source",
        description="Where the face is seen",
        items=(
            ("CAMERA", "Camera", "A webcam, or the stream of a telephone", "CAMERA_DATA", 0),
            ("VIDEO", "Video", "A video file", "FILE_MOVIE", 1),
            ("PICTURES", "Image Sequence", "The pictures of a folder, in the order of their names", "IMAGE_DATA", 2),
            ("TAKE", "Take", "A recorded take", "ACTION", 3),
            ("SAMPLE", "Sample Clip", "The clip that comes with Facemime: to try it without a camera", "PLAY", 4),
        ),
        default="SAMPLE",
    )
    rate: FloatProperty(name="Rate", description="Frames a second", default=30.0, min=1.0, max=240.0)
    video: StringProperty(name="Video", subtype="FILE_PATH")
    folder: StringProperty(name="Folder", subtype="DIR_PATH")
    take: StringProperty(name="Take", subtype="FILE_PATH")
    loop: BoolProperty(name="Loop", description="Start over at the end", default=True)
    speed: FloatProperty(name="Speed", description="1 is as recorded", default=1.0, min=0.05, max=20.0, soft_max=4.0)
    face: EnumProperty(
        name="Face",
        description="Whom to follow where several people are in view",
        items=(
            ("LARGEST", "Largest", "The face nearest to the camera"),
            ("LEFT", "Leftmost", "The face furthest to the left of the picture"),
            ("RIGHT", "Rightmost", "The face furthest to the right of the picture"),
        ),
    )


@with_settings(PosingSettings)
class FacemimePosing(bpy.types.PropertyGroup):
    """How head and eyes follow, and what takes their pose."""

    object: PointerProperty(
        name="Pose Object",
        description="Takes the head's pose instead of the head itself: an empty, or an armature and its bone",
        type=bpy.types.Object,
    )
    bone: StringProperty(name="Bone", description="Of the armature that takes the pose")
    eye_left: PointerProperty(name="Left Eye", description="Takes the gaze", type=bpy.types.Object)
    eye_left_bone: StringProperty(name="Left Bone")
    eye_right: PointerProperty(name="Right Eye", description="Takes the gaze", type=bpy.types.Object)
    eye_right_bone: StringProperty(name="Right Bone")


class FacemimePerformer(bpy.types.PropertyGroup):
    """A performer's calibration, by `name`."""

    calibration: StringProperty(options={"HIDDEN"})


@with_settings(DriveSettings, PuppetSettings)
class FacemimeSettings(bpy.types.PropertyGroup):
    """How a performance moves the head."""

    find_neutral: BoolProperty(
        name="Find Neutral",
        description="Find the second in which the performer's face is at rest; else say where it starts",
        default=True,
    )
    neutral: FloatProperty(
        name="Neutral At", description="Where the performer's neutral second starts", subtype="TIME_ABSOLUTE", min=0.0
    )
    keep_pose: BoolProperty(
        name="Keep Pose", description="Leave the head as it is when the puppet is stopped; else it rests", default=False
    )
    performer: IntProperty(name="Performer", default=-1, min=-1)
    performers: CollectionProperty(type=FacemimePerformer)
    source: PointerProperty(type=FacemimeSource)
    posing: PointerProperty(type=FacemimePosing)


CLASSES = (FacemimeSource, FacemimePosing, FacemimePerformer, FacemimeSettings)
POINTERS = ((bpy.types.Scene, "facemime", FacemimeSettings),)

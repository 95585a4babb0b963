"""The video and the sound of a performance, in sync with the bake."""

from __future__ import annotations

from math import pi, radians
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..core.errors import SourceError
from ..core.files.capture import VideoSource
from .actions import Curve, write_curves
from .names import TAKE_PROPERTY
from .timeline import rate_of

_ROTATES_VIDEOS = (4, 4, 0)
"""First Blender that displays phone videos upright."""
_HEIGHTS = 0.1
"""Gap between the head and the video, relative to the height of the head."""
_CHANNEL = 1


def add_reference(
    scene: bpy.types.Scene, path: Path, offset: float, head: bpy.types.Object, start: float = 1.0
) -> bpy.types.Object:
    """Add an image empty next to a head, as tall as the head, that plays a video in sync.

    `offset` is the time in the video, in seconds, at the frame `start` of the scene, which is at 0 s of the take.
    Raises SourceError if the video cannot be read.
    """
    with VideoSource(path) as video:
        turn, mirrored, pixel_aspect = video.turn, video.mirrored, video.pixel_aspect
    image = bpy.data.images.load(str(path), check_existing=True)
    image.source = "MOVIE"
    empty = bpy.data.objects.new(f"{path.stem} Reference", None)
    empty.empty_display_type = "IMAGE"
    empty.data = image  # type: ignore[assignment]  # an empty may have an image
    empty.image_user.use_auto_refresh = True
    _keep_in_step(scene, empty, image.frame_duration, _rate_in_blender(path), offset, start)
    image.display_aspect = (max(pixel_aspect, 1.0), max(1.0 / pixel_aspect, 1.0))
    width, height = image.size[0] * image.display_aspect[0], image.size[1] * image.display_aspect[1]
    turned = bpy.app.version < _ROTATES_VIDEOS
    if turned and turn % 180:
        width, height = height, width
    _place(empty, head, width / max(height, 1), radians(turn) if turned else 0.0)
    if mirrored:  # which no Blender does, before or after its rotation
        empty.scale[1 if turned or turn % 180 == 0 else 0] = -1.0
    scene.collection.objects.link(empty)
    return empty


def _rate_in_blender(path: Path) -> float:
    """Return the frames per second by which Blender numbers the images of a video.

    Blender takes an image's number for a time, and shows what is on display then. For a video with a variable rate,
    this rate is not the average that OpenCV states.
    """
    clip = bpy.data.movieclips.load(str(path))
    try:
        return float(clip.fps)
    finally:
        bpy.data.movieclips.remove(clip)


def _keep_in_step(
    scene: bpy.types.Scene, empty: bpy.types.Object, count: int, fps: float, offset: float, start: float
) -> None:
    """Show the image of the time t + offset at t seconds after the frame `start` of a scene."""
    rate, user = rate_of(scene), empty.image_user
    first = int(np.floor(start))
    frames = np.arange(first, max(first + 1, int(np.ceil(start + (count / fps - offset) * rate))) + 1)
    shown = np.round(((frames - start) / rate + offset) * fps) - (frames - first)
    # Blender adds the offset to the frame within this span of the scene, in which it stays.
    user.frame_start, user.frame_duration, user.frame_offset = first, len(frames), int(shown[0])
    if np.ptp(shown) > 0:
        write_curves(empty, empty.name, frames.astype(np.float64), [Curve("image_user.frame_offset", 0, shown)])


def _place(empty: bpy.types.Object, head: bpy.types.Object, aspect: float, turn: float) -> None:
    """Place the empty upright, rotated clockwise by `turn` radians, to the left of `head` as seen from the front, where
    the sidebar does not cover it.
    """
    corners = np.array([head.matrix_world @ Vector(corner) for corner in head.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    height = float(high[2] - low[2])
    empty.empty_display_size = height * max(aspect, 1.0)
    x = low[0] - (_HEIGHTS + 0.5 * aspect) * height
    empty.location = (x, 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2]))
    empty.rotation_euler = (0.5 * pi, turn, 0.0)


def add_sound(scene: bpy.types.Scene, path: Path, frame: float) -> bpy.types.Strip:
    """Add a sound strip of a sound file or a video on a free channel, which starts at `frame`.

    Raises SourceError if the file is missing or has no sound.
    """
    if not path.is_file():
        raise SourceError("The file {path} does not exist. Choose the video or the sound file of the take.", path=path)
    sound = bpy.data.sounds.load(str(path), check_existing=True)
    if sound.channels == "INVALID":
        bpy.data.sounds.remove(sound)
        raise SourceError("{name} contains no readable sound. Choose another file.", name=path.name)
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = strips_of(editor)
    channel = max((strip.channel for strip in strips), default=_CHANNEL - 1) + 1
    strip = strips.new_sound(path.stem, str(path), channel, int(frame // 1))
    strip.frame_start = frame
    strip[TAKE_PROPERTY] = True
    return strip


def strips_of(editor: bpy.types.SequenceEditor) -> bpy.types.StripsTopLevel:
    """Return the strips of a Sequencer in any version of Blender."""
    return editor.strips if hasattr(editor, "strips") else editor.sequences


def is_of_take(strip: bpy.types.Strip) -> bool:
    """Return whether Facemime added a strip, with the sound of a take."""
    return bool(strip.get(TAKE_PROPERTY, False))

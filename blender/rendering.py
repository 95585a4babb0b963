"""Renders of a scene as arrays, and H.264 video from arrays, which OpenCV cannot write."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import OutputError, SourceError
from ..core.files.capture import VideoSource, require_utf8_name
from ..core.files.locks import temporary_folder
from ..core.files.writing import replacing
from .contexts import showing_scene
from .preview_scene import set_shading
from .reference import strips_of
from .view_layers import collections_in, set_for_now

Image = NDArray[np.uint8]
_ENLARGED = 1.25
"""Size at which images are rendered, relative to their own."""
_LEAST_SIDE = 640
"""Smallest longer side at which images are rendered, in pixels, for lashes in small images."""


def render_frames(scene: bpy.types.Scene, frames: Iterable[float], size: tuple[int, int]) -> Iterator[Image]:
    """Render frames, which may be fractional, of a scene from its camera as BGR images (height, width, 3).

    They are rendered with Workbench and no other render setting of the scene, larger without anti-aliasing, and
    averaged: without a graphics card this takes a fraction of the time of Workbench's eight samples and looks the same.
    Raises OutputError if Blender cannot draw, or the temporary folder is full, and SourceError if the name of that
    folder is not valid UTF-8.
    """
    _require_display_library()
    # Animation is evaluated in the scene that is shown only.
    with temporary_folder() as folder, _picture_of(scene) as picture, showing_scene(picture):
        require_utf8_name(folder)
        yield from _rendered(picture, frames, size, folder / "frame.bmp")


def _rendered(scene: bpy.types.Scene, frames: Iterable[float], size: tuple[int, int], path: Path) -> Iterator[Image]:
    render = scene.render
    enlarged = max(_ENLARGED, _LEAST_SIDE / max(size))
    render.resolution_x, render.resolution_y = (round(enlarged * side) for side in size)
    render.resolution_percentage = 100
    scene.display.render_aa = "OFF"
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format = "BMP"
    render.image_settings.color_mode = "RGB"
    render.filepath = _literal(path)
    for frame in frames:
        whole = int(np.floor(frame))
        scene.frame_set(whole, subframe=float(frame - whole))
        with quiet():
            bpy.ops.render.render(write_still=True, scene=scene.name)
        image = cv2.imread(str(path))
        if image is None:
            raise OutputError("Blender did not render an image. Free some disk space in the temporary folder.")
        yield np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


@contextlib.contextmanager
def _picture_of(scene: bpy.types.Scene) -> Iterator[bpy.types.Scene]:
    """Yield a new scene with the objects, camera, world and rate of another, which exists as long as the context.

    The other one was set up by `setup_preview`. A new scene has no sequence, markers, compositor, view layers, stereo,
    region, exposure or time remapping of the user's, nor anything else that later versions of Blender add.
    """
    picture = bpy.data.scenes.new("Facemime Picture")
    try:
        for child in scene.collection.children:
            picture.collection.children.link(child)
        for obj in scene.collection.objects:
            picture.collection.objects.link(obj)
        picture.view_layers[0].update()  # which has no collections before, from Blender 5.2 on
        layers = (one.view_layers[0].layer_collection for one in (scene, picture))
        for own, new in zip(*map(collections_in, layers), strict=True):
            new.exclude = own.exclude
        picture.camera, picture.world = scene.camera, scene.world
        picture.render.fps, picture.render.fps_base = scene.render.fps, scene.render.fps_base
        set_shading(picture, scene.display.matcap_ssao_distance)
        yield picture
    finally:
        bpy.data.scenes.remove(picture)


@contextlib.contextmanager
def without_subdivision(scene: bpy.types.Scene) -> Iterator[None]:
    """Render objects of a scene without subdivision, which would take three quarters of the time of a small image."""
    with contextlib.ExitStack() as stack:
        for modifier in (modifier for obj in scene.objects for modifier in obj.modifiers if modifier.type == "SUBSURF"):
            set_for_now(stack, modifier, "show_render", False)
        yield


def _require_display_library() -> None:
    """Raise OutputError if Blender cannot draw, as it would terminate the whole process instead of failing."""
    if sys.platform == "linux" and bpy.app.background:
        try:
            ctypes.CDLL("libEGL.so.1")
        except OSError as error:
            raise OutputError("Blender cannot render: libEGL.so.1 is missing. Install libegl1.") from error


def write_video(images: Iterable[Image], fps: float, path: Path) -> None:
    """Write BGR images of the same, even size as an MP4 file in H.264 with Blender's encoder.

    Raises OutputError if the file cannot be written, and SourceError if the name of the temporary folder is not valid
    UTF-8.
    """
    with replacing(Path(path)) as temporary, temporary_folder() as folder:
        require_utf8_name(folder)
        names = []
        for i, image in enumerate(images):
            names.append(f"{i:06d}.jpg")
            if not cv2.imwrite(str(folder / names[-1]), image, (cv2.IMWRITE_JPEG_QUALITY, 97)):
                raise OutputError("Cannot write images to {folder}. Free some disk space.", folder=folder)
        if not names:
            raise OutputError("There are no images for the video. Use a take with at least one frame.")
        temporary.unlink()
        with contextlib.suppress(RuntimeError):  # Blender blames the codec even if the disk is full
            _encode(folder, names, (image.shape[1], image.shape[0]), fps, temporary)
        if _frames_in(temporary) < len(names):  # no error is raised if the disk fills up later
            raise OutputError(
                "Blender could not write {path}. Free some disk space, or choose another location.", path=path
            )


def _frames_in(path: Path) -> int:
    """Return the number of frames in the header of the video at `path`; 0 if it cannot be read."""
    try:
        with VideoSource(path) as video:
            return video.frame_count
    except SourceError:
        return 0


def _encode(folder: Path, names: list[str], size: tuple[int, int], fps: float, output: Path) -> None:
    scene = bpy.data.scenes.new("Facemime Encoding")
    try:
        render = scene.render
        render.resolution_x, render.resolution_y = size
        render.resolution_percentage = 100
        set_rate(scene, fps)
        scene.view_settings.view_transform = "Standard"  # type: ignore[assignment]  # depends on the configuration
        scene.frame_start, scene.frame_end = 1, len(names)
        editor = scene.sequence_editor_create()
        strip = strips_of(editor).new_image("frames", str(folder / names[0]), channel=1, frame_start=1)
        assert isinstance(strip, bpy.types.ImageStrip)
        for name in names[1:]:
            strip.elements.append(name)
        strip.frame_final_duration = len(names)
        if hasattr(render.image_settings, "media_type"):
            render.image_settings.media_type = "VIDEO"
        render.image_settings.file_format = "FFMPEG"
        render.ffmpeg.format = "MPEG4"
        render.ffmpeg.codec = "H264"
        render.ffmpeg.constant_rate_factor = "HIGH"
        render.ffmpeg.ffmpeg_preset = "GOOD"
        render.use_file_extension = False
        render.filepath = _literal(output)
        with quiet():
            bpy.ops.render.render(animation=True, scene=scene.name)
    finally:
        bpy.data.scenes.remove(scene)


def _literal(path: Path) -> str:
    """Return the text of a path for Blender's render output, in which braces have a meaning from Blender 4.5."""
    text = str(path)
    return text if bpy.app.version < (4, 5, 0) else text.replace("{", "{{").replace("}", "}}")


def set_rate(scene: bpy.types.Scene, fps: float) -> None:
    """Set the frame rate of `scene` to `fps`; fractions such as 30000/1001 are kept exactly."""
    fraction = Fraction(fps).limit_denominator(1001)
    whole = round(fps) if abs(fps - round(fps)) < 1e-3 else int(np.ceil(fps))
    scene.render.fps = whole
    scene.render.fps_base = whole / float(fraction)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of Blender and its drivers, such as a line per frame; errors are exceptions anyway."""
    streams = (sys.stdout, sys.stderr)
    for stream in streams:
        stream.flush()
    saved = [os.dup(number) for number in (1, 2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(null, number)
        yield
    finally:
        for stream in streams:  # output may still be in a buffer, Python's or C's, and appear later
            stream.flush()
        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)
        for number, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(null)

"""Frames of a scene and seconds."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray


def rate_of(scene: bpy.types.Scene) -> float:
    """Return the frames per second of `scene`."""
    return float(scene.render.fps / scene.render.fps_base)


def keyed_frame(scene: bpy.types.Scene, frame: float) -> float:
    """Return the frame of keyframes that `frame` of the scene shows, which Time Stretching tells apart."""
    return float(frame * scene.render.frame_map_old / scene.render.frame_map_new)


def shown_frames(scene: bpy.types.Scene, frames: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the frames of the scene that show keyframes at `frames`, (N,); the inverse of `keyed_frame`."""
    return frames * scene.render.frame_map_new / scene.render.frame_map_old


def frames_of(
    scene: bpy.types.Scene, times: NDArray[np.floating[Any]], start: float = 1.0
) -> NDArray[np.floating[Any]]:
    """Convert seconds to frames of keyframes in the scene, which may be fractional; frame `start` is at 0 s."""
    return start + times * rate_of(scene)


def seconds_of(scene: bpy.types.Scene, start: float = 1.0) -> float:
    """Return the seconds at the current frame, the inverse of `frames_of`."""
    return seconds_at(scene, scene.frame_current_final, start)


def seconds_at(scene: bpy.types.Scene, frame: float, start: float = 1.0) -> float:
    """Return the time at `frame` of the scene, seconds; frame `start` is at 0 s."""
    return float((frame - start) * scene.render.fps_base / scene.render.fps)


def frame_range(scene: bpy.types.Scene) -> range:
    """Return the frames that Blender plays: the preview range, if one is set, or otherwise those of the scene."""
    if scene.use_preview_range:
        return range(scene.frame_preview_start, scene.frame_preview_end + 1)
    return range(scene.frame_start, scene.frame_end + 1)

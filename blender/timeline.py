"""Frames of a scene, seconds, and the frames of keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.bake.bake_settings import BakeSettings
from ..core.bake.whole_frames import curves_at, motion_at, whole_frames
from ..core.drive.driver import HeadMotion
from ..core.numeric.arrays import FloatArray


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


@dataclass(frozen=True)
class Timing:
    """The frames of a motion, (N,), and those of its keyframes, (M,), which are the same unless they are whole."""

    frames: FloatArray
    keyed: FloatArray

    @classmethod
    def of(cls, scene: bpy.types.Scene, frames: FloatArray, bake: BakeSettings) -> Timing:
        if not bake.whole_frames or bake.writes_cache:
            return cls(frames, frames)
        # Time Stretching shows keyframes in other frames.
        whole = whole_frames(shown_frames(scene, frames))
        return cls(frames, np.array([keyed_frame(scene, frame) for frame in whole]))

    @property
    def is_whole(self) -> bool:
        """Whether keyframes are on whole frames."""
        return self.keyed is not self.frames

    def curves(self, values: FloatArray) -> FloatArray:
        """Return curves (N, K) in the frames of the keyframes, (M, K)."""
        return curves_at(self.frames, values, self.keyed) if self.is_whole else values

    def motion(self, motion: HeadMotion) -> HeadMotion:
        """Return a motion in these frames, without its vertices."""
        return motion_at(self.frames, motion, self.keyed) if self.is_whole else motion

"""A bake that was computed but not written yet, and the frames of its keyframes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.bake.bake_settings import BakeSettings
from ...core.bake.whole_frames import curves_at, motion_at, whole_frames
from ...core.drive.driver import HeadMotion
from ...core.numeric.arrays import FloatArray
from ..fcurves import CharacterAction
from ..muting import Silenced
from ..timeline import keyed_frame, shown_frames


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


@dataclass(frozen=True)
class Plan:
    """A bake that was computed but not written yet.

    Attributes
    ----------
    keys : int
        Number of shape keys.
    error, named_error : float
        As in `PuppetReport`, in the unit of the mesh.
    write : callable
        Writes it, and returns what it muted.
    keyframes : int
        Number of keyframes of the shape keys.
    controls : int
        Number of controls, of which `keys` are the curves.
    """

    keys: int
    error: float
    write: Callable[[CharacterAction], list[Silenced]]
    named_error: float = float("nan")
    keyframes: int = 0
    controls: int = 0

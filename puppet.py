"""A take onto a head: the one function behind the operator and the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from .blender.bake import bake_parts, bake_pose, bake_shape, clear_pose, frames_of, set_range
from .blender.meshes import read_rig
from .core.deform.basis import fit_basis
from .core.drive import DriveOptions, HeadDriver
from .core.landmarks import OUTER_EYE_CORNERS
from .core.motion import HeadMotion, drive_take
from .core.retarget import Neutral, calibrate
from .core.takes.smooth import smooth_take
from .core.takes.take import Take

TOLERANCE = 0.009


@dataclass(frozen=True)
class PuppetSettings:
    """How a take moves a head.

    Attributes
    ----------
    drive : DriveOptions
    neutral : float or None
        Seconds at which the performer's neutral second starts; None finds it.
    smoothing : float
        As for `ResultSmoother`; 0 leaves the take as it is.
    rotation, translation : bool
        Whether the head's pose follows the performer's.
    """

    drive: DriveOptions = field(default_factory=DriveOptions)
    neutral: float | None = None
    smoothing: float = 1.0
    rotation: bool = True
    translation: bool = False


@dataclass(frozen=True)
class PuppetReport:
    """What a bake did: `keys` shape keys, `worst_error` as a fraction of the outer-eye distance, and the motion."""

    keys: int
    worst_error: float
    neutral: Neutral
    motion: HeadMotion


def puppet_head(
    scene: bpy.types.Scene,
    obj: bpy.types.Object,
    take: Take,
    settings: PuppetSettings = PuppetSettings(),
    pose_object: bpy.types.Object | None = None,
) -> PuppetReport:
    """Drive `obj` by `take` and bake the result to shape keys and curves, in step with the media's clock.

    Parameters
    ----------
    pose_object : optional
        What takes the head's pose instead of `obj`: an empty, say.

    Raises
    ------
    FacemimeError
        Where the mesh cannot be driven or the take holds no face.
    """
    rig = read_rig(obj)
    take = smooth_take(take, settings.smoothing)
    neutral = calibrate(take, settings.neutral)
    driver = HeadDriver(rig, neutral, settings.drive)
    motion = drive_take(driver, take)
    eyes = rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]].astype(np.float64)
    unit = float(np.linalg.norm(eyes[0] - eyes[1]))
    basis = fit_basis(motion.vertices, TOLERANCE * unit)
    frames = frames_of(scene, motion.times)
    bake_shape(obj, basis, frames)
    clear_pose(obj)
    bake_pose(pose_object or obj, motion, frames, rotation=settings.rotation, translation=settings.translation)
    bake_parts(obj, motion, frames)
    set_range(scene, frames_of(scene, take.times))
    return PuppetReport(len(basis.modes), basis.worst_error / unit, neutral, motion)


def puppet_heads(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], take: Take, settings: PuppetSettings = PuppetSettings()
) -> list[PuppetReport]:
    """Drive many heads by one take, each with its own landmarks, regions and pose; all are checked before any moves."""
    for obj in objects:
        read_rig(obj)
    return [puppet_head(scene, obj, take, settings) for obj in objects]

"""Bakes to the controls of a character's own rig."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.bake.bake_settings import BakeSettings
from ...core.bake.bezier import BezierCurve
from ...core.bake.curves import fit_key_curves
from ...core.drive.driver import HeadMotion
from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import ROTATION, RigChannel, RigMap
from ...core.rigs.solver import RigSolver
from ..actions import Curve, write_curves
from ..controls.finding import path_of
from ..controls.setting import ControlValues, has_locked_angles, held, holder_of, turned
from ..controls.stored import read_controls, stored_map
from ..controls.view import PosedFace
from ..fcurves import CharacterAction
from ..muting import Silenced
from ..own_pose import rotation_channel
from ..rigs import read_rig
from ..switching import without_bake
from ..timeline import Timing
from .bake_report import Plan

CORRECTIONS = 2
"""Evaluations of the rig by which each frame is corrected."""


@dataclass(frozen=True)
class ControlCurves:
    """Curves of the controls of a rig, by the object that they animate."""

    curves: dict[str, list[Curve]]

    @classmethod
    def of(cls, found: RigMap, values: FloatArray, tolerance: float) -> ControlCurves:
        """Return the curves of changes of the channels from rest, (N, C).

        `tolerance` is the error of the face that fewer keyframes may cause, in the unit of the mesh; 0 keeps a keyframe
        in each frame. Raises HeadError if a control is missing.
        """
        straight = np.array([channel.kind != ROTATION for channel in found.channels], dtype=bool)
        fitted = iter(_fitted(found.chosen(straight), values[:, straight], tolerance))
        regions, curves, turned = found.regions, dict[str, list[Curve]](), dict[tuple[str, str], dict[int, int]]()
        for number, channel in enumerate(found.channels):
            if channel.kind == ROTATION:
                turned.setdefault((channel.owner, channel.bone), {})[channel.index] = number
                continue
            group, column = regions[channel.control], values[:, number] + channel.rest
            curve = Curve(path_of(channel), channel.index, column, fitted=next(fitted), group=group)
            curves.setdefault(channel.owner, []).append(curve)
        for (owner, _), axes in turned.items():
            vectors = np.zeros((len(values), 3))
            vectors[:, list(axes)] = values[:, list(axes.values())]
            channel = found.channels[next(iter(axes.values()))]
            angle = tolerance / _reach(found, list(axes.values())) if tolerance > 0.0 else None
            curves.setdefault(owner, []).extend(_turning(channel, vectors, angle, regions[channel.control]))
        return cls(curves)

    @property
    def count(self) -> int:
        """Number of curves."""
        return sum(map(len, self.curves.values()))

    @property
    def keyframes(self) -> int:
        """Number of keyframes whose places are known."""
        every = [curve for curves in self.curves.values() for curve in curves]
        return sum(len(curve.values) if curve.fitted is None else len(curve.fitted.rows) for curve in every)

    def write(
        self,
        head: bpy.types.Object,
        frames: NDArray[np.floating[Any]],
        action: CharacterAction,
        *,
        nla: bool,
        keep: bool,
    ) -> list[Silenced]:
        """Animate the controls in frames (N,), and return what was muted."""
        silenced = []
        for owner, curves in self.curves.items():
            how = {"nla": nla, "add": keep, "leave_drivers": keep}
            silenced += write_curves(
                bpy.data.objects[owner], f"{head.name} Controls", frames, curves, action=action, **how
            )
        return silenced


def _fitted(found: RigMap, values: FloatArray, tolerance: float) -> list[BezierCurve | None]:
    """Return few keyframes of channels that are not rotations."""
    if tolerance <= 0.0 or not len(found.channels):
        return [None] * len(found.channels)
    rest = np.array([channel.rest for channel in found.channels])
    lower, upper = (np.array([getattr(channel, end) for channel in found.channels]) for end in ("low", "high"))
    return list(fit_key_curves(values + rest, _per_channel(found), tolerance, lower + rest, upper + rest))


def _per_channel(found: RigMap) -> FloatArray:
    """Return the displacements (C, S, 3) by each channel at 1: in its direction that moves more."""
    out = np.zeros((len(found.channels), *found.effects.shape[1:]))
    for k, channel in enumerate(found.channel.tolist()):
        effect = found.effects[k] / found.scale[k]
        if np.linalg.norm(effect) > np.linalg.norm(out[channel]):
            out[channel] = effect
    return out


def _reach(found: RigMap, numbers: list[int]) -> float:
    """Return how far channels move a vertex at 1."""
    return float(np.linalg.norm(_per_channel(found)[numbers], axis=2).max(initial=1e-12))


def _turning(channel: RigChannel, vectors: FloatArray, angle: float | None, group: str) -> list[Curve]:
    """Return the curves of rotation vectors (N, 3) in the rotation mode of a control."""
    holder = holder_of(channel.owner, channel.bone)
    mode, own = holder.rotation_mode, tuple(getattr(holder, rotation_channel(holder)))
    locked = holder.lock_rotation[:] if has_locked_angles(holder) else (False,) * len(own)
    before, rows = None, []
    for vector in vectors:
        before = turned(holder, vector, own, before)
        rows.append(before)
    tolerance = None if angle is None else angle / 2.0 if mode == "QUATERNION" else angle
    path = path_of(channel, mode)
    columns = enumerate(np.array(rows).T)
    return [Curve(path, axis, column, tolerance, group=group) for axis, column in columns if not locked[axis]]


def controls_plan(obj: bpy.types.Object, motion: HeadMotion, timing: Timing, unit: float, bake: BakeSettings) -> Plan:
    """Plan a bake to the controls of a head; raises FacemimeError as `read_controls`, or if a control is missing."""
    found = read_controls(obj)
    solved = solve_motion(obj, found, motion.vertices[:, found.sample].astype(np.float64))
    tolerance = bake.clean * unit if timing.is_whole else 0.0
    values = with_taught(found, solved.values, motion.controls)
    curves = ControlCurves.of(found, timing.curves(values), tolerance)

    def write(action: CharacterAction) -> list[Silenced]:
        return curves.write(obj, timing.keyed, action, nla=bake.nla, keep=bake.keep_animation)

    error, count = float(solved.errors.max(initial=0.0)), len(found.controls)
    return Plan(curves.count, error, write, keyframes=curves.keyframes, controls=count)


def with_taught(found: RigMap, values: FloatArray, changes: Mapping[str, FloatArray]) -> FloatArray:
    """Add what was taught, by `RigChannel.key`, to changes of the channels from rest (..., C), within their limits."""
    values = np.array(values)
    for number, channel in enumerate(found.channels):
        if (change := changes.get(channel.key)) is not None:
            values[..., number] = np.clip(values[..., number] + change, channel.low, channel.high)
    return values


def control_owners(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the objects whose channels are controls of a head, as far as they exist."""
    found = stored_map(head)
    names = dict.fromkeys(channel.owner for channel in found.channels) if found is not None else ()
    return [bpy.data.objects[name] for name in names if name in bpy.data.objects]


def rest_controls(head: bpy.types.Object, owner: bpy.types.Object, paths: Collection[str]) -> None:
    """Return the controls of a head that a bake animated to their rest."""
    found = stored_map(head)
    if found is None or not paths:
        return
    channels = [
        channel for channel in found.channels if channel.owner == owner.name and _animated_path(owner, channel) in paths
    ]
    ControlValues(channels).write(np.zeros(len(channels)))


def _animated_path(owner: bpy.types.Object, channel: RigChannel) -> str:
    """Return the data path of a channel as it is; "" if its control is gone."""
    if channel.bone and (owner.pose is None or channel.bone not in owner.pose.bones):
        return ""
    holder = holder_of(channel.owner, channel.bone)
    if channel.name and not isinstance(holder.get(channel.name), float):
        return ""
    return path_of(channel, holder.rotation_mode)


@dataclass(frozen=True)
class ControlMotion:
    """Changes of the channels from rest, (N, C), and the largest distance of a sampled vertex from its target in each
    frame, (N,), in the unit of the mesh.
    """

    values: FloatArray
    errors: FloatArray


def solve_motion(head: bpy.types.Object, found: RigMap, wanted: FloatArray) -> ControlMotion:
    """Solve for displacements (N, S, 3) of the sampled vertices; afterwards every channel is what it was.

    The pointer shows the progress. Raises HeadError if a control is missing.
    """
    solver, view = RigSolver(found), PosedFace(head, read_rig(head))
    values, errors = np.empty((len(wanted), len(found.channels))), np.empty(len(wanted))
    manager = bpy.context.window_manager
    manager.progress_begin(0.0, max(len(wanted), 1))
    try:
        with without_bake(head), held(found.channels) as controls:
            controls.write(np.zeros(len(found.channels)))
            rest = view.look().face

            def evaluate(changes: FloatArray) -> FloatArray:
                controls.write(changes)
                return view.look().face - rest

            for row, target in enumerate(wanted):
                manager.progress_update(row)
                values[row], shown = solver.corrected(target, evaluate, CORRECTIONS)
                errors[row] = np.linalg.norm(shown - target, axis=1).max()
    finally:
        manager.progress_end()
        view.close()
    return ControlMotion(values, errors)

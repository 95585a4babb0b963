"""Learning what the controls of a rig do to a face, by moving each a little and looking at the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import groupby

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.face.landmarks import CHIN, LIPS, N_LANDMARKS
from ...core.numeric.arrays import FloatArray
from ...core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, SCALE, Probe, RigChannel, RigMap, even_probes, map_of
from ..rigs import read_rig
from ..switching import without_bake
from .finding import channels_of, driving_controls, require_deforming
from .limits import limited
from .setting import ControlValues
from .view import PosedFace, Seen

_FIRST = {LOCATION: 0.05, ROTATION: np.radians(6.0), SCALE: 0.5}
"""First step of a channel without limits, in eye distances, radians, and shares of the size; a scale has no other."""
_WANTED = (0.04, 0.16)
"""Largest motion of the face by which a channel is judged, in eye distances; steps are changed to reach it."""
_FARTHER = 10.0
"""Factor of the step of what drives something, as long as nothing moves: sliders are as long as their makers like."""
_MORE_TRIES = 4
"""Further steps of what drives something: up to 500 eye distances."""
_MIDDLE = 0.1
"""Motion that is aimed at."""
_TRIES = 3
"""Largest number of steps that are tried."""
_INSIDE = 0.5
"""Share of the range of a property to which it is moved: at its ends drivers may divide by zero."""
_STILL = 1e-3
"""Motion of the face below which a control does nothing, in eye distances."""
_OTHERS = 0.8
"""Motion of vertices outside the face, relative to that inside, above which a control moves ears, neck or head."""
_EYES = 0.01
"""Motion of an eyeball above which a control moves the gaze, in eye distances."""
_JAW = 0.6
"""Motion of the chin, relative to the largest of the face, above which a rotation turns the jaw."""
_BESIDE = 0.6
"""Motion of a landmark elsewhere, relative to the largest of the lips, up to which a scale shapes the lips: on Rigify's
face at most 0.41 for controls of the lips, and from 0.92 for others."""


class Learning:
    """Learning the controls of a head, step by step; `close` in any case, which restores every channel.

    Attributes
    ----------
    done, total : int
        Channels that were moved, and that there are.
    """

    def __init__(self, head: bpy.types.Object) -> None:
        require_deforming(head)
        self.head = head
        self._bake = ExitStack()
        self._bake.enter_context(without_bake(head))
        try:
            self._begin(head)
        except BaseException:
            self._bake.close()
            raise

    def _begin(self, head: bpy.types.Object) -> None:
        self.channels, self._driving = channels_of(head), driving_controls(head)
        self.done, self.total = 0, len(self.channels)
        self._values = ControlValues(self.channels)
        self._view = PosedFace(head, read_rig(head))
        self._probes: list[list[Probe]] = [[] for _ in self.channels]

    def close(self) -> None:
        """Restore the rig."""
        self._bake.close()
        self._values.restore()
        self._view.close()

    def steps(self) -> Iterator[None]:
        """Move one control after the other."""
        self._rest = self._look(np.zeros(self.total))
        for key, group in groupby(range(self.total), key=lambda number: _control(self.channels[number])):
            numbers = list(group)
            for number in numbers:
                self.channels[number] = limited(self.channels[number], partial(self._set, number))
            if key[2] == PROPERTY or self._touches(numbers):
                for number in numbers:
                    self._probes[number] = self._probe(number)
                    yield
            self.done = numbers[-1] + 1
            yield

    def result(self) -> RigMap:
        """Return what was learnt; HeadError if no control moves the face."""
        symmetry = self._view.symmetry
        probes = even_probes(self._probes, symmetry) if symmetry is not None else self._probes
        found = map_of(self.channels, probes, self._view.sample, self._view.unit)
        if not found.channels:
            raise HeadError(
                "No control of {name} moves its face. Unhide the controls of the face, and try again.",
                name=self.head.name,
            )
        return found

    def _set(self, number: int, value: float) -> None:
        """Set one channel to a change from rest, and the others to rest."""
        values = np.zeros(self.total)
        values[number] = value
        self._values.write(values)

    def _look(self, values: FloatArray) -> Seen:
        self._values.write(values)
        return self._view.look()

    def _first(self, channel: RigChannel, limit: float) -> float:
        """Return the first step of a channel: of one with a limit, and of a scale, the only one."""
        if np.isfinite(limit) and channel.kind not in (ROTATION, SCALE):
            return limit * (_INSIDE if channel.kind == PROPERTY else 1.0)
        step = float(_FIRST.get(channel.kind, 0.1)) * (channel.unit if channel.kind == LOCATION else 1.0)
        return float(min(step, limit))

    def _touches(self, numbers: list[int]) -> bool:
        """Return whether a control serves if all its channels of a kind are moved at once."""
        if all(self._drives(self.channels[number]) for number in numbers):
            return True
        values = np.zeros(self.total)
        for number in numbers:
            channel = self.channels[number]
            up, down = (self._first(channel, limit) for limit in (channel.high, -channel.low))
            values[number] = up if up > 0.0 else -down
        moved = self._look(values).face - self._rest.face
        return _size(moved) > _STILL * self._view.unit and _serves(self.channels[numbers[0]].kind, moved)

    def _drives(self, channel: RigChannel) -> bool:
        """Return whether a channel is a location that drives something."""
        return channel.kind == LOCATION and (channel.owner, channel.bone) in self._driving

    def _probe(self, number: int) -> list[Probe]:
        """Move a channel in both directions, as far as it can; nothing if neither moves the face alone."""
        found: list[Probe] = []
        channel = self.channels[number]
        for sign, limit in ((1.0, channel.high), (-1.0, -channel.low)):
            if limit <= 0.0:
                continue
            first = min(abs(found[0].step), limit) if found and not np.isfinite(limit) else self._first(channel, limit)
            probe = self._moved(number, sign, first, limit)
            if probe is None:
                return []
            found.append(probe)
        return found if any(_size(probe.moved) >= _STILL * self._view.unit for probe in found) else []

    def _moved(self, number: int, sign: float, step: float, limit: float) -> Probe | None:
        """Move a channel in one direction; None if it moves head, ears or eyes as well."""
        channel, values = self.channels[number], np.zeros(self.total)
        tries = 1 if channel.kind == SCALE or (np.isfinite(limit) and channel.kind != ROTATION) else _TRIES
        farther = _MORE_TRIES if self._drives(channel) and tries > 1 else 0
        for left in reversed(range(tries + farther)):
            values[number] = sign * step
            seen = self._look(values)
            moved = seen.face - self._rest.face
            size = _size(moved) / self._view.unit
            if size < _STILL and left and farther:
                farther, step = farther - 1, step * _FARTHER
                continue
            if size < _STILL or not left or self._is_elsewhere(seen) or _WANTED[0] <= size <= _WANTED[1]:
                break
            step = min(step * float(np.clip(_MIDDLE / size, 0.1, 10.0)), limit)
        if not np.isfinite(moved).all() or self._is_elsewhere(seen):
            return None
        if channel.kind == ROTATION and not _turns_jaw(moved):
            return None
        return Probe(float(sign * step), moved)

    def _is_elsewhere(self, seen: Seen) -> bool:
        """Return whether the head, an ear, the neck or an eye has moved, rather than the face alone."""
        rest, unit = self._rest, self._view.unit
        if _size(seen.outside - rest.outside) > max(_OTHERS * _size(seen.inside - rest.inside), _STILL * unit):
            return True
        return _size(seen.eyes - rest.eyes) > _EYES * unit or not np.allclose(seen.head, rest.head, atol=1e-3)


def _control(channel: RigChannel) -> tuple[str, str, str, str]:
    """Return what channels that are moved at once have in common: a control without limits, and its kind."""
    limited = np.isfinite(channel.low) or np.isfinite(channel.high)
    alone = f"{channel.name}:{channel.index}" if limited and channel.kind == LOCATION else channel.name
    return channel.owner, channel.bone, channel.kind, alone


def _size(moved: NDArray[np.float64]) -> float:
    """Return the largest displacement, of (N, 3)."""
    return float(np.linalg.norm(moved, axis=1).max(initial=0.0))


def _serves(kind: str, moved: FloatArray) -> bool:
    """Return whether channels that move the sampled vertices so may be used: of rotations those that turn the jaw, and
    of scales those that shape the lips, whose thickness no location changes.
    """
    if kind == SCALE:
        size = np.linalg.norm(moved[:N_LANDMARKS], axis=1)
        return bool(np.delete(size, LIPS).max() < _BESIDE * size[LIPS].max())
    return kind != ROTATION or _turns_jaw(moved)


def _turns_jaw(moved: NDArray[np.float64]) -> bool:
    """Return whether the chin moves nearly as much as anything else."""
    size = np.linalg.norm(moved, axis=1)
    return bool(size[CHIN].mean() > _JAW * size.max())


def learn_controls(head: bpy.types.Object) -> RigMap:
    """Learn the controls of a head at once; raises HeadError as `Learning`."""
    learning = Learning(head)
    try:
        for _ in learning.steps():
            pass
        return learning.result()
    finally:
        learning.close()

"""Shape keys of a known set that animate a head: their values are the coefficients, and need not be solved for."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.bake.arkit import arkit_coefficients
from ...core.bake.key_map import KeyMap, best_preset, presets
from ...core.errors import Message
from ...core.face.coefficient_names import COEFFICIENTS
from ...core.heads.looks import LOOKS
from ...core.numeric.arrays import FloatArray
from ...core.takes.neutral import calibrate
from ...core.takes.take import Take
from ..characters import objects_of
from ..meshes import key_names, keys_of

_STILL = 1e-4
"""Largest value of keys that count as not animated: less than a step of a take's coefficients matters."""
_MOST = 1.001
"""Value above which a key is exaggerated: single precision exceeds 1 by less."""
_LOOKS = {COEFFICIENTS[column] for column in LOOKS}


class AnimatedKeys:
    """Reads the values of the keys of a head while its animation is sampled.

    Parameters
    ----------
    head : bpy.types.Object
        The head; keys of the other meshes of its face count as well.
    """

    def __init__(self, head: bpy.types.Object) -> None:
        self._objects = [obj for obj in (head, *objects_of(head)) if key_names(obj)]
        self._table = _table([key_names(obj) for obj in self._objects])
        self._names = () if self._table is None else self._table.keys
        self._rows: list[list[float]] = []

    @property
    def moved(self) -> bool:
        """Whether a key has had a value other than 0."""
        return bool(self._rows) and bool(np.abs(self._rows).max(initial=0.0) > _STILL)

    def read(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Read the values in the current frame; of a key on several meshes, the one furthest from 0."""
        if self._names:
            values = [_values(obj.evaluated_get(depsgraph)) for obj in self._objects]
            self._rows.append([max((of.get(name, 0.0) for of in values), key=abs) for name in self._names])

    def state(self, take: Take) -> None:
        """Let a take of the frames that were read state their coefficients, unless no key moved.

        Directions of the eyes that no key determines are those of the gaze.
        """
        seen = take.found
        if self._table is None or not self.moved or not seen.any():
            return
        values = np.array(self._rows)[seen]
        if limited := [name for name, column in zip(self._names, values.T, strict=True) if column.max() > _MOST]:
            names = ", ".join(limited)
            note = Message("Coefficients are at most 1, to which these keys were limited: {names}.", names=names)
            take.info["notes"] = [*take.info.get("notes", []), note]
        solved = arkit_coefficients(take, calibrate(take))
        if not np.isfinite(take.gaze[seen]).all():
            solved[:, LOOKS] = 0.0
        stated = self._table.invert(dict(zip(self._names, values.T, strict=True)), solved)
        if not self._looks(values):
            stated[:, LOOKS] = solved[:, LOOKS]
        take.coefficients[seen] = stated

    def _looks(self, values: FloatArray) -> bool:
        """Whether keys move the eyes."""
        rows = () if self._table is None else self._table.rows
        moved = [name for name, column in zip(self._names, values.T, strict=True) if np.abs(column).max() > _STILL]
        return any(row.source in _LOOKS and row.key in moved for row in rows)


def _table(names: list[list[str]]) -> KeyMap | None:
    """Mapping of the known set of the first mesh that has one, for the keys of all meshes."""
    preset = next(filter(None, map(best_preset, names)), None)
    every = dict.fromkeys(name for of in names for name in of)
    return None if preset is None else next(known for known in presets() if known.name == preset.name).matched(every)


def _values(final: bpy.types.Object) -> dict[str, float]:
    """Values of the keys of an evaluated mesh; those of muted ones are 0."""
    return {key.name: 0.0 if key.mute else float(key.value) for key in keys_of(final).key_blocks}

"""The sheet of what each control of a rig does: the rig itself is posed for its pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ...core.files.writing import replacing
from ...core.numeric.arrays import FloatArray
from ...core.rigs.sheet import Direction, control_picture, directions_of, sheet_page
from ..rigs import read_rig
from .setting import ControlValues, held
from .stored import read_controls
from .view import FaceView


class ControlSheet:
    """The sheet of the controls of a head that are used: first `steps`, then `write`.

    Afterwards every channel is what it was. Raises HeadError if the controls are not known, or a control is missing.
    """

    def __init__(self, head: bpy.types.Object) -> None:
        self._head, self._map = head, read_controls(head)
        self._directions = directions_of(self._map)
        self._pictures: list[bytes] = []

    def steps(self) -> Iterator[float]:
        """Pose the rig and draw it, direction by direction; yield the share that is done."""
        rig = replace(read_rig(self._head), parts=None)
        view = FaceView(self._head, rig)
        view.sample = np.arange(len(rig.vertices))
        rest = np.asarray(rig.vertices, dtype=np.float64)
        try:
            with held(self._map.channels) as controls:
                still = self._seen(view, controls)
                for direction in self._directions:
                    moved = self._seen(view, controls, direction) - still
                    self._pictures.append(control_picture(rig, self._map.sample, rest, rest + moved))
                    yield len(self._pictures) / len(self._directions)
        finally:
            view.close()

    def _seen(self, view: FaceView, controls: ControlValues, direction: Direction | None = None) -> FloatArray:
        values = np.zeros(len(self._map.channels))
        if direction is not None:
            values[self._map.channels.index(direction.channel)] = direction.value
        controls.write(values)
        return view.look().face

    def write(self, path: Path) -> None:
        """Write the page; raises OutputError if that fails."""
        page = sheet_page(self._head.name, self._map, self._directions, self._pictures)
        with replacing(path) as temporary:
            temporary.write_text(page, encoding="utf-8", errors="replace")

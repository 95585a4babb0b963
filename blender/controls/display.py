"""What each control of a rig does: a sheet, for whose pictures the rig itself is posed, and arrows in viewports that
show the face.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.files.writing import replacing
from ...core.numeric import linalg
from ...core.numeric.arrays import FloatArray, IntArray
from ...core.rigs.display import (
    Arrows,
    Direction,
    all_arrows,
    control_arrows,
    control_picture,
    directions_of,
    sheet_page,
)
from ..characters import read_bones
from ..frames import to_blender
from ..heads.placing import project
from ..meshes import mesh_of, posed_bones, rest_bones
from ..rigs import read_rig
from ..switching import without_bake
from .setting import ControlValues, held
from .stored import map_in, read_controls, rig_group
from .view import PosedFace


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
        view = PosedFace(self._head, rig)
        view.sample = np.arange(len(rig.vertices))
        rest = np.asarray(rig.vertices, dtype=np.float64)
        try:
            with without_bake(self._head), held(self._map.channels) as controls:
                still = self._seen(view, controls)
                for direction in self._directions:
                    moved = self._seen(view, controls, direction) - still
                    self._pictures.append(control_picture(rig, self._map.sample, rest, rest + moved))
                    yield len(self._pictures) / len(self._directions)
        finally:
            view.close()

    def _seen(self, view: PosedFace, controls: ControlValues, direction: Direction | None = None) -> FloatArray:
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


@dataclass(frozen=True)
class DrawnArrows:
    """Starts and ends of arrows in pixels of a region, (A, 2, 2), and their axes, (A,)."""

    ends: FloatArray
    axes: IntArray


def drawn_arrows(
    head: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    view: NDArray[np.float64],
    size: tuple[int, int],
    *,
    every: bool,
) -> DrawnArrows | None:
    """Project the arrows that face the viewer, as the head is displayed: of the selected control, or one of every one.

    `view` and `size` are as for `landmark_places`. Returns None without arrows, or if a modifier removes vertices.
    """
    group = rig_group(head)
    selected = group.controls[group.active].name if 0 <= group.active < len(group.controls) else ""
    arrows = _arrows(group.data, "" if every else selected) if every or selected else None
    evaluated = head.evaluated_get(depsgraph)
    vertices = mesh_of(evaluated).vertices
    if arrows is None or len(vertices) < len(mesh_of(head).vertices) or not len(arrows.vertices):
        return None
    seen = [vertices[i] for i in arrows.vertices.tolist()]
    world = np.array(evaluated.matrix_world)
    axes = world[:3, :3] @ _turn_of_head(head, depsgraph)
    starts = np.array([vertex.co for vertex in seen]) @ world[:3, :3].T + world[:3, 3]
    ends = starts + to_blender(arrows.vectors) @ axes.T
    normals = np.array([vertex.normal for vertex in seen]) @ np.asarray(linalg.inv(world[:3, :3]))
    first, last = (project(places, normals, view, size) for places in (starts, ends))
    shown = first.facing
    return DrawnArrows(np.stack([first.pixels, last.pixels], axis=1)[shown], arrows.axes[shown])


def _turn_of_head(head: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of a head's mesh by the bone of the head, in the axes of the mesh."""
    armature, bones = read_bones(head)
    if armature is None or not bones.head:
        return np.eye(3)
    rest, posed = rest_bones(armature)[bones.head], posed_bones(armature.evaluated_get(depsgraph))[bones.head]
    to_mesh = (head.matrix_world.inverted_safe() @ armature.matrix_world).to_3x3().normalized()
    turn = posed.matrix.to_3x3() @ rest.matrix_local.to_3x3().inverted_safe()
    return np.array(to_mesh @ turn @ to_mesh.inverted_safe())


@lru_cache(maxsize=8)
def _arrows(data: str, chosen: str) -> Arrows | None:
    """Arrows of a control, or of all, of what was learnt, which is stored as `data`."""
    found = map_in(data)
    if found is None:
        return None
    return control_arrows(found, chosen) if chosen else all_arrows(found)

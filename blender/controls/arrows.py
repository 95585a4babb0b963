"""Arrows of the controls of a rig, where a viewport shows the face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.numeric import linalg
from ...core.numeric.arrays import FloatArray, IntArray
from ...core.rigs.arrows import Arrows, all_arrows, control_arrows
from ..characters import read_bones
from ..frames import to_blender
from ..heads.placing import project
from ..meshes import mesh_of, posed_bones, rest_bones
from .stored import rig_group, stored_map


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
    arrows = _arrows(head.name, group.data, "" if every else selected) if every or selected else None
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
def _arrows(name: str, data: str, chosen: str) -> Arrows | None:
    """Arrows of a control, or of all, of what was learnt of the head `name`, which is stored as `data`."""
    found = stored_map(bpy.data.objects[name])
    if found is None:
        return None
    return control_arrows(found, chosen) if chosen else all_arrows(found)

"""The binding of a character as it was, so that one that was just found can be taken back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..characters import read_kinds, write_kinds
from ..meshes import mesh_of, read_weights, write_regions
from ..names import MARKS_PROPERTY, REGION_GROUPS
from .binding import turn_mesh

_OURS = "facemime_"


@dataclass(frozen=True, eq=False)
class _Bound:
    """What was stored with an object, and where it was."""

    name: str
    matrix: Matrix
    own: dict[str, Any]
    of_mesh: dict[str, Any]
    kinds: NDArray[np.int8]
    weights: NDArray[np.float32] | None


class FormerBinding:
    """The landmarks, regions and parts of all meshes of a scene, and what was selected."""

    def __init__(self, context: bpy.types.Context) -> None:
        context.view_layer.update()
        self._meshes = [
            _bound(obj) for obj in context.scene.objects if obj.type == "MESH" and mesh_of(obj).library is None
        ]
        self._selected = [obj.name for obj in context.selected_objects]
        self._active = "" if context.active_object is None else context.active_object.name

    def restore(self, context: bpy.types.Context) -> None:
        """Restore the binding and the selection; marks that the user made since are kept."""
        for former in self._meshes:
            obj = context.scene.objects.get(former.name)
            if obj is not None and obj.type == "MESH" and len(mesh_of(obj).vertices) == len(former.kinds):
                _restore(obj, former)
        for obj in context.view_layer.objects:
            obj.select_set(obj.name in self._selected)
        context.view_layer.objects.active = context.view_layer.objects.get(self._active)


def _bound(obj: bpy.types.Object) -> _Bound:
    regions = all(name in obj.vertex_groups for name in REGION_GROUPS)
    weights = read_weights(obj, slice(None)) if regions else None
    return _Bound(obj.name, obj.matrix_world.copy(), _ours(obj), _ours(mesh_of(obj)), read_kinds(mesh_of(obj)), weights)


def _ours(owner: bpy.types.ID) -> dict[str, Any]:
    found = {}
    for key, value in owner.items():
        if key.startswith(_OURS) and key != MARKS_PROPERTY:
            plain = value.to_dict() if hasattr(value, "to_dict") else value
            found[key] = plain.to_list() if hasattr(plain, "to_list") else plain
    return found


def _restore(obj: bpy.types.Object, former: _Bound) -> None:
    for owner, stored in ((obj, former.own), (mesh_of(obj), former.of_mesh)):
        for key in _ours(owner):
            del owner[key]
        for key, value in stored.items():
            owner[key] = value
    write_kinds(mesh_of(obj), former.kinds)
    turn = np.array((former.matrix.inverted_safe() @ obj.matrix_world).to_quaternion().to_matrix())
    if not np.allclose(turn, np.eye(3), atol=1e-5):
        turn_mesh(obj, turn)
    if former.weights is not None:
        write_regions(obj, former.weights)
        return
    for name in REGION_GROUPS:
        if (group := obj.vertex_groups.get(name)) is not None:
            obj.vertex_groups.remove(group)

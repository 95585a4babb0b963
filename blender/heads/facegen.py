"""Import of FaceGen heads: a mesh in the vertex order of the file, with morphs as shape keys."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import SourceError
from ...core.heads.facegen import FaceGenMesh, read_egm, read_obj, read_tri
from ..frames import to_blender
from ..names import UV_MAP
from ..placement import select_alone

MILLIMETRE = 0.001
_READERS = {".tri": read_tri, ".obj": read_obj}


def import_facegen(context: bpy.types.Context, path: Path, scale: float = MILLIMETRE) -> bpy.types.Object:
    """Import a head as the active object.

    Parameters
    ----------
    path : Path
        A `.tri` or `.obj` file; the modes of an `.egm` file next to it are imported as well.
    scale : float
        Metres per unit of the file.

    Raises
    ------
    SourceError
        If a file is damaged or not a FaceGen head.
    """
    if path.suffix.lower() not in _READERS:
        raise SourceError("{path} is not a FaceGen head. Choose a .tri or .obj file.", path=path)
    head = _READERS[path.suffix.lower()](path)
    modes = next((read_egm(file, head) for file in _beside(path)), ())
    mesh = _mesh(path.stem, head, scale)
    obj = bpy.data.objects.new(path.stem, mesh)
    context.collection.objects.link(obj)
    _add_keys(obj, head.vertices, (*head.morphs, *modes), scale)
    select_alone(context, obj)
    return obj


def _beside(path: Path) -> list[Path]:
    return [file for file in (path.with_suffix(".egm"), path.with_suffix(".EGM")) if file.is_file()]


def _mesh(name: str, head: FaceGenMesh, scale: float) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    faces = [[int(vertex) for vertex in face if vertex >= 0] for face in head.faces]
    mesh.from_pydata((to_blender(head.vertices) * scale).tolist(), [], faces)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
    if head.uv is not None:
        layer = mesh.uv_layers.new(name=UV_MAP)
        layer.data.foreach_set("uv", np.ascontiguousarray(head.uv[head.faces >= 0]).reshape(-1))
    mesh.update()
    return mesh


def _add_keys(
    obj: bpy.types.Object,
    rest: NDArray[np.float32],
    morphs: tuple[tuple[str, NDArray[np.float32]], ...],
    scale: float,
) -> None:
    if not morphs:
        return
    obj.shape_key_add(name="Basis", from_mix=False)
    for name, offsets in morphs:
        key = obj.shape_key_add(name=name, from_mix=False)
        key.points.foreach_set("co", (to_blender(rest + offsets) * scale).astype(np.float32).reshape(-1))
        key.value = 0.0

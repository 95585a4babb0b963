"""Wavefront OBJ, as far as the sources of heads use it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ObjMesh:
    """A mesh of triangles and quads.

    Attributes
    ----------
    vertices : (N, 3) float64
    faces : (F, 4) int, -1 pads triangles
    uv : (T, 2) float64 texture coordinates, v up
    face_uv : (F, 4) int, rows of `uv`
    groups, materials : (F,) names
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64]
    face_uv: NDArray[np.int64]
    groups: NDArray[np.str_]
    materials: NDArray[np.str_]


def parse_obj(text: str) -> ObjMesh:
    """Read the mesh in the content of a file."""
    vertices, uv, faces, face_uv, groups, materials = [], [], [], [], [], []
    group = material = ""
    for line in text.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append([float(word) for word in rest.split()[:3]])
        elif kind == "vt":
            uv.append([float(word) for word in rest.split()[:2]])
        elif kind == "g":
            group = rest.strip()
        elif kind == "usemtl":
            material = rest.strip()
        elif kind == "f":
            corners = [word.split("/") for word in rest.split()]
            pad = [-1] * (4 - len(corners))
            faces.append([int(corner[0]) - 1 for corner in corners] + pad)
            face_uv.append([int(corner[1]) - 1 for corner in corners] + pad)
            groups.append(group)
            materials.append(material)
    arrays = (np.array(content) for content in (vertices, faces, uv, face_uv, groups, materials))
    return ObjMesh(*arrays)

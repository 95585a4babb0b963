"""The head, put together: from the pinned source to the arrays of `core.head`, and to bytes that never differ."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facemime.core.head import FORMAT

from .anatomy import landmark_vertices
from .identity import AVATAR, identity_offsets
from .layout import layout
from .parts import build_parts, jaw_hinge
from .regions import region_weights
from .source import Source
from .surface import build_surface

TO_HEAD = np.array([0.1, -0.1, -0.1])
"""MakeHuman's decimetres (y up, z to the viewer) to the head frame's metres."""

_TRAGUS_TO_CENTRE = np.array([0.0, 0.0, 0.016])

Arrays = dict[str, NDArray[Any]]


def build_head(source: Source) -> Arrays:
    """The arrays of `assets/head/head.npz`."""
    base = source.base_mesh()
    points = (base.vertices + identity_offsets(source, AVATAR)) * TO_HEAD
    surface = build_surface(base, points)
    ears = surface.positions(points)[surface.vertex_of(landmark_vertices(base.mirror)[[0, 16]])]
    points = points - ears.mean(axis=0) - _TRAGUS_TO_CENTRE
    vertices = _symmetric(surface.positions(points), surface.mirror)
    landmarks = surface.vertex_of(landmark_vertices(base.mirror))
    names = source.unit_names()
    units = [source.unit(name) * TO_HEAD for name in names]
    hinge = jaw_hinge(base, points, units[names.index("jawOpen")])
    arrays: Arrays = {
        "format": np.array(FORMAT),
        "vertices": vertices.astype(np.float32),
        "faces": surface.faces.astype(np.int16),
        "uv": layout(surface, vertices).astype(np.float32),
        "landmarks": landmarks.astype(np.int16),
        "regions": region_weights(surface, vertices, landmarks).astype(np.float32),
        "unit_names": np.array(names),
        "units": np.stack([surface.positions(unit) for unit in units]).astype(np.float16),
        "jaw_pivot": hinge.astype(np.float32),
    }
    for part in build_parts(base, points, units, hinge):
        arrays[f"{part.name}.vertices"] = part.vertices.astype(np.float32)
        arrays[f"{part.name}.faces"] = part.faces.astype(np.int16)
        arrays[f"{part.name}.uv"] = part.uv.astype(np.float32)
        arrays[f"{part.name}.pivot"] = part.pivot.astype(np.float32)
        arrays[f"{part.name}.units"] = part.units.astype(np.float16)
    return arrays


def to_bytes(arrays: Arrays) -> bytes:
    """A compressed npz whose bytes depend on the arrays alone: no time, no platform."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            member.create_system = 3
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(member, content.getvalue())
    return buffer.getvalue()


def _symmetric(vertices: NDArray[np.float64], mirror: NDArray[np.int64]) -> NDArray[np.float64]:
    """Even out what rounding in the source leaves of asymmetry."""
    return np.asarray((vertices + vertices[mirror] * [-1.0, 1.0, 1.0]) / 2.0)

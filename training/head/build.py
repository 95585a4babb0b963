"""The head, put together: from the pinned source to the arrays of `core.head`, and to bytes that never differ."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facemime.core.head import FORMAT
from facemime.core.landmarks import from_ibug

from .anatomy import landmark_vertices
from .hair import crop_lift
from .identity import AVATAR, identity_offsets
from .layout import layout
from .occlusion import openness, vertex_normals
from .organs import encode, paint_eye, paint_teeth, paint_tongue
from .parts import IRIS_RADIUS, TEETH, build_parts, eye_uv_radius, jaw_hinge
from .regions import region_weights
from .skin import paint_skin
from .source import Source
from .surface import Surface, build_surface, ear_share

TO_HEAD = np.array([0.1, -0.1, -0.1])
"""MakeHuman's decimetres (y up, z to the viewer) to the head frame's metres."""

_TRAGUS_TO_CENTRE = np.array([0.0, 0.0, 0.016])

_OVERLAP = 1.06
"""A blink closes this much of the gap, since the rims are round."""

Arrays = dict[str, NDArray[Any]]


def build_files(source: Source) -> dict[str, bytes]:
    """The files of `assets/head` but for the licence, by name."""
    arrays, pictures = build_head(source)
    files = {"head.npz": to_bytes(arrays)}
    files |= {f"{name}.jpg": encode(picture, 90) for name, picture in pictures.items()}
    return files


def build_head(source: Source) -> tuple[Arrays, dict[str, NDArray[np.uint8]]]:
    """The arrays of `head.npz`, and the pictures by name."""
    base = source.base_mesh()
    points = (base.vertices + identity_offsets(source, AVATAR)) * TO_HEAD
    surface = build_surface(base, points)
    ears = surface.positions(points)[surface.vertex_of(landmark_vertices(base.mirror)[[0, 16]])]
    points = points - ears.mean(axis=0) - _TRAGUS_TO_CENTRE
    vertices = _symmetric(surface.positions(points), surface.mirror)
    landmarks = surface.vertex_of(landmark_vertices(base.mirror))
    native = landmark_vertices(base.mirror)
    names = source.unit_names()
    units = [_closing(name, source.unit(name) * TO_HEAD, points, native) for name in names]
    hinge = jaw_hinge(base, points, units[names.index("jawOpen")])
    shape = vertices.copy()
    ear = ear_share(surface)
    normals = vertex_normals(vertices, surface.faces)
    vertices = vertices + crop_lift(vertices, ear)[:, None] * normals
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
    pictures = {
        "skin": _skin(surface, shape, arrays["uv"].astype(np.float64), ear, points, landmarks),
        "eye": paint_eye(_iris_share(arrays["eye_left.vertices"] - arrays["eye_left.pivot"])),
        "teeth": paint_teeth(TEETH),
        "tongue": paint_tongue(),
    }
    return arrays, pictures


def _closing(
    name: str, unit: NDArray[np.float64], points: NDArray[np.float64], landmarks: NDArray[np.int64]
) -> NDArray[np.float64]:
    """A blink scaled so that the lids of these eyes just meet; the target was made for wider ones."""
    if not name.startswith("eyeBlink"):
        return unit
    left = name.endswith("Left")
    upper = landmarks[from_ibug([43, 44] if left else [38, 37])]
    lower = landmarks[from_ibug([47, 46] if left else [40, 41])]
    gap = (points[lower] - points[upper])[:, 1].mean()
    closing = (unit[upper] - unit[lower])[:, 1].mean()
    return np.asarray(unit * (_OVERLAP * gap / closing))


def _skin(
    surface: Surface,
    vertices: NDArray[np.float64],
    uv: NDArray[np.float64],
    ear: NDArray[np.float64],
    points: NDArray[np.float64],
    landmarks: NDArray[np.int64],
) -> NDArray[np.uint8]:
    left = np.flatnonzero(vertices[:, 0] >= 0.0)
    seen = np.zeros(len(vertices))
    seen[left] = openness(vertices, surface.faces, left)
    seen[surface.mirror[left]] = seen[left]
    chart = surface.token_chart[surface.tokens[:, 0]]
    values = np.stack([seen, ear], axis=1)
    return paint_skin(vertices, surface.faces, uv, chart, values, points, vertices[landmarks])


def _iris_share(eye: NDArray[np.floating]) -> float:
    """Radius of the iris as a share of the eye's picture."""
    radius = float(np.median(np.linalg.norm(eye, axis=1)))
    return float(eye_uv_radius(np.arcsin(np.array([IRIS_RADIUS / radius])))[0])


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

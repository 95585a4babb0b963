"""The built-in head: 1,781 vertices with landmarks, regions and the 52 ARKit face units, and its parts.

`assets/head/head.npz` holds it; `training/head` builds it from CC0 data. Its arrays are those of `Head` and `HeadPart`
below, under the fields' names, offsets as float16 and a part's prefixed with its name and a dot.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..archives import MAX_BYTES, Archive, read_archive
from ..assets import ASSETS
from ..errors import ModelError
from ..landmarks import N_LANDMARKS
from ..reading import read_bytes
from .regions import REGIONS

REGION_NAMES = tuple(region.name for region in REGIONS)
PART_NAMES = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue")
FORMAT = "facemime-head-1"
_ROUNDING = 1e-5

HEAD_FILE = ASSETS / "head" / "head.npz"


@dataclass(frozen=True)
class HeadPart:
    """An eyeball, a row of teeth or the tongue, in the head frame, metres.

    Attributes
    ----------
    name : str
        One of `PART_NAMES`; left and right are the performer's own.
    vertices : (n, 3) float32
    faces : (f, 4) int32
        Vertices of each face, triangles padded with -1.
    uv : (f, 4, 2) float32
        Texture coordinates of the faces' corners, v up.
    pivot : (3,) float32
        What the part turns about: the eyeball's centre, the jaw's hinge.
    units : (U, n, 3) float32
        Offsets of the vertices under each face unit, zero for most.
    """

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]
    pivot: NDArray[np.float32]
    units: NDArray[np.float32]


@dataclass(frozen=True)
class Head:
    """A head at rest, in the head frame, metres; the origin lies between the ears.

    Attributes
    ----------
    vertices : (V, 3) float32
    faces : (F, 4) int32
        Vertices of each face, triangles padded with -1.
    uv : (F, 4, 2) float32
        Texture coordinates of the faces' corners, v up.
    landmarks : (66,) intp
        Vertex of each landmark.
    regions : (3, V) float32
        Share in 0..1 of the regions `REGION_NAMES` in each vertex; their sum is at most 1 and 0 where nothing moves.
    unit_names : tuple of str
        The 52 ARKit face units, alphabetically.
    units : (U, V, 3) float32
        Offsets of the vertices under each face unit.
    parts : tuple of HeadPart
        In the order of `PART_NAMES`.
    jaw_pivot : (3,) float32
        A point on the axis, along x, about which the jaw opens.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]
    landmarks: NDArray[np.intp]
    regions: NDArray[np.float32]
    unit_names: tuple[str, ...]
    units: NDArray[np.float32]
    parts: tuple[HeadPart, ...]
    jaw_pivot: NDArray[np.float32]


def load_head(path: Path | None = None) -> Head:
    """Read a head from `path`, by default the built-in one.

    Raises
    ------
    ModelError
        The file is missing, damaged, or no head of this version.
    """
    path = HEAD_FILE if path is None else Path(path)
    try:
        archive = read_archive(read_bytes(path, MAX_BYTES))
    except FileNotFoundError as error:
        raise ModelError(f"The head {path} is missing. Install Facemime again, or run make head.") from error
    except OSError as error:
        raise ModelError(f"The head {path} cannot be read: {error.strerror}. Install Facemime again.") from error
    except ValueError as error:
        raise ModelError(f"The head {path} is damaged ({error}). Install Facemime again.") from error
    if archive.text("format") != FORMAT:
        raise ModelError(f"{path} is no Facemime head of this version. Give a file that training/head built.")
    try:
        head = _head(archive)
    except ValueError as error:
        raise ModelError(f"The head {path} is incomplete or inconsistent: {error}. Install Facemime again.") from error
    return head


def _head(archive: Archive) -> Head:
    vertices = archive.reals("vertices", (None, 3), np.float32)
    count = len(vertices)
    names = archive.texts("unit_names")
    landmarks = archive.wholes("landmarks", (N_LANDMARKS,), 0, count - 1)
    if len(np.unique(vertices[landmarks], axis=0)) != N_LANDMARKS:
        raise ValueError("two landmarks share a place")
    regions = archive.reals("regions", (len(REGION_NAMES), count), np.float32)
    if regions.min() < 0.0 or regions.sum(axis=0).max() > 1.0 + _ROUNDING:
        raise ValueError("regions has shares outside 0 to 1")
    faces, uv = _faces(archive, "", count)
    return Head(
        vertices=vertices,
        faces=faces,
        uv=uv,
        landmarks=landmarks,
        regions=regions,
        unit_names=names,
        units=archive.reals("units", (len(names), count, 3), np.float32),
        parts=tuple(_part(name, len(names), archive) for name in PART_NAMES),
        jaw_pivot=archive.reals("jaw_pivot", (3,), np.float32),
    )


def _part(name: str, unit_count: int, archive: Archive) -> HeadPart:
    vertices = archive.reals(f"{name}.vertices", (None, 3), np.float32)
    faces, uv = _faces(archive, f"{name}.", len(vertices))
    return HeadPart(
        name=name,
        vertices=vertices,
        faces=faces,
        uv=uv,
        pivot=archive.reals(f"{name}.pivot", (3,), np.float32),
        units=archive.reals(f"{name}.units", (unit_count, len(vertices), 3), np.float32),
    )


def _faces(archive: Archive, prefix: str, count: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Faces, none of which has a vertex twice, and the texture coordinates of their corners."""
    faces = archive.wholes(f"{prefix}faces", (None, 4), -1, count - 1)
    ordered = np.sort(faces, axis=1)
    if (faces[:, :3] < 0).any() or (ordered[:, 1:] == ordered[:, :-1]).any():
        raise ValueError(f"{prefix}faces has a degenerate face")
    return faces.astype(np.int32), archive.reals(f"{prefix}uv", (len(faces), 4, 2), np.float32)

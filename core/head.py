"""The built-in head: 1,781 vertices with landmarks, regions and the 52 ARKit face units, and its parts.

`assets/head/head.npz` holds it; `training/head` builds it from CC0 data. Its arrays are those of `Head` and `HeadPart`
below, under the fields' names, offsets as float16 and a part's prefixed with its name and a dot.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .deform.regions import REGIONS
from .errors import ModelError
from .landmarks import N_LANDMARKS

REGION_NAMES = tuple(region.name for region in REGIONS)
PART_NAMES = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue")
FORMAT = "facemime-head-1"

HEAD_FILE = Path(__file__).parents[1] / "assets" / "head" / "head.npz"


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
        with np.load(path, allow_pickle=False) as file:
            data = {key: file[key] for key in file.files}
    except FileNotFoundError as error:
        raise ModelError(f"The head {path} is missing. Install Facemime again, or run make head.") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise ModelError(f"The head {path} is damaged ({error}). Install Facemime again.") from error
    if str(data.get("format", "")) != FORMAT:
        raise ModelError(f"{path} is no Facemime head of this version. Give a file that training/head built.")
    try:
        head = _head(data)
    except (KeyError, ValueError, TypeError) as error:
        raise ModelError(f"The head {path} is incomplete ({error}). Install Facemime again.") from error
    if problem := _inconsistency(head):
        raise ModelError(f"The head {path} is inconsistent: {problem}. Install Facemime again.")
    return head


def _head(data: dict[str, NDArray[Any]]) -> Head:
    names = tuple(str(name) for name in data["unit_names"])
    return Head(
        vertices=data["vertices"].astype(np.float32),
        faces=data["faces"].astype(np.int32),
        uv=data["uv"].astype(np.float32),
        landmarks=data["landmarks"].astype(np.intp),
        regions=data["regions"].astype(np.float32),
        unit_names=names,
        units=data["units"].astype(np.float32),
        parts=tuple(_part(name, data) for name in PART_NAMES),
        jaw_pivot=data["jaw_pivot"].astype(np.float32),
    )


def _part(name: str, data: dict[str, NDArray[Any]]) -> HeadPart:
    return HeadPart(
        name=name,
        vertices=data[f"{name}.vertices"].astype(np.float32),
        faces=data[f"{name}.faces"].astype(np.int32),
        uv=data[f"{name}.uv"].astype(np.float32),
        pivot=data[f"{name}.pivot"].astype(np.float32),
        units=data[f"{name}.units"].astype(np.float32),
    )


def _inconsistency(head: Head) -> str | None:
    """What does not fit together, or None."""
    count, unit_count = len(head.vertices), len(head.unit_names)
    shapes = {
        "regions": (head.regions.shape, (len(REGION_NAMES), count)),
        "units": (head.units.shape, (unit_count, count, 3)),
        "landmarks": (head.landmarks.shape, (N_LANDMARKS,)),
        "uv": (head.uv.shape, (*head.faces.shape, 2)),
    }
    for part in head.parts:
        shapes[f"{part.name}.units"] = (part.units.shape, (unit_count, len(part.vertices), 3))
        shapes[f"{part.name}.uv"] = (part.uv.shape, (*part.faces.shape, 2))
    for name, (found, expected) in shapes.items():
        if found != expected:
            return f"{name} has the shape {found}, not {expected}"
    for name, indices, limit in [
        ("landmarks", head.landmarks, count),
        ("faces", head.faces, count),
        *((f"{part.name}.faces", part.faces, len(part.vertices)) for part in head.parts),
    ]:
        if indices.size and (indices.max() >= limit or indices.min() < -1):
            return f"{name} name vertices that are not there"
    return None

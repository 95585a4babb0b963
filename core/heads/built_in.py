"""The built-in heads: 1,781 vertices with landmarks, regions, the 52 ARKit face units, and their parts; the direction
of the eyes in ARKit's coefficients, as on these heads.

They are stored in `assets/head`, built by `lab/training/head` from CC0 data, and share their faces and landmarks.
The arrays in a file are the fields of `Head` and `HeadPart`, with displacements as float16; those of a part are
prefixed with its name and a dot. "The built-in head" without further qualification is the man's, the reference for
everything that needs a known head.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from math import atan2, cos, tan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, ModelError
from ..face.landmarks import MOUTH_CORNERS, N_LANDMARKS
from ..face.names import COEFFICIENT_INDEX
from ..files.archives import MAX_BYTES, Archive, read_archive
from ..files.assets import ASSETS
from ..files.reading import read_bytes
from ..numeric.arrays import FloatArray
from .regions import REGIONS

_DIRECTIONS = ("In", "Out", "Up", "Down")


REGION_NAMES = tuple(region.name for region in REGIONS)
PART_NAMES = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue", "lashes", "hair")
FORMAT = "facemime-head-2"
MOUTH_COLOUR = (0.035, 0.012, 0.01)
"""Linear RGB of the inside of a mouth; dark also in viewports that show materials without their images."""
MOUTH_ROUGHNESS = 1.0
_MOUTH_UV = np.array([[0.359, 0.004], [0.641, 0.069]])
"""Lower left and upper right of the inside of the mouth in the texture of the skin."""
_DEEP = 0.006
"""Distance in metres behind the corners of the mouth from which its inside is dark."""
_ROUNDING = 1e-5

HEAD_FILE = ASSETS / "head" / "head.npz"
WOMAN_FILE = ASSETS / "head" / "woman.npz"


@dataclass(frozen=True)
class HeadPart:
    """An eyeball, a row of teeth, the tongue, lashes and brows, or hair, in the head frame and metres.

    Attributes
    ----------
    name : str
        One of `PART_NAMES`; left and right are the performer's own.
    vertices, faces, uv : (n, 3) float32, (f, 4) int32, (f, 4, 2) float32
        As in `Head`.
    pivot : (3,) float32
        Centre of rotation: the centre of the eyeball, or a point on the hinge of the jaw; zero for lashes and hair.
    units : (U, n, 3) float32
        Displacements of the vertices under each face unit, zero for most units, and for hair, which stays still.
    """

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]
    pivot: NDArray[np.float32]
    units: NDArray[np.float32]


@dataclass(frozen=True)
class Head:
    """A head at rest, in the head frame and metres; the origin is between the ears.

    Attributes
    ----------
    vertices : (V, 3) float32
        Rest positions.
    faces : (F, 4) int32
        Vertices of each face, triangles padded with -1.
    uv : (F, 4, 2) float32
        Texture coordinates of the corners of each face, v up.
    landmarks : (66,) intp
        Vertex of each landmark.
    regions : (3, V) float32
        Weights of the regions `REGION_NAMES`, 0 to 1; they sum to at most 1, and to 0 where nothing moves.
    unit_names : tuple of str
        Names of the 52 ARKit face units, alphabetically.
    units : (U, V, 3) float32
        Displacements of the vertices under each face unit.
    parts : tuple of HeadPart
        In the order of `PART_NAMES`.
    jaw_pivot : (3,) float32
        A point on the hinge of the jaw, whose axis is parallel to x.
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

    @property
    def deep_in_mouth(self) -> NDArray[np.bool_]:
        """Whether each face of the skin lies inside the mouth, behind its corners, where it is dark, (F,)."""
        corner = self.faces >= 0
        inside = ((self.uv > _MOUTH_UV[0]) & (self.uv < _MOUTH_UV[1])).all(axis=2) | ~corner
        depth = np.where(corner, self.vertices[self.faces, 2], 0.0).sum(axis=1) / corner.sum(axis=1)
        return np.asarray(inside.all(axis=1) & (depth > self.vertices[self.landmarks[MOUTH_CORNERS], 2].max() + _DEEP))

    def part(self, name: str) -> HeadPart:
        """Return the part of that name, one of `PART_NAMES`."""
        return self.parts[PART_NAMES.index(name)]


def load_head(path: Path | None = None) -> Head:
    """Load the head at `path`, by default the built-in one, with read-only arrays. Shipped heads are read once.

    Raises ModelError if the file is missing, damaged, or of a different version.
    """
    path = HEAD_FILE if path is None else Path(path)
    return _shipped(path) if path in (HEAD_FILE, WOMAN_FILE) else _read(path)


def landmarks_at_rest() -> FloatArray:
    """Landmarks of the built-in head, (66, 3) float64, in its unit."""
    head = load_head()
    return head.vertices[head.landmarks].astype(np.float64)


def _read(path: Path) -> Head:
    try:
        archive = read_archive(read_bytes(path, MAX_BYTES))
    except FileNotFoundError as error:
        raise ModelError("The head {path} is missing. Reinstall Facemime, or run make head.", path=path) from error
    except OSError as error:
        raise ModelError(
            "The head {path} cannot be read: {reason}. Reinstall Facemime.", path=path, reason=error.strerror
        ) from error
    except ValueError as error:
        raise ModelError("The head {path} is damaged ({error}). Reinstall Facemime.", path=path, error=error) from error
    if archive.text("format") != FORMAT:
        raise ModelError(
            "{path} is not a Facemime head of this version. Use a file built by lab/training/head.", path=path
        )
    try:
        head = _head(archive)
    except ValueError as error:
        raise ModelError(
            "The head {path} is incomplete or inconsistent: {error}. Reinstall Facemime.", path=path, error=error
        ) from error
    owners: tuple[Head | HeadPart, ...] = (head, *head.parts)
    for owner in owners:
        for field in fields(owner):
            if isinstance(value := getattr(owner, field.name), np.ndarray):
                value.flags.writeable = False
    return head


_shipped = lru_cache(maxsize=2)(_read)


def _head(archive: Archive) -> Head:
    vertices = archive.floats("vertices", (None, 3), np.float32)
    count = len(vertices)
    names = archive.texts("unit_names")
    landmarks = archive.integers("landmarks", (N_LANDMARKS,), 0, count - 1)
    if len(np.unique(vertices[landmarks], axis=0)) != N_LANDMARKS:
        raise DataError("two landmarks coincide")
    regions = archive.floats("regions", (len(REGION_NAMES), count), np.float32)
    if regions.min() < 0.0 or regions.sum(axis=0).max() > 1.0 + _ROUNDING:
        raise DataError("regions has weights outside 0 to 1")
    faces, uv = _faces(archive, "", count)
    return Head(
        vertices=vertices,
        faces=faces,
        uv=uv,
        landmarks=landmarks,
        regions=regions,
        unit_names=names,
        units=archive.floats("units", (len(names), count, 3), np.float32),
        parts=tuple(_part(name, len(names), archive) for name in PART_NAMES),
        jaw_pivot=archive.floats("jaw_pivot", (3,), np.float32),
    )


def _part(name: str, unit_count: int, archive: Archive) -> HeadPart:
    vertices = archive.floats(f"{name}.vertices", (None, 3), np.float32)
    faces, uv = _faces(archive, f"{name}.", len(vertices))
    shape = (unit_count, len(vertices), 3)
    still = name == "hair"
    return HeadPart(
        name=name,
        vertices=vertices,
        faces=faces,
        uv=uv,
        pivot=archive.floats(f"{name}.pivot", (3,), np.float32),
        units=np.broadcast_to(np.float32(0.0), shape) if still else archive.floats(f"{name}.units", shape, np.float32),
    )


def _faces(archive: Archive, prefix: str, count: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Read faces, none of which may be degenerate, and the texture coordinates of their corners."""
    faces = archive.integers(f"{prefix}faces", (None, 4), -1, count - 1)
    ordered = np.sort(faces, axis=1)
    if (faces[:, :3] < 0).any() or (ordered[:, 1:] == ordered[:, :-1]).any():
        raise DataError("{prefix}faces has a degenerate face", prefix=prefix)
    return faces.astype(np.int32), archive.floats(f"{prefix}uv", (len(faces), 4, 2), np.float32)


LOOKS: NDArray[np.intp] = np.array(
    [COEFFICIENT_INDEX[f"eyeLook{direction}{side}"] for side in ("Left", "Right") for direction in _DIRECTIONS]
)
"""(8,) columns of the coefficients for the direction of the eyes."""
EYE_REACH = np.radians((35.2, 33.0))
"""Pitch and yaw of an eye in radians at which an iPhone states a coefficient of 1, from 560 of its packets."""
LOOK_ANGLES = tuple(
    (side, axis, sign * float(EYE_REACH[1 - axis]))
    for side, outwards in ((1, 1.0), (0, -1.0))
    for axis, sign in ((0, -outwards), (0, outwards), (1, -1.0), (1, 1.0))
)
"""For each of `LOOKS` the eye (0 right, 1 left), the axis along which it looks, and the signed angle at 1."""


def looks_of(rotations: FloatArray) -> FloatArray:
    """Compute the coefficients (N, 8) of `LOOKS`, 0 to 1, for rotations (N, 2, 3, 3) of the right and the left eyeball.

    They are shares of `EYE_REACH`.
    """
    forward = -rotations[..., 2]
    turned = np.stack([np.arctan2(forward[..., axis], -forward[..., 2]) for axis in (0, 1)])
    columns = [np.clip(turned[axis][:, side] / reach, 0.0, 1.0) for side, axis, reach in LOOK_ANGLES]
    return np.column_stack(columns)


def gaze_of(looks: FloatArray) -> tuple[FloatArray, float]:
    """Compute gaze (2,) and vergence in radians, as in `TrackResult`, from coefficients (8,) in the order of `LOOKS`.

    The pitch is the mean of both eyes.
    """
    angles = np.zeros((2, 2))
    for value, (side, axis, reach) in zip(looks.tolist(), LOOK_ANGLES, strict=True):
        angles[side, axis] += value * reach
    return gaze_of_eyes(np.array([[atan2(tan(down) * cos(across), 1.0), -across] for across, down in angles.tolist()]))


def gaze_of_eyes(eyes: FloatArray) -> tuple[FloatArray, float]:
    """Return gaze and vergence, as from `gaze_of`, of the `(pitch, yaw)` of the right and left eye, (2, 2)."""
    return eyes.mean(axis=0), float(eyes[1, 1] - eyes[0, 1])


def looks_of_eyes(eyes: FloatArray) -> FloatArray:
    """Compute the coefficients (8,) of `LOOKS`, 0 to 1, that a phone states for the directions of the eyes.

    These are `(pitch, yaw)` of the right and the left eye in radians, as for the gaze in `TrackResult`.
    """
    (right_down, right_in), (left_down, left_in) = (eyes * [[1.0, -1.0], [1.0, 1.0]] / EYE_REACH).tolist()
    ways = [left_in, -left_in, -left_down, left_down, right_in, -right_in, -right_down, right_down]
    return np.clip(ways, 0.0, 1.0)


def eyes_of_gaze(gaze: FloatArray, vergence: float) -> FloatArray:
    """Return the `(pitch, yaw)` of the right and left eye, (2, 2), that have this gaze and vergence in radians."""
    return gaze + np.array([[0.0, -0.5], [0.0, 0.5]]) * vergence

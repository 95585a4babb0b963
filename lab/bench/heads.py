"""Heads with known expressions, on which deformers are evaluated."""

from __future__ import annotations

import json
import tarfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facemime.core.base.landmarks import (
    BROWS,
    EYE_CORNERS,
    EYE_LEFT,
    EYE_RIGHT,
    IBUG68_INDICES,
    INNER,
    LIPS,
    MOUTH_OUTER,
    NOSE,
    OUTER_EYE_CORNERS,
    from_ibug,
    outer_eye_distance,
)
from facemime.core.heads.built_in import load_head
from facemime.core.heads.proposal import propose_regions
from facemime.core.heads.rig import HeadRig
from facemime.core.heads.surface import SurfaceGraph
from lab.training.expressions.__main__ import ARKIT_EXCEPTIONS
from lab.training.tracker.heads import FACE, load_ict

Points = NDArray[np.float64]
AREAS = ("all", "lips", "eyes", "brows", "cheeks", "jaw")
MIXTURES = 500

_LIPS, _EYES, _BROWS = 0.13, 0.12, 0.16
"""Extent of lips, eyes and brows around their landmarks in outer-eye distances."""
_RIMS = {
    "mouth": (from_ibug((48, 61, 62, 63, 54)), from_ibug((54, 65, 66, 67, 48))),
    "right eye": (from_ibug((36, 37, 38, 39)), from_ibug((39, 40, 41, 36))),
    "left eye": (from_ibug((42, 43, 44, 45)), from_ibug((45, 46, 47, 42))),
}

LANDMARK_PARTS = {
    "inner 49": INNER,
    "corners": EYE_CORNERS,
    "lids": np.concatenate([EYE_RIGHT, EYE_LEFT]),
    "lips": LIPS,
    "nose": NOSE,
    "brows": BROWS,
}
"""Landmarks over which the errors of binding are reported."""
_FLIP = np.array([1.0, -1.0, -1.0])
"""From y up and z to the camera to the head frame."""
_JAMES = ("chin", "leyebrow", "reyebrow", "nose", "leye", "reye", "mouth")
"""Groups of landmarks of menpo3d's scan in iBUG's order; its left is the viewer's."""


@dataclass(frozen=True)
class LabelledHead:
    """A head with its own landmarks, which need not be vertices, in the head frame.

    Attributes
    ----------
    title : str
    vertices : (V, 3)
    faces : (F, K) int, padded with -1
    points : (66, 3)
    """

    title: str
    vertices: Points
    faces: NDArray[np.int64]
    points: Points


@dataclass(frozen=True)
class TrueHead:
    """A head and the true motion of its vertices, in the head frame and outer-eye distances.

    Attributes
    ----------
    vertices : (V, 3)
    faces : (F, K) int, padded with -1
    landmarks : (66,) int
    regions : (3, V)
    names : names of the expressions
    motions : (E, V, 3) float32
    mixtures : (500, E) weights of random mixtures
    areas : name to (V,) bool
    rims : name to the closed outline of vertices round an opening
    """

    title: str
    vertices: Points
    faces: NDArray[np.int64]
    landmarks: NDArray[np.int64]
    regions: Points
    names: list[str]
    motions: NDArray[np.float32]
    mixtures: Points
    areas: dict[str, NDArray[np.bool_]]
    rims: dict[str, NDArray[np.int64]]

    @property
    def rig(self) -> HeadRig:
        """The rig of the head."""
        points = self.vertices[self.landmarks]
        pivot = points[[2, 14]].mean(axis=0)
        return HeadRig(self.vertices, self.landmarks, self.regions, pivot, faces=self.faces)

    def true(self, weights: Points) -> NDArray[np.float32]:
        """(N, V, 3) motion for weights (N, E)."""
        return np.tensordot(weights.astype(np.float32), self.motions, axes=1)


def ict_head(data: Path) -> TrueHead:
    """ICT-FaceKit's face and its 53 expressions."""
    head = load_ict(data)
    triangles = head.triangles[(head.triangles < FACE.stop).all(axis=1)]
    chosen = [i for i, name in enumerate(head.names) if not name.startswith(ARKIT_EXCEPTIONS)]
    return _head(
        "ICT-FaceKit",
        head.neutral[FACE],
        triangles,
        head.landmarks,
        [head.names[i] for i in chosen],
        head.expression[chosen][:, FACE],
    )


def ict_people(data: Path, count: int) -> list[LabelledHead]:
    """ICT-FaceKit's mean face, and `count` random people of its model, all at rest."""
    head = load_ict(data)
    triangles = head.triangles[(head.triangles < FACE.stop).all(axis=1)]
    rng = np.random.default_rng(2019)
    people = []
    for number in range(count + 1):
        weights = rng.normal(size=len(head.identity)) * (number > 0)
        vertices = head.neutral + np.tensordot(weights, head.identity, 1)
        title = f"person {number}" if number else "ICT-FaceKit"
        people.append(LabelledHead(title, vertices[FACE].astype(float), triangles, vertices[head.landmarks]))
    return people


def menpo_faces(archive: Path) -> list[LabelledHead]:
    """The two faces with 68 landmarks in the source archive of menpo3d 0.8.6: a man's scan, and a mean face."""
    with tarfile.open(archive) as members:
        names = {Path(name).name: name for name in members.getnames() if "/menpo3d/data/" in name}

        def read(name: str) -> bytes:
            file = members.extractfile(names[name])
            assert file is not None
            return file.read()

        james, template = (json.loads(read(f"{name}.ljson"))["groups"]["LJSON"] for name in ("james", "template"))
        scan, mean = _read_obj(read("james.obj").decode()), _read_ply(read("template.ply"))
    rows = {group["label"]: group["mask"] for group in james["labels"]}
    order = np.concatenate([rows[name] for name in _JAMES])
    return [
        LabelledHead(title, vertices * _FLIP, faces, (points * _FLIP)[IBUG68_INDICES])
        for title, (vertices, faces), points in (
            ("scan of a man", scan, np.array(james["landmarks"]["points"])[order]),
            ("mean face", mean, np.array(template["landmarks"]["points"])),
        )
    ]


def _read_obj(text: str) -> tuple[Points, NDArray[np.int64]]:
    """Vertices and triangles of an OBJ file."""
    rows = [line.split() for line in text.splitlines() if line[:2] in ("v ", "f ")]
    vertices = np.array([[float(value) for value in row[1:4]] for row in rows if row[0] == "v"])
    faces = [[int(corner.split("/")[0]) - 1 for corner in row[1:4]] for row in rows if row[0] == "f"]
    return vertices, np.array(faces)


def _read_ply(data: bytes) -> tuple[Points, NDArray[np.int64]]:
    """Vertices and triangles of a binary PLY file whose vertices have a colour."""
    header, _, body = data.partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in header.splitlines() if line.startswith(b"element")]
    kinds = np.dtype([("place", "<f4", 3), ("colour", "u1", 4)])
    vertices = np.frombuffer(body, kinds, counts[0])["place"]
    corners = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
    faces = np.frombuffer(body, corners, counts[1], counts[0] * kinds.itemsize)["vertices"]
    return vertices.astype(float), faces.astype(np.int64)


def landmark_errors(head: LabelledHead, found: NDArray[np.intp]) -> list[float]:
    """Distances of the vertices `found` (66,) from the head's own landmarks, in % of its outer-eye distance.

    Per group of `LANDMARK_PARTS`, first in the plane of the face, then in space.
    """
    away = 100.0 * (head.vertices[found] - head.points) / outer_eye_distance(head.points)
    return [
        float(np.linalg.norm(away[part][:, :dims], axis=1).mean())
        for part in LANDMARK_PARTS.values()
        for dims in (2, 3)
    ]


def true_built_in_head() -> TrueHead:
    """The built-in head as it ships, and those of its 52 units that move its skin."""
    head = load_head()
    chosen = [i for i, unit in enumerate(head.units) if np.abs(unit).max() > 1e-5]
    return _head(
        "built-in head",
        head.vertices,
        head.faces,
        head.landmarks,
        [head.unit_names[i] for i in chosen],
        head.units[chosen],
        head.regions,
    )


def _head(
    title: str,
    vertices: Points,
    faces: Points,
    landmarks: Points,
    names: list[str],
    motions: Points,
    regions: Points | None = None,
) -> TrueHead:
    corners = vertices[landmarks[OUTER_EYE_CORNERS]].astype(np.float64)
    unit = float(np.linalg.norm(corners[0] - corners[1]))
    vertices = (vertices - vertices[landmarks].mean(axis=0, dtype=np.float64)) / unit
    regions = propose_regions(vertices, faces, landmarks) if regions is None else np.asarray(regions, dtype=np.float64)
    graph = SurfaceGraph(vertices, faces)
    return TrueHead(
        title=title,
        vertices=vertices,
        faces=np.asarray(faces, dtype=np.int64),
        landmarks=landmarks,
        regions=regions,
        names=names,
        motions=(motions / unit).astype(np.float32),
        mixtures=random_mixtures(len(names), MIXTURES, seed=2019),
        areas=_areas(vertices, vertices[landmarks], regions),
        rims={name: _outline(graph, landmarks, *lines) for name, lines in _RIMS.items()},
    )


def random_mixtures(count: int, mixtures: int, seed: int) -> Points:
    """(mixtures, count) weights: two to five expressions at a time, each at 0.2 to 1."""
    rng = np.random.default_rng(seed)
    weights = np.zeros((mixtures, count))
    for row in weights:
        chosen = rng.choice(count, rng.integers(2, 6), replace=False)
        row[chosen] = rng.uniform(0.2, 1.0, len(chosen))
    return weights


def _areas(vertices: Points, points: Points, regions: Points) -> dict[str, NDArray[np.bool_]]:
    """Areas: lips, eyes and brows by distance to their landmarks; cheeks and jaw are the rest, above and below."""

    def near(landmarks: NDArray[np.intp], reach: float) -> NDArray[np.bool_]:
        return np.linalg.norm(vertices[:, None] - points[landmarks], axis=2).min(axis=1) < reach

    eye_level = points[OUTER_EYE_CORNERS, 1].mean()
    mouth_level = points[from_ibug((48, 54)), 1].mean()
    height = vertices[:, 1]
    lips = near(np.concatenate([MOUTH_OUTER, from_ibug((61, 62, 63, 65, 66, 67))]), _LIPS)
    eyes = near(np.concatenate([EYE_RIGHT, EYE_LEFT]), _EYES) & ~lips
    brows = near(BROWS, _BROWS) & ~eyes & (height < eye_level)
    rest = regions.any(axis=0) & ~(lips | eyes | brows) & (height > eye_level)
    return {
        "all": np.ones(len(vertices), bool),
        "lips": lips,
        "eyes": eyes,
        "brows": brows,
        "cheeks": rest & (height <= mouth_level),
        "jaw": rest & (height > mouth_level),
    }


def _outline(
    graph: SurfaceGraph, landmarks: NDArray[np.int64], upper: NDArray[np.intp], lower: NDArray[np.intp]
) -> NDArray[np.int64]:
    line = landmarks[np.concatenate([upper, lower[1:]])].tolist()
    return np.array([v for a, b in pairwise(line) for v in graph.path(a, b)[:-1]])

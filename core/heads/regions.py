"""The three regions of the face, cut through the slits of eyes and mouth along the muscles, and edited by mirroring and
smoothing.

Lips that touch move apart, and so do lids: they are neighbours in space that hardly influence each other. A single
radial basis function over the whole face would halve the opening of mouth and eyes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import (
    BROWS,
    EYE_CORNERS,
    JAW,
    LOWER_LIDS,
    LOWER_LIP,
    LOWER_LIPS,
    MOUTH_CORNERS,
    N_LANDMARKS,
    NOSE,
    NOSE_ROOT,
    UPPER_LIDS,
    UPPER_LIP,
    UPPER_LIPS,
    outer_eye_distance,
    symmetry_plane,
)
from ..mesh.kernels import Kernel, distances, wendland
from ..mesh.surface import NearestPoints, SurfaceGraph, edges_of
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

UPPER, MIDDLE, LOWER = 0, 1, 2

DEFAULT_KERNEL = "multiscale"
"""Kernel of the regions' functions; the paper's is "gaussian"."""


@dataclass(frozen=True)
class Region:
    """A region of the face.

    Attributes
    ----------
    landmarks : (P,) intp
        Landmarks (positions in the 66) that control it.
    spacing_factor : float
        Factor of the kernel's width, see `Kernel.width`. Chosen for the smallest vertex error on two heads with known
        expressions (`lab/bench/deformation.py`). The factor of the upper region is small, as lids move close below
        resting brows.
    """

    name: str
    landmarks: NDArray[np.intp]
    spacing_factor: float


_SHARED_ABOVE = np.concatenate([EYE_CORNERS, NOSE_ROOT])
"""Landmarks shared by the upper and the middle region; the corners of the mouth are shared by middle and lower."""

REGIONS: tuple[Region, Region, Region] = (
    Region("upper", np.concatenate([BROWS, UPPER_LIDS, _SHARED_ABOVE]), 0.5),
    Region(
        "middle",
        np.concatenate(
            [np.sort(LOWER_LIDS), NOSE[2:], UPPER_LIP, UPPER_LIPS, JAW[:4], JAW[13:], _SHARED_ABOVE, MOUTH_CORNERS]
        ),
        0.8,
    ),
    Region("lower", np.concatenate([LOWER_LIP[::-1], LOWER_LIPS[::-1], JAW[4:13], MOUTH_CORNERS]), 0.85),
)


_HOLD = 0.3
"""Radius, in outer-eye distances, within which weights change for a landmark."""
_BLOCK = 4096
"""Vertices of which the distances from the landmarks fit into a cache."""
_MIN_WEIGHT = 0.01
"""Least weight after that."""


def membership() -> NDArray[np.bool_]:
    """Whether each landmark controls each region, (3, 66); corners of eyes and mouth, and the nose root, have two."""
    table = np.zeros((len(REGIONS), N_LANDMARKS), dtype=np.bool_)
    for row, region in zip(table, REGIONS, strict=True):
        row[region.landmarks] = True
    return table


def sharp_regions(region_weights: FloatArray, landmarks: IntArray, faces: IntArray | None) -> FloatArray:
    """Convert painted weights to the paper's sets of vertices, whose borders belong to both sides: weights of 0 and 1.

    A painted vertex belongs to the region with the largest weight. Of two neighbours in different regions, the one that
    is painted more evenly belongs to both. The vertex of a landmark belongs to the regions of the landmark, so that
    these meet it exactly. Arrays are as in `HeadRig`; without faces, only landmarks lie on a border.
    """
    painted = np.asarray(region_weights, dtype=np.float64)
    moving = painted.any(axis=0)
    own = painted.argmax(axis=0)
    sharp = moving & (own == np.arange(len(painted))[:, None])
    if faces is not None:
        a, b = edges_of(np.asarray(faces)).T
        crossing = moving[a] & moving[b] & (own[a] != own[b])
        a, b = a[crossing], b[crossing]
        excess = (painted[own[v], v] - painted[own[w], v] for v, w in ((a, b), (b, a)))
        nearer = np.greater(*excess)
        sharp[own[np.where(nearer, a, b)], np.where(nearer, b, a)] = True
    bound = np.asarray(landmarks)[moving[landmarks]]
    sharp[:, bound] = membership()[:, moving[landmarks]]
    return np.asarray(sharp, dtype=np.float64)


def own_weights(region_weights: FloatArray, landmarks: IntArray) -> FloatArray:
    """Sum the weights of each landmark's vertex in the landmark's regions (66,): 1 where it follows exactly."""
    return np.asarray((np.asarray(region_weights, dtype=np.float64)[:, landmarks] * membership()).sum(axis=0))


def hold_landmarks(
    region_weights: FloatArray, vertices: FloatArray, landmarks: IntArray, held: NDArray[np.bool_] | None = None
) -> FloatArray:
    """Change weights around the `held` landmarks, by default all, so that the vertex of each follows it exactly.

    Weights (3, V) are then 0 at the vertex of each landmark in regions to which the landmark does not belong, and sum
    to 1 in the others. They change within `_HOLD` outer-eye distances of landmarks for which this was not the case.
    Arrays are as in `HeadRig`, with weights whose sum is at most 1.
    """
    painted = np.asarray(region_weights, dtype=np.float64)
    places = np.asarray(vertices, dtype=np.float64)
    points, members = places[landmarks], membership()
    at = painted[:, landmarks]
    own = np.where(members, np.maximum(at, 1e-9), 0.0)
    lacking = own / own.sum(axis=0) - at
    if held is not None:
        lacking[:, ~held] = 0.0
    radius = _HOLD * outer_eye_distance(points)
    # Residuals are interpolated with Wendland's function, which is 0 beyond the radius.
    between = wendland(distances(points, points), radius / 4.0)
    amounts = linalg.lstsq(between, lacking.T, cond=1e-9)[0]
    moved = painted.copy()
    for start in range(0, len(places), _BLOCK):
        block = slice(start, start + _BLOCK)
        moved[:, block] += (wendland(distances(places[block], points), radius / 4.0) @ amounts).T
    moved = np.clip(np.where(moved < _MIN_WEIGHT, 0.0, moved), 0.0, 1.0)
    return np.asarray(moved / np.maximum(moved.sum(axis=0), 1.0))


def region_sigmas(landmarks: FloatArray, kernel: Kernel) -> FloatArray:
    """Compute the sigma of the kernel in each of the three regions, in the unit of the landmarks (66, 3) at rest.

    It depends on all landmarks, whichever are control points, so that fewer points do not stiffen the skin.
    """
    widths = [
        kernel.width(distances(points, points), region.spacing_factor)
        for region in REGIONS
        for points in [landmarks[region.landmarks]]
    ]
    return np.array(widths)


def rms_extent(points: FloatArray) -> FloatArray:
    """Root mean square extent of points (N, 3) in x and y, (2,)."""
    return np.asarray(points[:, :2].std(axis=0))


Side = Literal["left", "right"]
"""The head's own left or right."""

_NORMAL_DISTANCE = 0.1
"""Half-distance, in outer-eye distances, that opposite normals stand for: lips that touch coincide, but face apart."""


def mirror_regions(
    vertices: FloatArray, faces: IntArray, landmarks: IntArray, weights: FloatArray, source: Side
) -> FloatArray:
    """Copy the weights of the `source` half of a head, from its own point of view, to the other half, mirrored.

    Each vertex of the other half takes the weights of the vertex whose mirror image is nearest and faces the same way.
    The plane of symmetry is that of the landmarks, so the mesh need not be symmetric or upright. Arrays are as in
    `HeadRig`.
    """
    place = np.asarray(vertices, dtype=np.float64)
    points = place[landmarks]
    unit = outer_eye_distance(points)
    centre, normal = symmetry_plane(points)
    height = (place - centre) @ normal
    looks = _NORMAL_DISTANCE * unit * _normals(place, faces)
    images = np.hstack([_reflected(place, height, normal), _reflected(looks, looks @ normal, normal)])
    on_source = height >= 0.0 if source == "left" else height <= 0.0
    kept, others = np.flatnonzero(on_source), np.flatnonzero(~on_source)
    nearest, _ = NearestPoints(np.hstack([place, looks])[kept]).query(images[others])
    mirrored = np.array(weights)
    mirrored[:, others] = np.asarray(weights)[:, kept[nearest[:, 0]]]
    return mirrored


def smooth_regions(vertices: FloatArray, faces: IntArray, weights: FloatArray, repeat: int = 1) -> FloatArray:
    """Smooth weights (3, V): move each halfway to the mean of its neighbours along edges, `repeat` times.

    Lips and lids stay apart, as no edge joins them. The sum of the weights of a vertex never exceeds the largest sum
    among itself and its neighbours.
    """
    edges = SurfaceGraph(vertices, faces).edges
    degree = np.bincount(edges.reshape(-1), minlength=len(vertices))
    smooth = np.array(weights, dtype=np.float64)
    for _ in range(repeat):
        around = np.array([_sums(row, edges) for row in smooth]) / np.maximum(degree, 1)
        smooth += np.where(degree > 0, 0.5 * (around - smooth), 0.0)
    return smooth.astype(np.asarray(weights).dtype)


def _sums(values: FloatArray, edges: IntArray) -> FloatArray:
    """Sum of `values` over the neighbours of each vertex, (V,)."""
    sums = np.zeros(len(values))
    for at, other in (edges.T, edges[:, ::-1].T):
        sums += np.bincount(at, values[other], len(values))
    return sums


def _reflected(vectors: FloatArray, heights: FloatArray, normal: FloatArray) -> FloatArray:
    return vectors - 2.0 * heights[:, None] * normal


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals, from the first three corners of each face, (V, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_faces = np.cross(b - a, c - a)
    normals: FloatArray = np.zeros_like(vertices)
    for axis in range(3):
        for corner in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], of_faces[:, axis], len(vertices))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals

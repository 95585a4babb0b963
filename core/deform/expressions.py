"""Correlation of motion, learnt from the expression shapes of known heads (method.md, section 5.5).

The skin alone does not show that a lower lid moves with the cheek, but not with the bridge of the nose, which is
equally near. The covariance of its process therefore gains a term that is large between places that move alike in known
expressions (Luethi et al. 2018). It is a correlation rather than a covariance, because the amount of motion differs
between heads much more than which places move together.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import N_LANDMARKS, outer_eye_distance
from ..files.archives import open_shipped
from ..files.assets import ASSETS
from ..heads.built_in import load_head
from ..heads.rims import N_RIM_PLACES, corresponding, rim_places
from ..mesh.kernels import Warp, distances
from ..mesh.surface import NearestPoints
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..numeric.linalg import multiply
from .covariance import SkinCovariance, skin_covariance

FORMAT = "facemime-expressions-2"
EXPRESSIONS_FILE = ASSETS / "expressions" / "ict.npz"

LEARNT_WEIGHT = 0.7
REACH = 0.2
"""Weight of the learnt term relative to the process, and its reach in outer-eye distances (equation 5.7)."""
_FEATURES = 24
"""Number of singular vectors that are kept."""
_REST_MOTION = 0.03
"""Motion in outer-eye distances below which a place counts as resting (equation 5.6), as noise has no direction."""
_REGION_DISTANCE = 0.2
"""Distance, in outer-eye distances, that a difference of 1 in region weights stands for in the search for nearest
places."""
_NEIGHBOURS = 16
_FACET = 0.2
_LEVEL = 0.3
"""Distance to the first place that does not count, from which on the facets of the known head are smoothed away, and
the share of the squared distance below which weights then hardly grow. Denser places, as on lids and lips, are followed
more closely, so that a cheek has no facets and a lip stays sharp."""
_FLATNESS = 0.05
"""Added to the diagonal of the local fit, relative to its trace, as the nearest places lie almost in a plane."""
_CHUNK = 4_000
"""Number of vertices processed at a time, which fit into the CPU's second-level cache."""


@dataclass(frozen=True)
class ExpressionModel:
    """The correlation of motion on one head.

    Attributes
    ----------
    places : (S, 3) float32
        Positions on the skin: head frame, outer-eye distances, origin at the mean of the landmarks.
    sides : (S, 3) float32
        Share of each region at each place, so that one lip is not taken for the other.
    features : (S, K) float32
        Features whose inner products are the correlations of motion.
    landmarks : (66, 3) float32
        Positions of the landmarks in the frame of `places`.
    rims : (64, 3) float32
        Positions along the rims of lids and lips in that frame, as of `rim_places`.
    """

    places: NDArray[np.float32]
    sides: NDArray[np.float32]
    features: NDArray[np.float32]
    landmarks: NDArray[np.float32]
    rims: NDArray[np.float32]

    def transfer(
        self, vertices: FloatArray, faces: IntArray | None, landmarks: IntArray, region_weights: FloatArray
    ) -> NDArray[np.float32]:
        """Transfer the features to the vertices of another head, (V, K); 0 at vertices that no region moves.

        Its rims are known only with its faces.
        """
        places = _normalised(vertices, landmarks)
        moving = np.flatnonzero(region_weights.any(axis=0))
        features = np.zeros((len(places), self.features.shape[1]), dtype=np.float32)
        rims = rim_places(places, faces, landmarks)
        features[moving] = self._at(places[moving], _sides(region_weights)[moving], places[landmarks], rims)
        return features

    def joined(self, other: ExpressionModel) -> ExpressionModel:
        """Return a model whose correlations are the means of those of two models, with the features of both.

        The features of the other one are transferred to the places of this one, which is the more accurate here.
        """
        features = np.concatenate(
            [self.features, other._at(self.places, self.sides, self.landmarks, self.rims)], axis=1
        )
        return replace(self, features=np.float32(np.sqrt(0.5)) * features)

    def _at(
        self, places: FloatArray, sides: FloatArray, landmarks: FloatArray, rims: FloatArray
    ) -> NDArray[np.float32]:
        """Features (V, K) at `places` (V, 3) with `sides` (V, 3) of a head with `landmarks` (66, 3) and `rims` (64, 3).

        The places are warped to the known head by landmarks and rims. Landmarks alone carry lips and lids between them
        beside those of the known head, where motion is quite different: an open mouth would be a diamond. In the known
        head, features are interpolated between the nearest places of the same region by moving least squares of first
        order (Lancaster and Salkauskas 1981). A mean by inverse distances would be simpler, but it is flat at each
        place and jumps where the nearest ones change, which shows as ripples on a dense mesh.
        """
        warp = Warp(*corresponding((landmarks, rims), (self.landmarks, self.rims)))
        warped = warp(places).astype(np.float32)
        known = NearestPoints(_with_sides(self.places, self.sides))
        nearest, squared = known.query(_with_sides(warped, sides), _NEIGHBOURS + 1)
        features = np.empty((len(places), self.features.shape[1]), dtype=np.float32)
        for start in range(0, len(places), _CHUNK):
            part = slice(start, start + _CHUNK)
            rows = nearest[part, :_NEIGHBOURS]
            weights = _smooth_weights(self.places[rows] - warped[part, None], squared[part])
            features[part] = (weights[:, None] @ self.features[rows])[:, 0]
        return features


def learn(
    vertices: FloatArray,
    faces: IntArray,
    landmarks: IntArray,
    region_weights: FloatArray,
    motions: FloatArray,
    kept: IntArray | None = None,
) -> ExpressionModel:
    """Learn the correlation of motion from a head whose expressions, (E, V, 3) in the unit of the vertices, are known.

    Only the vertices `kept` (S,) are kept, for a small file; by default all that move. The features are ``h(x) = m(x) /
    sqrt(|m(x)|^2 + 3 c^2)`` (equation 5.6), where m(x) contains all coordinates of all motions of the place x,
    projected to their strongest singular vectors.
    """
    unit = outer_eye_distance(np.asarray(vertices)[landmarks])
    moving = np.flatnonzero(region_weights.any(axis=0)) if kept is None else np.asarray(kept)
    # m(x) of all places, one row each; equation 5.6.
    flat = motions[:, moving].transpose(1, 0, 2).reshape(len(moving), -1) / unit
    size = np.sqrt(np.square(flat).sum(axis=1, keepdims=True) / 3.0 + _REST_MOTION**2)
    alike = flat / (np.sqrt(3.0) * size)
    # Project to the strongest singular vectors.
    _, axes = linalg.eigh(alike.T @ alike)
    return _model_of(vertices, faces, landmarks, region_weights, moving, alike @ axes[:, ::-1][:, :_FEATURES])


def _model_of(
    vertices: FloatArray,
    faces: IntArray,
    landmarks: IntArray,
    region_weights: FloatArray,
    moving: IntArray,
    features: FloatArray,
) -> ExpressionModel:
    places, sides = _normalised(vertices, landmarks), _sides(region_weights)
    rims = rim_places(places, faces, landmarks)
    parts = places[moving], sides[moving], features, places[landmarks], rims
    return ExpressionModel(*(part.astype(np.float32) for part in parts))


@lru_cache(maxsize=1)
def shipped_expressions() -> ExpressionModel:
    """Return the model of the two known heads: the built-in one and ICT-FaceKit's."""
    head = load_head()
    return learn(head.vertices, head.faces, head.landmarks, head.regions, head.units).joined(load_expressions())


def learnt_covariance(
    model: ExpressionModel,
    vertices: FloatArray,
    faces: IntArray,
    landmarks: IntArray,
    region_weights: FloatArray,
) -> SkinCovariance:
    """Compute the covariance of the process on the skin, as `skin_covariance` does, plus the learnt correlation.

    The term ``w h(x) . h(y) exp(-|x - y|^2 / (2 REACH^2))`` with ``w = LEARNT_WEIGHT`` is added between places x and y
    with features h (equation 5.7).
    """
    with ThreadPoolExecutor(1) as thread:  # NumPy and OpenCV work outside Python's lock
        transferring = thread.submit(model.transfer, vertices, faces, landmarks, region_weights)
        skin = skin_covariance(vertices, faces, landmarks, region_weights)
        features = transferring.result()
    places = _normalised(vertices, landmarks)

    def term(rows: IntArray) -> FloatArray:
        near = np.exp(-0.5 * np.square(distances(places[rows], places[landmarks]) / REACH))
        return np.asarray(LEARNT_WEIGHT * near * multiply(features[rows], features[landmarks].T))

    joined = np.flatnonzero(skin.joined)
    for start in range(0, len(joined), _CHUNK):
        rows = joined[start : start + _CHUNK]
        skin.vertices[rows] += term(rows)
    return replace(skin, control_points=skin.control_points + term(landmarks))


@lru_cache(maxsize=1)
def load_expressions(path: Path = EXPRESSIONS_FILE) -> ExpressionModel:
    """Read a model written by `lab.training.expressions`.

    Raises ModelError if the file is missing, damaged, or of a different version.
    """
    with open_shipped(path, FORMAT) as archive:
        places = archive.floats("places", (None, 3), np.float32)
        return ExpressionModel(
            places=places,
            sides=archive.floats("sides", (len(places), 3), np.float32),
            features=archive.floats("features", (len(places), None), np.float32),
            landmarks=archive.floats("landmarks", (N_LANDMARKS, 3), np.float32),
            rims=archive.floats("rims", (N_RIM_PLACES, 3), np.float32),
        )


def transferred(
    motions: FloatArray,
    vertices: FloatArray,
    faces: IntArray | None,
    landmarks: IntArray,
    region_weights: FloatArray,
) -> NDArray[np.float32]:
    """Transfer displacements (E, B, 3) of the built-in head in metres to another head, in the unit of its vertices.

    The result is (E, V, 3), and 0 at vertices that no region moves.
    """
    known = load_head()
    moving = np.flatnonzero(known.regions.any(axis=0))
    flat = motions[:, moving].transpose(1, 0, 2).reshape(len(moving), -1)
    flat = flat / outer_eye_distance(known.vertices[known.landmarks])
    model = _model_of(known.vertices, known.faces, known.landmarks, known.regions, moving, flat)
    out = model.transfer(vertices, faces, landmarks, region_weights).reshape(len(vertices), -1, 3).transpose(1, 0, 2)
    unit = outer_eye_distance(np.asarray(vertices, dtype=np.float64)[landmarks])
    return np.ascontiguousarray(out * np.float32(unit))


def _smooth_weights(offsets: NDArray[np.float32], squared: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (V, N) of known places at `offsets` (V, N, 3) from each vertex; they change smoothly with the vertex.

    `squared` (V, N + 1) are the squared distances in the search, the last one of the first place that does not count.
    """
    share = squared[:, :-1] / np.maximum(squared[:, -1:], 1e-12)
    level = _LEVEL * np.minimum(squared[:, -1:] / _FACET**2, 1.0) ** 2
    near = np.square(1.0 - share) / (share + level + 1e-6)
    near /= np.maximum(near.sum(axis=1, keepdims=True), 1e-12)
    # A linear function fitted to the places with these weights, evaluated at the vertex.
    middle = (near[:, None] @ offsets)[:, 0]
    away = offsets - middle[:, None]
    spread = (near[:, :, None] * away).transpose(0, 2, 1) @ away
    extent = np.trace(spread, axis1=1, axis2=2) + np.float32(1e-12)
    spread += (_FLATNESS * extent)[:, None, None] * np.eye(3, dtype=np.float32)
    # Beyond the extent of the places themselves, a linear function would only magnify their differences.
    aside = -middle * np.minimum(1.0, np.sqrt(extent / np.maximum(np.square(middle).sum(axis=1), 1e-12)))[:, None]
    slope = linalg.inverses_of_three(spread) @ aside[:, :, None]
    return np.asarray(near * (1.0 + (away @ slope)[:, :, 0]))


def _normalised(vertices: FloatArray, landmarks: IntArray) -> FloatArray:
    places = np.asarray(vertices, dtype=np.float64)
    points = places[landmarks]
    unit = outer_eye_distance(points)
    return np.asarray((places - points.mean(axis=0)) / unit)


def _sides(region_weights: FloatArray) -> FloatArray:
    """Share of each region in the weights of a vertex, (V, 3)."""
    weights = np.asarray(region_weights, dtype=np.float64)
    return np.asarray((weights / np.maximum(weights.sum(axis=0), 1e-9)).T)


def _with_sides(places: FloatArray, sides: FloatArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.concatenate([places, _REGION_DISTANCE * sides], axis=1), dtype=np.float32)

"""Correlation of motion, learnt from the expression shapes of known heads (docs/method.md, section 5.5).

The skin alone does not show that a lower lid moves with the cheek, but not with the bridge of the nose, which is
equally near. The covariance of its process therefore gains a term that is large between places that move alike in known
expressions (Luethi et al. 2018). It is a correlation rather than a covariance, because the amount of motion differs
between heads much more than which places move together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..archives import open_shipped
from ..arrays import FloatArray, IntArray
from ..assets import ASSETS
from ..heads.built_in import load_head
from ..landmarks import N_LANDMARKS, outer_eye_distance
from ..mesh.kernels import distances
from ..mesh.nearest import NearestPoints
from ..mesh.warp import Warp
from .skin import SkinCovariance, skin_covariance

FORMAT = "facemime-expressions-1"
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
_NEIGHBOURS = 4
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
    """

    places: NDArray[np.float32]
    sides: NDArray[np.float32]
    features: NDArray[np.float32]
    landmarks: NDArray[np.float32]

    def transfer(self, vertices: FloatArray, landmarks: IntArray, region_weights: FloatArray) -> NDArray[np.float32]:
        """Transfer the features to the vertices of another head.

        Parameters
        ----------
        vertices, landmarks, region_weights : (V, 3), (66,), (3, V) array
            As in `HeadRig`.

        Returns
        -------
        (V, K) float32
            Features; 0 at vertices that no region moves.
        """
        places = _normalised(vertices, landmarks)
        moving = np.flatnonzero(region_weights.any(axis=0))
        # Warp the vertices to the known head, and average over the nearest places of the same region.
        warped = Warp(places[landmarks], self.landmarks)(places[moving])
        known = NearestPoints(_with_sides(self.places, self.sides))
        nearest, squared = known.query(_with_sides(warped, _sides(region_weights)[moving]), _NEIGHBOURS)
        closeness = 1.0 / (squared + 1e-6)
        closeness /= closeness.sum(axis=1, keepdims=True)
        features = np.zeros((len(places), self.features.shape[1]), dtype=np.float32)
        for start in range(0, len(moving), _CHUNK):
            part = slice(start, start + _CHUNK)
            features[moving[part]] = np.einsum("vn,vnk->vk", closeness[part], self.features[nearest[part]])
        return features


def learn(
    vertices: FloatArray,
    landmarks: IntArray,
    region_weights: FloatArray,
    motions: FloatArray,
    kept: IntArray | None = None,
) -> ExpressionModel:
    """Learn the correlation of motion from a head whose expressions are known.

    Parameters
    ----------
    vertices, landmarks, region_weights : (V, 3), (66,), (3, V) array
        As in `HeadRig`.
    motions : (E, V, 3) array
        Displacements under each expression, in the unit of `vertices`.
    kept : (S,) array of int, optional
        Vertices to keep, for a small file; by default all that move.

    Returns
    -------
    ExpressionModel
        The model.

    Notes
    -----
    The features are ``h(x) = m(x) / sqrt(|m(x)|^2 + 3 c^2)`` (equation 5.6), where m(x) contains all coordinates of all
    motions of the place x, projected to their strongest singular vectors.
    """
    unit = outer_eye_distance(np.asarray(vertices)[landmarks])
    places = _normalised(vertices, landmarks)
    moving = np.flatnonzero(region_weights.any(axis=0)) if kept is None else np.asarray(kept)
    # m(x) of all places, one row each; equation 5.6.
    flat = motions[:, moving].transpose(1, 0, 2).reshape(len(moving), -1) / unit
    size = np.sqrt(np.square(flat).sum(axis=1, keepdims=True) / 3.0 + _REST_MOTION**2)
    alike = flat / (np.sqrt(3.0) * size)
    # Project to the strongest singular vectors.
    _, axes = np.linalg.eigh(alike.T @ alike)
    return ExpressionModel(
        places=places[moving].astype(np.float32),
        sides=_sides(region_weights)[moving].astype(np.float32),
        features=(alike @ axes[:, ::-1][:, :_FEATURES]).astype(np.float32),
        landmarks=places[landmarks].astype(np.float32),
    )


def shipped_expressions() -> tuple[ExpressionModel, ...]:
    """Return the models of the two known heads: ICT-FaceKit's and the built-in one."""
    return load_expressions(), _built_in()


def learnt_covariance(
    models: tuple[ExpressionModel, ...],
    vertices: FloatArray,
    faces: IntArray,
    landmarks: IntArray,
    region_weights: FloatArray,
) -> SkinCovariance:
    """Compute the covariance of the process on the skin plus the learnt correlation, averaged over models.

    Parameters
    ----------
    models : tuple of ExpressionModel
        Models of known heads.
    vertices, faces, landmarks, region_weights
        As for `skin_covariance`.

    Returns
    -------
    SkinCovariance
        Covariance between vertices and landmarks, and among landmarks.

    Notes
    -----
    The term ``w h(x) . h(y) exp(-|x - y|^2 / (2 REACH^2))`` with ``w = LEARNT_WEIGHT`` is added between places x and y
    with features h (equation 5.7).
    """
    skin = skin_covariance(vertices, faces, landmarks, region_weights)
    # Features side by side, scaled so that inner products are means over the models.
    scale = np.float32(1.0 / np.sqrt(len(models)))
    features = scale * np.concatenate([m.transfer(vertices, landmarks, region_weights) for m in models], axis=1)
    places = _normalised(vertices, landmarks)

    def term(rows: IntArray) -> FloatArray:
        near = np.exp(-0.5 * np.square(distances(places[rows], places[landmarks]) / REACH))
        return np.asarray(LEARNT_WEIGHT * near * (features[rows] @ features[landmarks].T))

    joined = np.flatnonzero(skin.joined)
    for start in range(0, len(joined), _CHUNK):
        rows = joined[start : start + _CHUNK]
        skin.vertices[rows] += term(rows)
    return replace(skin, control_points=skin.control_points + term(landmarks))


@lru_cache(maxsize=1)
def load_expressions(path: Path = EXPRESSIONS_FILE) -> ExpressionModel:
    """Read a model written by `training.expressions`.

    Raises
    ------
    ModelError
        If the file is missing, damaged, or of a different version.
    """
    with open_shipped(path, FORMAT) as archive:
        places = archive.floats("places", (None, 3), np.float32)
        return ExpressionModel(
            places=places,
            sides=archive.floats("sides", (len(places), 3), np.float32),
            features=archive.floats("features", (len(places), None), np.float32),
            landmarks=archive.floats("landmarks", (N_LANDMARKS, 3), np.float32),
        )


@lru_cache(maxsize=1)
def _built_in() -> ExpressionModel:
    head = load_head()
    return learn(head.vertices, head.landmarks, head.regions, head.units)


def transferred(
    motions: FloatArray, vertices: FloatArray, landmarks: IntArray, region_weights: FloatArray
) -> NDArray[np.float32]:
    """Transfer displacements of the built-in head to another head.

    Parameters
    ----------
    motions : (E, B, 3) array
        Displacements of the vertices of the built-in head in metres.
    vertices, landmarks, region_weights : (V, 3), (66,), (3, V) array
        As in `HeadRig`.

    Returns
    -------
    (E, V, 3) float32
        Displacements in the unit of `vertices`; 0 at vertices that no region moves.
    """
    known = load_head()
    moving = np.flatnonzero(known.regions.any(axis=0))
    places = _normalised(known.vertices, known.landmarks)
    flat = motions[:, moving].transpose(1, 0, 2).reshape(len(moving), -1)
    flat = flat / outer_eye_distance(known.vertices[known.landmarks])
    model = ExpressionModel(
        places=places[moving].astype(np.float32),
        sides=_sides(known.regions)[moving].astype(np.float32),
        features=flat.astype(np.float32),
        landmarks=places[known.landmarks].astype(np.float32),
    )
    out = model.transfer(vertices, landmarks, region_weights).reshape(len(vertices), -1, 3).transpose(1, 0, 2)
    unit = outer_eye_distance(np.asarray(vertices, dtype=np.float64)[landmarks])
    return np.ascontiguousarray(out * np.float32(unit))


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

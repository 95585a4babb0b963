"""What moves together in a face, learnt from the expression shapes of other heads and carried to any mesh.

The skin does not know that a lower lid goes with the cheek and not with the bridge of the nose, as near as that is. So
the covariance of its process gains a term that is large between places which move alike in known expressions (Luethi
et al. 2018, *Gaussian Process Morphable Models*): the correlation of their motions. The correlation and not the
covariance, as how far a face moves differs from head to head much more than what goes with what.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..archives import MAX_BYTES, read_archive
from ..arrays import FloatArray, IntArray
from ..assets import ASSETS
from ..errors import ModelError
from ..heads.built_in import load_head
from ..landmarks import N_LANDMARKS, outer_eye_distance
from ..mesh.kernels import distances
from ..mesh.nearest import NearestPoints
from ..mesh.warp import Warp
from ..reading import read_bytes
from .skin import SkinCovariance, skin_covariance

FORMAT = "facemime-expressions-1"
EXPRESSIONS_FILE = ASSETS / "expressions" / "ict.npz"

AMOUNT = 0.7
REACH = 0.2
"""Weight of the term beside a process of 1, and how far it reaches, outer-eye distances."""
_FEATURES = 24
_STILL = 0.03
"""Motion, in outer-eye distances, below which a place counts as resting: noise has no direction."""
_SIDE = 0.2
_NEIGHBOURS = 4
_CHUNK = 4_000
"""Vertices at a time: what they need stays in the processor's second cache."""


@dataclass(frozen=True)
class ExpressionModel:
    """Which places of one head move alike.

    Attributes
    ----------
    places : (S, 3) float32
        Places on the skin: head frame, outer-eye distances, origin at the landmarks' mean.
    sides : (S, 3) float32
        Share of the regions in each place, so that a lip is never taken for the other one.
    features : (S, K) float32
        Their products are the correlations of the places' motions.
    landmarks : (66, 3) float32
        As `places`.
    """

    places: NDArray[np.float32]
    sides: NDArray[np.float32]
    features: NDArray[np.float32]
    landmarks: NDArray[np.float32]

    def carry(self, vertices: FloatArray, landmarks: IntArray, region_weights: FloatArray) -> NDArray[np.float32]:
        """(V, K) features of the vertices of another head; 0 where no region moves them.

        Parameters
        ----------
        vertices : (V, 3) array
            Head frame, any unit.
        landmarks : (66,) array of int
        region_weights : (3, V) array
        """
        places = _normalised(vertices, landmarks)
        moving = np.flatnonzero(region_weights.any(axis=0))
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
    """What moves together on a head whose expressions are known.

    Parameters
    ----------
    vertices : (V, 3) array
        Head frame, any unit.
    landmarks : (66,) array of int
    region_weights : (3, V) array
    motions : (E, V, 3) array
        Displacements under each expression, unit of `vertices`.
    kept : (S,) array of int, optional
        Vertices to keep, for a small file; all that move by default.

    Notes
    -----
    The correlation of places x and y over expressions and axes is `u(x).u(y)` with `u(x) = m(x) / |m(x)|` and m(x)
    all coordinates of all motions of x; the features are u on its strongest singular vectors.
    """
    unit = outer_eye_distance(np.asarray(vertices)[landmarks])
    places = _normalised(vertices, landmarks)
    moving = np.flatnonzero(region_weights.any(axis=0)) if kept is None else np.asarray(kept)
    flat = motions[:, moving].transpose(1, 0, 2).reshape(len(moving), -1) / unit
    size = np.sqrt(np.square(flat).sum(axis=1, keepdims=True) / 3.0 + _STILL**2)
    alike = flat / (np.sqrt(3.0) * size)
    _, axes = np.linalg.eigh(alike.T @ alike)
    return ExpressionModel(
        places=places[moving].astype(np.float32),
        sides=_sides(region_weights)[moving].astype(np.float32),
        features=(alike @ axes[:, ::-1][:, :_FEATURES]).astype(np.float32),
        landmarks=places[landmarks].astype(np.float32),
    )


def shipped_expressions() -> tuple[ExpressionModel, ...]:
    """Of both heads whose expressions are known: ICT-FaceKit's and the built-in."""
    return load_expressions(), _built_in()


def learnt_covariance(
    models: tuple[ExpressionModel, ...],
    vertices: FloatArray,
    faces: IntArray,
    landmarks: IntArray,
    region_weights: FloatArray,
) -> SkinCovariance:
    """The process on the skin of a head, and beside it how alike places move, the mean of what `models` say.

    Between places x and y with features u it gains `AMOUNT u(x).u(y) exp(-|x - y|^2 / (2 REACH^2))`; parameters as for
    `skin_covariance`.
    """
    skin = skin_covariance(vertices, faces, landmarks, region_weights)
    scale = np.float32(1.0 / np.sqrt(len(models)))
    features = scale * np.concatenate([m.carry(vertices, landmarks, region_weights) for m in models], axis=1)
    places = _normalised(vertices, landmarks)

    def term(rows: IntArray) -> FloatArray:
        near = np.exp(-0.5 * np.square(distances(places[rows], places[landmarks]) / REACH))
        return np.asarray(AMOUNT * near * (features[rows] @ features[landmarks].T))

    joined = np.flatnonzero(skin.vertices.any(axis=1))
    for start in range(0, len(joined), _CHUNK):
        rows = joined[start : start + _CHUNK]
        skin.vertices[rows] += term(rows)
    return SkinCovariance(skin.vertices, skin.control_points + term(landmarks))


@lru_cache(maxsize=1)
def load_expressions(path: Path = EXPRESSIONS_FILE) -> ExpressionModel:
    """Read a model that `training.expressions` wrote.

    Raises
    ------
    ModelError
        The file is missing, damaged, or of another version.
    """
    try:
        archive = read_archive(read_bytes(path, MAX_BYTES))
        if archive.text("format") != FORMAT:
            raise ValueError("another version")
        places = archive.reals("places", (None, 3), np.float32)
        model = ExpressionModel(
            places=places,
            sides=archive.reals("sides", (len(places), 3), np.float32),
            features=archive.reals("features", (len(places), None), np.float32),
            landmarks=archive.reals("landmarks", (N_LANDMARKS, 3), np.float32),
        )
    except FileNotFoundError as error:
        raise ModelError(f"The expressions {path} are missing. Install Facemime again.") from error
    except (OSError, ValueError) as error:
        raise ModelError(f"The expressions {path} are damaged ({error}). Install Facemime again.") from error
    return model


@lru_cache(maxsize=1)
def _built_in() -> ExpressionModel:
    head = load_head()
    return learn(head.vertices, head.landmarks, head.regions, head.units)


def _normalised(vertices: FloatArray, landmarks: IntArray) -> FloatArray:
    places = np.asarray(vertices, dtype=np.float64)
    points = places[landmarks]
    unit = outer_eye_distance(points)
    return np.asarray((places - points.mean(axis=0)) / unit)


def _sides(region_weights: FloatArray) -> FloatArray:
    """(V, 3) share of each region in what moves a vertex."""
    weights = np.asarray(region_weights, dtype=np.float64)
    return np.asarray((weights / np.maximum(weights.sum(axis=0), 1e-9)).T)


def _with_sides(places: FloatArray, sides: FloatArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.concatenate([places, _SIDE * sides], axis=1), dtype=np.float32)

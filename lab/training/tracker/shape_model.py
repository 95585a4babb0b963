"""The point distribution model: modes of the ICT head, a mean corrected by hand labels, and modes of real faces."""

from __future__ import annotations

import numpy as np

from facemime.core.base.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    MIRROR,
    MOUTH_OUTER,
    N_LANDMARKS,
    OUTER_EYE_CORNERS,
)
from facemime.core.base.rotation import euler_to_matrix
from facemime.core.tracking.pdm import PointDistributionModel

from .heads import IctHead, sample_expression
from .sources import Photo

N_ICT_MODES = 32
N_PHOTO_MODES = 16


def landmark_importance() -> np.ndarray:
    """Weights in the principal component analysis, (66,).

    A blink moves eight points by a tenth of an eye distance; unweighted, it would be lost in the variance of jaws.
    """
    importance = np.ones(N_LANDMARKS)
    importance[JAW] = 0.4
    importance[BROWS] = 2.0
    importance[np.concatenate([EYE_RIGHT, EYE_LEFT])] = 3.5
    importance[MOUTH_OUTER[0] :] = 1.5
    return importance


def _align(neutral: np.ndarray, mean: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Similarity `(scale, rotation, translation)` that takes `neutral` (N, 3) closest to `mean` (Umeyama 1991)."""
    a, b = neutral - neutral.mean(0), mean - mean.mean(0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = (values * sign).sum() / (a * a).sum()
    return scale, rotation, mean.mean(0) - scale * rotation @ neutral.mean(0)


def sample_shapes(head: IctHead, count: int, rng: np.random.Generator) -> np.ndarray:
    """Faces of the ICT family, (count, 66, 3).

    Only the neutral faces are aligned, and each expression is moved like its neutral face, so that no mode mixes a head
    movement into an expression.
    """
    points = head.landmarks
    mean = head.neutral[points].astype(np.float64)
    identity = head.identity[:, points].reshape(100, -1).astype(np.float64)
    expression = head.expression[:, points].reshape(len(head.names), -1).astype(np.float64)
    shapes = np.empty((count, N_LANDMARKS, 3))
    for i in range(count):
        neutral = mean + (rng.standard_normal(100) @ identity).reshape(-1, 3)
        posed = neutral + (sample_expression(head, rng) @ expression).reshape(-1, 3)
        scale, rotation, translation = _align(neutral, mean)
        shapes[i] = scale * posed @ rotation.T + translation
    mirrored = shapes[:, MIRROR] * np.array([-1.0, 1.0, 1.0])
    return np.concatenate([shapes, mirrored])


def principal_modes(deviations: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Modes `(66, 3, count)` and variances `(count,)` of deviations (S, 66, 3), weighted by importance."""
    importance = landmark_importance()[:, None]
    flat = (deviations * importance).reshape(len(deviations), -1)
    covariance = flat.T @ flat / len(flat)
    values, vectors = np.linalg.eigh(covariance)
    order = np.argsort(values)[::-1][:count]
    modes = vectors[:, order].reshape(N_LANDMARKS, 3, count) / importance[..., None]
    return modes, values[order]


def _head_frame_residuals(model: PointDistributionModel, landmarks: list[np.ndarray]) -> np.ndarray:
    """Residuals (S, 66, 3) of the model for each labelled face, turned back to the head's axes, in eye distances."""
    out = np.zeros((len(landmarks), N_LANDMARKS, 3))
    for i, points in enumerate(landmarks):
        fitted = model.fit(points, noise=0.02)
        flat = np.zeros((N_LANDMARKS, 3))
        flat[:, :2] = points - model.project(fitted.pose, fitted.shape_params)
        out[i] = flat @ euler_to_matrix(*fitted.pose[1:4]) / fitted.pose[0]
    return out


def _symmetric(offset: np.ndarray) -> np.ndarray:
    return 0.5 * (offset + offset[MIRROR] * np.array([-1.0, 1.0, 1.0]))


def definition_bias(model: PointDistributionModel, photos: list[Photo]) -> np.ndarray:
    """Systematic offset (66, 3) of the labels of a source from the model's points, in the head frame."""
    residuals = _head_frame_residuals(model, [p.landmarks for p in photos])
    return _symmetric(np.median(residuals, axis=0))


def build_shape_model(
    head: IctHead, photos: list[Photo], rng: np.random.Generator, samples: int = 6000
) -> tuple[PointDistributionModel, np.ndarray]:
    """Return the model, and the offset (66, 3) in eye distances of its mean from the ICT landmarks.

    The symmetric offset is fitted to the hand-labelled `photos`, as the ICT vertices and the labels mark slightly
    different places of a face. The residuals of the photos give the last modes.
    """
    shapes = sample_shapes(head, samples, rng)
    ict_mean = shapes.mean(0)
    modes, variances = principal_modes(shapes - ict_mean, N_ICT_MODES)
    offset = np.zeros((N_LANDMARKS, 3))
    landmarks = [p.landmarks for p in photos]
    for _ in range(8):
        model = PointDistributionModel(ict_mean + offset, modes, variances)
        offset += _symmetric(_head_frame_residuals(model, landmarks).mean(0))
    model = PointDistributionModel(ict_mean + offset, modes, variances)
    left = _head_frame_residuals(model, landmarks)
    left = np.concatenate([left, left[:, MIRROR] * np.array([-1.0, 1.0, 1.0])])
    photo_modes, photo_variances = principal_modes(left - left.mean(0), N_PHOTO_MODES)
    mean = ict_mean + offset
    corners = mean[OUTER_EYE_CORNERS]
    unit = float(np.linalg.norm(corners[0] - corners[1]))
    centre = mean.mean(0)
    basis = np.concatenate([modes, photo_modes], axis=2)
    # A mode's unit is free, so the change of unit goes into the coefficients' variances.
    return (
        PointDistributionModel((mean - centre) / unit, basis, np.concatenate([variances, photo_variances]) / unit**2),
        offset / unit,
    )

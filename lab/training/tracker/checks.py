"""Training of the check: fits that ended at a face against fits that did not."""

from __future__ import annotations

import cv2
import numpy as np

from facemime.core.face.landmarks import INNER
from facemime.core.tracking.fitter import DETECTED, FINE
from facemime.core.tracking.network import FaceCheck
from facemime.core.tracking.pdm import FittedShape
from facemime.core.tracking.tracker import FaceTracker

from .samples import SCALE, SIZE, Samples, occlude
from .sources import Photo

GOOD_BELOW, BAD_ABOVE = 0.05, 0.12
"""Mean errors of the inner landmarks in outer-eye distances that separate good from bad fits; those in between are not
used."""
OCCLUDED, OCCLUDED_GOOD_BELOW = 0.4, 0.08
"""Share of faces with a hand in front, and error up to which these are good fits: hidden landmarks are a guess, and the
face is still there."""


def _error(tracker: FaceTracker, fitted: FittedShape, truth: np.ndarray) -> float:
    found = tracker.pdm.project(fitted.pose, fitted.shape_params)
    return float(np.linalg.norm(found - truth, axis=1)[INNER].mean() / SCALE)


def _near(samples: Samples, i: int, spread: float, rng: np.random.Generator) -> FittedShape:
    pose = samples.poses[i].astype(np.float64)
    pose[0] *= np.exp(rng.normal(0, 0.15 * spread))
    pose[1:4] += rng.normal(0, 0.2 * spread, 3)
    pose[4:6] += rng.normal(0, 0.15 * spread, 2) * SCALE
    return FittedShape(pose, rng.normal(0, 0.3, samples.shapes.shape[1]) * samples.shapes[i])


def clutter(photos: list[Photo], count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Return images without an upright face: pieces of photos, upside down or sideways, and plain surfaces."""
    out = []
    for _ in range(count):
        if rng.random() < 0.25:
            out.append(surface(rng))
            continue
        grey = photos[rng.integers(len(photos))].grey()
        side = int(rng.integers(min(grey.shape) // 3, min(grey.shape)))
        y, x = (int(rng.integers(0, n - side + 1)) for n in grey.shape)
        piece = np.rot90(grey[y : y + side, x : x + side], int(rng.integers(1, 4)))
        out.append(cv2.resize(np.ascontiguousarray(piece), (SIZE, SIZE)))
    return out


def surface(rng: np.random.Generator) -> np.ndarray:
    """A wall: one grey, or blotches as fine as noise or as soft as clouds, with or without noise."""
    blotches = cv2.GaussianBlur(rng.normal(0, 1, (SIZE, SIZE)), (0, 0), float(np.exp(rng.uniform(-1.0, 3.7))))
    strength = rng.choice([0.0, rng.uniform(2.0, 60.0)])
    out = rng.uniform(20, 235) + strength * blotches / blotches.std()
    out += rng.choice([0.0, rng.uniform(0.5, 12.0)]) * rng.normal(0, 1, (SIZE, SIZE))
    return np.clip(out, 0, 255).astype(np.uint8)


def _erased(image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A head without a face: the area within its outline is blurred beyond recognition, as on a head turned away."""
    blank = cv2.GaussianBlur(image, (0, 0), SCALE * rng.uniform(0.2, 0.5))
    mask = np.zeros_like(image)
    centre, axes = landmarks.mean(0), SCALE * rng.uniform(0.75, 1.1) * np.array([0.85, 1.1])
    cv2.ellipse(mask, tuple(int(v) for v in centre), tuple(int(v) for v in axes), 0, 0, 360, 255, -1)
    share = cv2.GaussianBlur(mask, (0, 0), SCALE * 0.08).astype(np.float32) / 255.0
    return (image * (1 - share) + blank * share).astype(np.uint8)


def collect_features(
    tracker: FaceTracker, samples: Samples, photos: list[Photo], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Features (F, 6) of good and bad fits, and whether each is good (F,)."""
    features, good = [], []
    for i in range(len(samples)):
        for spread in (0.4, 3.0):
            stages = (FINE,) if rng.random() < 0.5 else DETECTED
            image, good_below = samples.images[i], GOOD_BELOW
            if spread < 1.0 and rng.random() < OCCLUDED:
                image, good_below = occlude(image, samples.landmarks[i], rng, 2.0)[0], OCCLUDED_GOOD_BELOW
            fit = tracker.fitter.fit(image, _near(samples, i, spread, rng), stages)
            error = _error(tracker, fit.fitted, samples.landmarks[i])
            if error < good_below or error > BAD_ABOVE:
                features.append(fit.features)
                good.append(error < good_below)
        if i % 2:
            erased = _erased(samples.images[i], samples.landmarks[i], rng)
            features.append(tracker.fitter.fit(erased, _near(samples, i, 0.4, rng), (FINE,)).features)
            good.append(False)
    for grey in clutter(photos, len(samples), rng):
        i = int(rng.integers(len(samples)))
        features.append(tracker.fitter.fit(grey, _near(samples, i, 2.0, rng), DETECTED).features)
        good.append(False)
    return np.stack(features), np.array(good)


def train_check(features: np.ndarray, good: np.ndarray, ridge: float = 1.0) -> FaceCheck:
    """Logistic regression by Newton's method, with equal weights of both classes."""
    x = features.astype(np.float64)
    share = np.where(good, 0.5 / max(good.mean(), 1e-3), 0.5 / max(1 - good.mean(), 1e-3))
    weights = np.zeros(x.shape[1])
    for _ in range(12):
        likely = 1.0 / (1.0 + np.exp(-np.clip(x @ weights, -30, 30)))
        gradient = x.T @ (share * (likely - good)) + ridge * weights
        curvature = (x * (share * likely * (1 - likely))[:, None]).T @ x
        curvature[np.diag_indices_from(curvature)] += ridge
        weights -= np.linalg.solve(curvature, gradient)
    return FaceCheck(weights)

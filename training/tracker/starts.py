"""Trains the start: where a pose lies in a detector's box, and the regressions that lead from there to the face."""

from __future__ import annotations

import numpy as np

from facemime.core.tracking.detect import DETECTORS, EFFORTS, BoxDetector
from facemime.core.tracking.pdm import N_POSE, FittedShape, PointDistributionModel
from facemime.core.tracking.start import N_START_MODES, StartModel, apply_update, gradient_features

from .samples import Samples

N_STEPS = 5


def fit_box_offsets(pictures: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(D, 3) median of `(dx, dy, scale)` in box widths, over grey pictures with known poses (6,)."""
    detector = BoxDetector()
    seen: list[list[tuple[float, float, float]]] = [[] for _ in DETECTORS]
    for grey, pose in pictures:
        for face in (f for effort in EFFORTS for f in detector.boxes(grey, effort)):
            x, y, width, height = face.box
            away = pose[4:6] - (x + width / 2, y + height / 2)
            if face.roll == 0.0 and np.abs(away).max() < 0.35 * width and 0.25 < pose[0] / width < 0.8:
                seen[face.detector].append((away[0] / width, away[1] / width, pose[0] / width))
    offsets = np.array([np.median(s, axis=0) if s else (0.0, 0.1, 0.45) for s in seen])
    offsets[:, 0] = 0.0  # faces are symmetric, and profiles are searched on both sides
    return offsets


def _scattered(samples: Samples, rows: np.ndarray, n_modes: int, rng: np.random.Generator) -> list[FittedShape]:
    """Starts as a detector's box would give them: frontal, mean shape, beside the truth."""
    starts = []
    for i in rows:
        true = samples.poses[i].astype(np.float64)
        scale = true[0] * np.exp(rng.normal(0, 0.13))
        move = rng.normal(0, 0.13, 2) * true[0]
        pose = np.array([scale, 0.0, 0.0, rng.normal(0, 0.22), true[4] + move[0], true[5] + move[1]])
        starts.append(FittedShape(pose, np.zeros(n_modes)))
    return starts


def _wanted_update(fitted: FittedShape, pose: np.ndarray, shape_params: np.ndarray) -> np.ndarray:
    c, s = np.cos(fitted.pose[3]), np.sin(fitted.pose[3])
    away = (pose[4:6] - fitted.pose[4:6]) / fitted.pose[0]
    move = (c * away[0] + s * away[1], -s * away[0] + c * away[1])
    turn = pose[1:4] - fitted.pose[1:4]
    modes = (shape_params - fitted.shape_params)[:N_START_MODES]
    return np.array([np.log(pose[0] / fitted.pose[0]), *turn, *move, *modes])


def train_start(
    samples: Samples, model: PointDistributionModel, offsets: np.ndarray, rng: np.random.Generator, copies: int = 3
) -> StartModel:
    """Ridge regressions, each trained where the one before it ends; the ridge is chosen on a tenth kept apart."""
    rows = np.tile(np.arange(len(samples)), copies)
    fits = _scattered(samples, rows, model.n_modes, rng)
    kept = rows % 10 == 0
    steps = []
    for _ in range(N_STEPS):
        features = np.stack([gradient_features(samples.images[i], f.pose) for i, f in zip(rows, fits, strict=True)])
        wanted = np.stack(
            [_wanted_update(f, samples.poses[i], samples.shapes[i]) for i, f in zip(rows, fits, strict=True)]
        )
        x, y = features[~kept].astype(np.float64), wanted[~kept]
        normal, right = x.T @ x, x.T @ y
        best, regression = np.inf, np.zeros((x.shape[1], N_POSE + N_START_MODES))
        for ridge in (1.0, 3.0, 10.0, 30.0, 100.0):
            tried = np.linalg.solve(normal + ridge * np.eye(len(normal)), right)
            error = np.abs(features[kept] @ tried - wanted[kept])[:, :N_POSE].sum(1).mean()
            if error < best:
                best, regression = error, tried
        steps.append(regression.astype(np.float32))
        fits = [apply_update(model, f, u) for f, u in zip(fits, features @ regression, strict=True)]
        left = np.stack(
            [_wanted_update(f, samples.poses[i], samples.shapes[i]) for i, f in zip(rows, fits, strict=True)]
        )
        print(
            "start: scale, angles, shift left over on the kept tenth", np.round(left[kept][:, :6].std(0), 4), flush=True
        )
    return StartModel(offsets, np.stack(steps))

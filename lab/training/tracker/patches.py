"""Training of the patch experts, all landmarks at once by batched matrix products, with Adam (Kingma & Ba 2015)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.base.landmarks import MIRROR, N_LANDMARKS
from facemime.core.tracking.patch_experts import CONTRAST_FLOOR, HALF, PATCH, PatchExperts
from facemime.core.tracking.reference import warp_to_reference

from .samples import Samples

UNITS = 32
_REACH = 1.55
"""Half the side of a training image in outer-eye distances."""
TARGET_DEVIATION = 1.0
"""Width of the desired response in pixels of the reference frame."""
_PIXELS = np.stack(np.meshgrid(np.arange(-HALF, HALF + 1), np.arange(-HALF, HALF + 1)), -1).reshape(-1, 2)


@dataclass
class ReferenceSet:
    """Samples in the reference frame: images (M, S, S) uint8, landmarks (M, 66, 2), weights (M, 66)."""

    pictures: np.ndarray
    landmarks: np.ndarray
    weights: np.ndarray


def reference_set(samples: Samples, scale: float, rng: np.random.Generator) -> ReferenceSet:
    """Warp the samples as the tracker will, at slightly wrong poses."""
    size, count = 2 * round(_REACH * scale), len(samples)
    pictures = np.empty((count, size, size), np.uint8)
    landmarks = np.empty((count, N_LANDMARKS, 2), np.float32)
    weights = np.empty((count, N_LANDMARKS), np.float32)
    for i in range(count):
        pose = samples.poses[i].astype(np.float64)
        pose[0] *= np.exp(rng.normal(0, 0.06))
        pose[3] += rng.normal(0, 0.07)
        pose[4:6] += rng.normal(0, 0.04, 2) * pose[0]
        frame = warp_to_reference(samples.images[i], pose, scale, (size, size))
        pictures[i] = frame.pixels
        landmarks[i] = samples.landmarks[i] @ frame.linear.T + frame.offset
        weights[i] = samples.visible[i] * samples.weights[i]
    return ReferenceSet(pictures, landmarks, weights)


def mirror_samples(samples: Samples) -> Samples:
    """Flip every image left to right. Shape coefficients are not mirrored and must not be used afterwards."""
    landmarks = samples.landmarks[:, MIRROR].copy()
    landmarks[..., 0] = samples.images.shape[2] - 1 - landmarks[..., 0]
    poses = samples.poses * np.float32([1, 1, -1, -1, 1, 1])
    poses[:, 4] = samples.images.shape[2] - 1 - poses[:, 4]
    images = np.stack([cv2.flip(image, 1) for image in samples.images])
    return Samples(images, landmarks, samples.visible[:, MIRROR], poses, samples.shapes, samples.weights)


def _draw_patches(
    data: ReferenceSet, batch: int, radius: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normalised patches (66, batch, 121), desired responses and weights (66, batch); half of the places are near."""
    count, size = data.pictures.shape[:2]
    rows = rng.integers(0, count, (N_LANDMARKS, batch))
    truth = data.landmarks[rows, np.arange(N_LANDMARKS)[:, None]]
    far = rng.integers(-radius, radius + 1, (N_LANDMARKS, batch, 2))
    near = np.round(rng.normal(0, 1.6, (N_LANDMARKS, batch, 2)))
    offset = np.where(rng.random((N_LANDMARKS, batch, 1)) < 0.5, near, far)
    place = np.round(truth).astype(int) + offset.astype(int)
    inside = ((place >= HALF) & (place < size - HALF)).all(-1)
    place = np.clip(place, HALF, size - HALF - 1)
    index = (rows * size + place[..., 1]) * size + place[..., 0]
    patches = data.pictures.ravel()[index[..., None] + (_PIXELS[:, 1] * size + _PIXELS[:, 0])].astype(np.float32)
    patches -= patches.mean(-1, keepdims=True)
    patches /= np.sqrt((patches * patches).mean(-1, keepdims=True) + CONTRAST_FLOOR**2)
    distance = ((place - truth) ** 2).sum(-1)
    target = np.exp(distance / (-2 * TARGET_DEVIATION**2)).astype(np.float32)
    return patches, target, (data.weights[rows, np.arange(N_LANDMARKS)[:, None]] * inside).astype(np.float32)


class _Adam:
    def __init__(self, shapes: list[tuple[int, ...]]) -> None:
        self.first = [np.zeros(s, np.float32) for s in shapes]
        self.second = [np.zeros(s, np.float32) for s in shapes]
        self.steps = 0

    def update(self, values: list[np.ndarray], gradients: list[np.ndarray], rate: float) -> None:
        self.steps += 1
        correction = rate * np.sqrt(1 - 0.999**self.steps) / (1 - 0.9**self.steps)
        for value, gradient, m, v in zip(values, gradients, self.first, self.second, strict=True):
            m[...] = 0.9 * m + 0.1 * gradient
            v[...] = 0.999 * v + 0.001 * gradient * gradient
            np.subtract(value, correction * m / (np.sqrt(v) + 1e-8), out=value)


def train_experts(
    data: ReferenceSet,
    scale: float,
    rng: np.random.Generator,
    *,
    steps: int = 2600,
    batch: int = 256,
    radius: int = 9,
    units: int = UNITS,
) -> tuple[PatchExperts, float]:
    """Train experts for one view and scale; also return the mean cross-entropy of the last tenth of the steps."""
    hidden = rng.normal(0, np.sqrt(2.0 / PATCH**2), (N_LANDMARKS, PATCH**2, units)).astype(np.float32)
    values = [
        hidden,
        np.zeros((N_LANDMARKS, units), np.float32),
        rng.normal(0, np.sqrt(1.0 / units), (N_LANDMARKS, units)).astype(np.float32),
        np.full(N_LANDMARKS, -2.0, np.float32),
    ]
    adam = _Adam([v.shape for v in values])
    losses = []
    for step in range(steps):
        patches, target, weights = _draw_patches(data, batch, radius, rng)
        w, b, v, c = values
        units_out = np.maximum(np.matmul(patches, w) + b[:, None], 0.0)
        response = 1.0 / (1.0 + np.exp(-(np.matmul(units_out, v[..., None])[..., 0] + c[:, None])))
        slope = weights * (response - target) / batch
        back = slope[..., None] * v[:, None] * (units_out > 0)
        gradients = [
            np.matmul(patches.transpose(0, 2, 1), back) + 1e-5 * w,
            back.sum(1),
            np.matmul(units_out.transpose(0, 2, 1), slope[..., None])[..., 0],
            slope.sum(1),
        ]
        progress = step / steps
        adam.update(values, gradients, 4e-3 * 0.5 * (1 + np.cos(np.pi * progress)) + 2e-5)
        if progress >= 0.9:
            likely = np.clip(response, 1e-6, 1 - 1e-6)
            losses.append(-(weights * (target * np.log(likely) + (1 - target) * np.log(1 - likely))).mean())
    w, b, v, c = values
    w = w - w.mean(1, keepdims=True)  # the patches' mean is 0, so this changes nothing but spares subtracting it
    return PatchExperts(scale, w, b, v, c), float(np.mean(losses))

"""Input of the networks in training: crops of the training images, slightly misplaced, mirrored and degraded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.face.landmarks import MIRROR
from facemime.core.face.names import ACTION_MIRROR
from facemime.core.tracking.experts import FACE_STRIDE, PART_STRIDE, crop_face, crop_part, first_cell

from .acting import ActionSamples
from .samples import SCALE, Samples
from .sources import mirrored

SHARE = {1.0: 0.47, 0.6: 0.12, 0.3: 0.41}
"""Share of samples from each source: labelled by hand, smiling, portraits."""
FURTHER_SHARE = {1.0: 0.28, 0.6: 0.13, 0.3: 0.44, 0.2: 0.15}
"""The same for training a part further; the last are clips."""
TRUST = {1.0: 1.0, 0.6: 0.8, 0.3: 0.6, 0.2: 0.6}
_HIDDEN = 0.3
"""Weight of an invisible landmark, which has to be guessed from the rest of the face and marked by a wide map."""
_CLUTTER, _MISPLACED = 0.06, 0.12
"""Draws below the first show no face, and those below the second a face far from its place."""
_ROTATED = 0.25
_NEAR = 0.2
_SPOILT = 0.3
"""Share of the images for the expert of actions that are degraded once more, and of those with something in front. Much
of their content is fine detail."""


@dataclass(frozen=True)
class Batch:
    """Images (B, 1, H, W), landmarks (B, n, 2) in cells, weights (B, n); whether a face is there, and whether that is
    to be learnt, (B, 2). All are float32.
    """

    pictures: np.ndarray
    cells: np.ndarray
    weights: np.ndarray
    face: np.ndarray


@dataclass(frozen=True)
class ActionBatch:
    """Images (B, 1, H, W) and activations (B, n), float32."""

    pictures: np.ndarray
    actions: np.ndarray


@dataclass(frozen=True)
class ActionPart:
    """Input and output of the expert of a part's actions; the fields are those of `ActionExperts`."""

    actions: np.ndarray
    landmarks: np.ndarray
    scale: float
    size: tuple[int, int]
    paired: bool


def draw_actions(samples: ActionSamples, part: ActionPart, count: int, rng: np.random.Generator) -> ActionBatch:
    """A part of faces, mirrored or not, approximately where the tracker finds it."""
    pictures = np.empty((count, 1, *part.size[::-1]), np.float32)
    actions = np.empty((count, len(part.actions)), np.float32)
    for row, i in enumerate(rng.integers(len(samples), size=count)):
        image, pose, shown = samples.images[i], samples.poses[i].astype(np.float64), samples.actions[i]
        points = samples.landmarks[i].astype(np.float64)
        if rng.random() < 0.5:
            (image, points), shown = mirrored(image, points), shown[ACTION_MIRROR]
        pose[0] *= np.exp(rng.normal(0, 0.03))
        pose[3] += rng.normal(0, 0.03)
        pose[4:6] = points[part.landmarks].mean(axis=0) + rng.normal(0, 0.02, 2) * SCALE
        if rng.random() < _SPOILT:
            image = spoilt_source(image, rng)
        picture = crop_part(image, pose, part.scale, part.size)
        pictures[row, 0] = covered(picture, rng) if rng.random() < _SPOILT else picture
        actions[row] = shown[part.actions]
    return ActionBatch(pictures, actions)


class Crops:
    """Draws batches from samples."""

    def __init__(self, samples: Samples, rng: np.random.Generator, shares: Mapping[float, float] = SHARE) -> None:
        self._samples, self._rng = samples, rng
        weights = np.round(samples.weights.astype(np.float64), 2)
        self._odds = np.zeros(len(samples))
        self._trust = np.ones(len(samples), np.float32)
        for weight, share in shares.items():
            rows = weights == weight
            self._odds[rows] = share / max(rows.sum(), 1)
            self._trust[rows] = TRUST[weight]
        self._odds /= self._odds.sum()

    def face(self, count: int, clutter: np.ndarray, scale: float, size: int, loose: float) -> Batch:
        """Draw whole faces, a share `loose` of them as given by a detector's box, and some far away.

        `clutter` (C, S, S) are images without a face.
        """
        rng = self._rng

        def draw(sample: _Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
            fate = rng.random()
            absent, far = fate < _CLUTTER, _CLUTTER <= fate < _MISPLACED
            image = clutter[rng.integers(len(clutter))] if absent else sample.image
            pose = _misplaced(sample.pose, rng) if far else _perturbed(sample.pose, rng.random() < loose, rng)
            picture = crop_face(spoilt_source(image, rng), pose, scale, size)
            cells = _in_crop(sample.landmarks, pose, scale, (size, size), FACE_STRIDE)
            shown = not (absent or far)
            known = absent or far or _is_near(pose, sample.pose)
            return picture, cells, sample.weights * shown, (float(shown), float(known))

        return self._batch(count, np.arange(len(MIRROR)), (size, size), FACE_STRIDE, draw)

    def part(self, count: int, landmarks: np.ndarray, scale: float, size: tuple[int, int]) -> Batch:
        """Draw one part of faces, approximately where it is."""
        rng = self._rng

        def draw(sample: _Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
            pose = sample.pose.copy()
            pose[4:6] = sample.landmarks.mean(0)
            loose = rng.random() < 0.3
            growth, turn, move = (0.1, 0.12, 0.09) if loose else (0.04, 0.04, 0.04)
            pose[0] *= np.exp(rng.normal(0, growth))
            pose[3] += rng.normal(0, turn)
            pose[4:6] += rng.normal(0, move, 2) * SCALE
            picture = crop_part(spoilt_source(sample.image, rng), pose, scale, size)
            cells = _in_crop(sample.landmarks, pose, scale, size, PART_STRIDE)
            return picture, cells, sample.weights, (1.0, 1.0)

        return self._batch(count, landmarks, size, PART_STRIDE, draw)

    def _batch(
        self,
        count: int,
        landmarks: np.ndarray,
        size: tuple[int, int],
        stride: int,
        draw: Callable[[_Sample], tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]],
    ) -> Batch:
        rng = self._rng
        pictures = np.empty((count, 1, *size[::-1]), np.float32)
        places = np.empty((count, len(landmarks), 2), np.float32)
        weights = np.zeros((count, len(landmarks)), np.float32)
        face = np.zeros((count, 2), np.float32)
        for row, i in enumerate(rng.choice(len(self._odds), count, p=self._odds)):
            sample = self._sample(int(i), landmarks, rng.random() < 0.5)
            picture, places[row], weight, face[row] = draw(sample)
            pictures[row, 0] = covered(picture, rng)
            inside = ((places[row] > 0) & (places[row] < np.array(size) // stride - 1)).all(-1)
            weights[row] = weight * inside
        return Batch(pictures, places, weights, face)

    def _sample(self, i: int, landmarks: np.ndarray, flip: bool) -> _Sample:
        s = self._samples
        image, points, pose = s.images[i], s.landmarks[i].astype(np.float64), s.poses[i].astype(np.float64)
        visible = s.visible[i]
        if flip:
            (image, points), visible = mirrored(image, points), visible[MIRROR]
            pose[4] = image.shape[1] - 1 - pose[4]
        weights = np.where(visible, 1.0, _HIDDEN) * self._trust[i]
        return _Sample(image, points[landmarks], weights[landmarks].astype(np.float32), pose)


@dataclass(frozen=True)
class _Sample:
    image: np.ndarray
    landmarks: np.ndarray
    weights: np.ndarray
    pose: np.ndarray


def _in_crop(landmarks: np.ndarray, pose: np.ndarray, scale: float, size: tuple[int, int], stride: int) -> np.ndarray:
    """Landmarks (n, 2) of the image in cells of a crop's maps."""
    c, s = np.cos(pose[3]), np.sin(pose[3])
    away = (landmarks - pose[4:6]) @ np.array([[c, -s], [s, c]]) * (scale / pose[0])
    cells: np.ndarray = (away - [first_cell(side, stride) for side in size]) / stride
    return cells


def _perturbed(pose: np.ndarray, loose: bool, rng: np.random.Generator) -> np.ndarray:
    """Perturb a pose as the last frame would leave it or, if `loose`, as a detector's box would give it."""
    out = pose.copy()
    if loose:
        out[0] *= np.exp(rng.uniform(-0.32, 0.32))
        out[3] += rng.uniform(-0.5, 0.5)
        out[4:6] += rng.uniform(-0.3, 0.3, 2) * SCALE
    else:
        out[0] *= np.exp(rng.normal(0, 0.06))
        out[3] += rng.normal(0, 0.06)
        out[4:6] += rng.normal(0, 0.05, 2) * SCALE
    return out


def _misplaced(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a pose with a wrong size, roll or place."""
    out = pose.copy()
    kind = rng.integers(3)
    if kind == 0:
        out[0] *= np.exp(rng.choice([-1, 1]) * rng.uniform(0.55, 1.2))
    elif kind == 1:
        out[3] += rng.choice([-1, 1]) * rng.uniform(0.9, np.pi)
    else:
        angle = rng.uniform(0, 2 * np.pi)
        out[4:6] += np.array([np.cos(angle), np.sin(angle)]) * rng.uniform(0.6, 1.2) * SCALE
    return out


def _is_near(pose: np.ndarray, truth: np.ndarray) -> bool:
    return bool(
        abs(np.log(pose[0] / truth[0])) < _NEAR
        and abs(pose[3] - truth[3]) < _ROTATED
        and np.hypot(*(pose[4:6] - truth[4:6])) < _NEAR * SCALE
    )


def spoilt_source(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an image with its own lighting and, sometimes, out of focus."""
    if rng.random() < 0.3:
        image = cv2.convertScaleAbs(image, alpha=rng.uniform(0.3, 1.4))
    if rng.random() < 0.2:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.8, 3.0))
    return image


def covered(picture: np.ndarray, rng: np.random.Generator, share: float = 0.25) -> np.ndarray:
    """Return a standardised image with noise or, in a `share` of images, something in front."""
    size = max(picture.shape)
    if rng.random() < 0.25:
        picture = picture + rng.normal(0, rng.uniform(0.02, 0.25), picture.shape).astype(np.float32)
    if rng.random() < share:
        height, width = rng.integers(size // 10, size * 2 // 5, 2)
        y, x = rng.integers(0, size - size // 10, 2)
        hidden = picture[y : y + height, x : x + width]
        hidden[...] = rng.normal(0, 1.2) + rng.normal(0, rng.uniform(0, 0.6), hidden.shape)
    return picture

"""Training images: faces in a canonical frame with exact landmarks, from photos and from re-projection.

The canonical frame is `SIZE` pixels square, without roll, centred on the pose, with `SCALE` pixels per outer-eye
distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from facemime.core.tracking.pdm import PointDistributionModel

from .dress import dress
from .heads import IctHead, sample_expression, sample_speech
from .reproject import Light, Rendering, Scene, SkinnedHead, render, skin_head
from .sources import Photo, mirrored
from .wrinkles import crease

SIZE = 272
SCALE = 80.0
CENTRE = (SIZE - 1) / 2.0


@dataclass
class Stack:
    """Arrays with a row per image."""

    def __len__(self) -> int:
        """Number of images."""
        return len(getattr(self, fields(self)[0].name))

    def save(self, path: Path) -> None:
        """Write to an uncompressed npz, completely or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part.npz")
        np.savez(unfinished, **{f.name: getattr(self, f.name) for f in fields(self)})
        unfinished.replace(path)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read the result of `save`."""
        raw = np.load(path, allow_pickle=False)
        return cls(**{f.name: raw[f.name] for f in fields(cls)})

    @classmethod
    def load_all(cls, folder: Path) -> Self:
        """Read and concatenate all parts in a folder, in the order of their numbers."""
        return cls.join([cls.load(path) for path in sorted(folder.glob("*[0-9].npz"))])

    @classmethod
    def join(cls, parts: list[Self]) -> Self:
        """Concatenate parts."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})


@dataclass
class Samples(Stack):
    """Training images, stacked.

    Attributes
    ----------
    images : (N, SIZE, SIZE) uint8
    landmarks : (N, 66, 2) float32
    visible : (N, 66) bool
    poses : (N, 6), shapes : (N, K) float32
        The shape model's explanation of the landmarks.
    weights : (N,) float32
        Trust in the labels.
    """

    images: np.ndarray
    landmarks: np.ndarray
    visible: np.ndarray
    poses: np.ndarray
    shapes: np.ndarray
    weights: np.ndarray

    def take(self, rows: np.ndarray) -> Samples:
        """The chosen rows."""
        return Samples(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def _stack(
    model: PointDistributionModel, rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]]
) -> Samples:
    images, landmarks, visible, starts, weights = zip(*rows, strict=True)
    fitted = [model.fit(x, noise=0.008, start=s, iterations=8) for x, s in zip(landmarks, starts, strict=True)]
    return Samples(
        np.stack(images),
        np.float32(landmarks),
        np.stack(visible),
        np.float32([f.pose for f in fitted]),
        np.float32([f.shape_params for f in fitted]),
        np.float32(weights),
    )


def canonical_photo(
    model: PointDistributionModel, photo: np.ndarray, landmarks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Warp a photo into the canonical frame; return the image, landmarks (66, 2) and pose (6,) there."""
    pose = model.fit(landmarks, noise=0.01).pose
    factor = pose[0] / SCALE
    if factor > 1.5:  # the warp below reads single pixels: shrink first, so that it does not alias
        shrink = 1.0 / factor
        photo = cv2.resize(photo, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        landmarks = (landmarks + 0.5) * shrink - 0.5
        pose = pose.copy()
        pose[0] *= shrink
        pose[4:6] = (pose[4:6] + 0.5) * shrink - 0.5
    gain = SCALE / pose[0]
    c, s = gain * np.cos(pose[3]), gain * np.sin(pose[3])
    linear = np.array([[c, s], [-s, c]])
    matrix = np.column_stack([linear, CENTRE - linear @ pose[4:6]])
    image = cv2.warpAffine(photo, matrix, (SIZE, SIZE), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return image, landmarks @ linear.T + matrix[:, 2], np.array([SCALE, pose[1], pose[2], 0.0, CENTRE, CENTRE])


def degrade(image: np.ndarray, rng: np.random.Generator, coarsest: float = 26.0 / SCALE) -> np.ndarray:
    """Degrade a grey image (S, S), reduced at most to `coarsest`, as lamps, lenses, sensors and codecs do."""
    side = len(image)
    out = image.astype(np.float32)
    if rng.random() < 0.4:
        angle, depth = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.55)
        y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j].astype(np.float32)
        edge = (x * np.cos(angle) + y * np.sin(angle) - rng.uniform(-0.4, 0.4)) / rng.uniform(0.05, 0.8)
        out *= 1.0 - depth / (1.0 + np.exp(-np.clip(edge, -20, 20)))
    out = 255.0 * np.clip(out / 255.0, 0, 1) ** rng.uniform(0.6, 1.6)
    out = (out - 128.0) * rng.uniform(0.45, 1.1) + rng.uniform(75.0, 170.0)
    small = side
    if rng.random() < 0.55:
        small = int(side * rng.uniform(coarsest, 1.0))
        out = cv2.resize(out, (small, small), interpolation=cv2.INTER_AREA)
    if rng.random() < 0.35:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.6) * small / side + 0.1)
    if rng.random() < 0.12:
        length = int(rng.integers(2, 6))
        kernel = np.zeros((length, length), np.float32)
        cv2.line(kernel, (0, int(rng.integers(length))), (length - 1, int(rng.integers(length))), 1.0)
        out = cv2.filter2D(out, -1, kernel / kernel.sum())
    if rng.random() < 0.5:
        out += rng.normal(0, rng.uniform(0.5, 8.0), out.shape).astype(np.float32)
    out8 = np.clip(out, 0, 255).astype(np.uint8)
    if rng.random() < 0.5:
        _, packed = cv2.imencode(".jpg", out8, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 85))])
        out8 = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
    if small != side:
        out8 = cv2.resize(out8, (side, side), interpolation=cv2.INTER_LINEAR)
    return out8


def backdrop(
    skinned: SkinnedHead, shown: np.ndarray, head: IctHead, other: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return an image to put behind the face: its own photo, moved with the head, or a piece of another photo."""
    if rng.random() < 0.6:
        source = skinned.uv[head.landmarks][:27]
        matrix, _ = cv2.estimateAffine2D(source, shown[:27].astype(np.float32), method=cv2.LMEDS)
        if matrix is not None:
            return cv2.warpAffine(skinned.skin, matrix, (SIZE, SIZE), borderMode=cv2.BORDER_REPLICATE)
    side = int(rng.integers(min(other.shape) // 3, min(other.shape)))
    y, x = (int(rng.integers(0, n - side + 1)) for n in other.shape)
    piece = cv2.resize(other[y : y + side, x : x + side], (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)
    return piece[:, ::-1] if rng.random() < 0.5 else np.ascontiguousarray(piece[::-1])


def composed(
    picture: Rendering, skinned: SkinnedHead, head: IctHead, backgrounds: list[Photo], rng: np.random.Generator
) -> np.ndarray:
    """Return the image of a rendered head in front of a backdrop, with soft edges."""
    behind = backdrop(skinned, picture.landmarks, head, backgrounds[rng.integers(len(backgrounds))].grey(), rng)
    soft = cv2.GaussianBlur(picture.covered.astype(np.float32), (0, 0), 0.8)
    return np.where(picture.covered, picture.image * soft + behind * (1 - soft), behind).astype(np.uint8)


def occlude(
    image: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator, size: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Draw an ellipse of the image's own texture in front; also return which landmarks it hides.

    At size 1 it is as large as two fingers up to a fist.
    """
    mask = np.zeros_like(image)
    centre = landmarks[rng.integers(len(landmarks))] + rng.normal(0, 15, 2)
    axes = (int(size * rng.uniform(8, 40)), int(size * rng.uniform(12, 60)))
    cv2.ellipse(mask, tuple(int(v) for v in centre), axes, rng.uniform(0, 180), 0, 360, 255, -1)
    shifted = np.roll(image, tuple(int(v) for v in rng.integers(60, 200, 2)), (0, 1))
    blend = cv2.GaussianBlur(mask, (0, 0), 1.0).astype(np.float32) / 255.0
    column, row = np.clip(np.round(landmarks).astype(int), 0, SIZE - 1).T
    return (image * (1 - blend) + shifted * blend).astype(np.uint8), mask[row, column] > 0


def skin_photo(head: IctHead, model: PointDistributionModel, photo: Photo, rng: np.random.Generator) -> SkinnedHead:
    """The head with the skin of a photo, or as often of its mirror image."""
    grey, landmarks = photo.grey(), photo.landmarks
    if rng.random() < 0.5:
        grey, landmarks = mirrored(grey, landmarks)
    return skin_head(head, model, grey, landmarks, acting=not photo.by_hand)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """Canonical pose (6,), usually turned moderately, up to about 55 degrees of yaw."""
    yaw = rng.normal(0, 0.25) if rng.random() < 0.55 else rng.uniform(-0.95, 0.95)
    pitch = np.clip(rng.normal(0, 0.2), -0.55, 0.55)
    return np.array([SCALE, pitch, yaw, 0.0, CENTRE, CENTRE])


def random_light(
    rng: np.random.Generator, *, darkest: float = 0.45, brightest: float = 0.8, frontal: float = 0.7
) -> Light:
    """Light from above and the front, with at least `darkest` ambient and at most `brightest` directional light."""
    lamp = rng.normal(0, 1, 3) * (1.0, 0.6, 0.4) + (0, -0.2, -frontal)
    return Light(rng.uniform(darkest, 1.0), rng.uniform(0.0, brightest), lamp / np.linalg.norm(lamp))


def render_samples(
    head: IctHead,
    model: PointDistributionModel,
    photo: Photo,
    backgrounds: list[Photo],
    count: int,
    rng: np.random.Generator,
    weight: float,
    speaking: bool = False,
) -> Samples:
    """Return `count` re-projections of one photo; `speaking` with mouths that speak and tongues as bright as lips."""
    skinned = skin_photo(head, model, photo, rng)
    tongue = (0.4, 1.3) if speaking else (0.35, 0.75)
    rows = []
    for _ in range(count):
        expression = personal_expression(head, skinned, rng, sample_speech if speaking else sample_expression)
        pose = random_pose(rng)
        light = random_light(rng)
        # Most eyes look about ahead; some into a corner, where the white of the eye is not a lid.
        gaze = tuple(rng.normal(0, 0.02 if rng.random() < 0.6 else 0.06, 2) * (1.0, 0.5))
        scene = Scene(light, rng.uniform(0, 0.12), gaze, tongue)
        picture = render(head, skinned, expression, pose, SIZE, scene, rng)
        image = composed(picture, skinned, head, backgrounds, rng)
        image = crease(image, picture.landmarks, SCALE, dict(zip(head.names, expression, strict=True)), rng)
        image = dress(image, picture.landmarks, SCALE, rng)
        visible = picture.visible
        if rng.random() < 0.2:
            image, hidden = occlude(image, picture.landmarks, rng)
            visible = visible & ~hidden
        rows.append((degrade(image, rng), picture.landmarks, visible, pose, weight))
    return _stack(model, rows)


def personal_expression(
    head: IctHead,
    skinned: SkinnedHead,
    rng: np.random.Generator,
    sample: Callable[[IctHead, np.random.Generator], np.ndarray],
) -> np.ndarray:
    """A random expression (E,), with blinks scaled so that 1 shuts this person's eyes."""
    expression = sample(head, rng)
    if rng.random() < 0.15:
        expression[head.both("eyeBlink")] = 1.0
    for side, shut in skinned.blink.items():
        expression[head.index(f"eyeBlink_{side}")] *= shut
        expression[head.index(f"eyeWide_{side}")] *= expression[head.index(f"eyeBlink_{side}")] < 0.1
    return expression


def photo_samples(
    model: PointDistributionModel, photo: Photo, count: int, rng: np.random.Generator, weight: float
) -> Samples:
    """Return `count` degraded copies of a labelled photo, half of them mirrored."""
    rows = []
    grey = photo.grey()
    for i in range(count):
        picture, points = mirrored(grey, photo.landmarks) if i % 2 else (grey, photo.landmarks)
        image, landmarks, pose = canonical_photo(model, picture, points)
        image = degrade(image, rng) if i > 1 else image
        rows.append((image, landmarks, np.ones(len(landmarks), bool), pose, weight))
    return _stack(model, rows)

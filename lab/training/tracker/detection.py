"""Input of the face detector in training: scenes with faces of any size from any side, and scenes without faces.

Re-projections show faces from all sides up to the full profile, photos show real hair, clothes and backgrounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.tracking.network import LARGEST, OUTPUTS, SMALLEST, STRIDE, UNIT
from facemime.core.tracking.pdm import PointDistributionModel

from .checks import surface
from .dress import dress
from .heads import IctHead, sample_expression
from .reproject import Scene, render, skin_head
from .samples import CENTRE, SCALE, SIZE, Stack, backdrop, canonical_photo, degrade, personal_expression, random_light
from .sources import Photo

SCENE = 160
"""Side of a scene in pixels; a multiple of 16."""
_HALF = SIZE // 2
"""Side of a stored image; an outer-eye distance is `SCALE` / 2 pixels in it."""
_FARTHEST_YAW = 1.65
"""Largest yaw in radians, slightly beyond the profile."""
_POSITIVE, _UNCERTAIN = 0.3, 0.65
"""Distances from the middle of a face, in outer-eye distances, up to which a cell shows it, and up to which it may."""
_PLAIN, _REAL, _CUT_OUT = 0.15, 0.45, 0.5
"""Shares of scenes without a face, of faces from photos, and of renders that are cut out of their background."""
_TILT = 0.45
"""Standard deviation of a head's roll in radians."""
_PIECES, _WALLS = 2, 600
"""Numbers of pieces beside the face of each photo, and of walls, that scenes are made of."""
_COARSEST = 0.7
"""Smallest share of its size to which a scene is reduced, as by a webcam's codec."""


@dataclass
class Heads(Stack):
    """Images (N, 136, 136) uint8 of a face in the middle, the area that it covers (bool), and its poses (N, 6) there.

    Photos cover their whole image.
    """

    images: np.ndarray
    covered: np.ndarray
    poses: np.ndarray
    real: np.ndarray


@dataclass(frozen=True)
class SceneBatch:
    """Scenes (B, 1, S, S), and for each cell of the network whether it shows a face (B, 1, h, w), its weight, and the
    values to be found (B, 7, h, w). All are float32.
    """

    pictures: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    found: np.ndarray


def heads_of(head: IctHead, model: PointDistributionModel, photo: Photo, count: int, rng: np.random.Generator) -> Heads:
    """Return the photo, and `count` re-projections of it."""
    rows = [_real(model, photo)]
    grey, landmarks = photo.grey(), photo.landmarks
    skinned = skin_head(head, model, grey, landmarks, acting=not photo.by_hand)
    for _ in range(count):
        yaw = rng.normal(0, 0.3) if rng.random() < 0.3 else rng.uniform(-_FARTHEST_YAW, _FARTHEST_YAW)
        pose = np.array([SCALE, np.clip(rng.normal(0, 0.3), -0.8, 0.8), yaw, 0.0, CENTRE, CENTRE])
        light = random_light(rng, frontal=0.5)
        expression = personal_expression(head, skinned, rng, sample_expression)
        picture = render(head, skinned, expression, pose, SIZE, Scene(light, rng.uniform(0, 0.12)), rng)
        behind = backdrop(skinned, picture.landmarks, head, background_piece(grey, landmarks, rng), rng)
        image, covered = _with_hair(
            np.where(picture.covered, picture.image, behind), picture.covered, picture.landmarks, rng
        )
        image = dress(image, picture.landmarks, SCALE, rng)
        fitted = model.fit(picture.landmarks, noise=0.008, start=pose, iterations=8).pose
        rows.append((image, covered, fitted, False))
    return _stack(rows)


def _real(model: PointDistributionModel, photo: Photo) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    image, _, pose = canonical_photo(model, photo.grey(), photo.landmarks)
    return image, np.ones_like(image, bool), pose, True


def _stack(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]) -> Heads:
    images, covered, poses, real = zip(*rows, strict=True)
    half = (_HALF, _HALF)
    poses = np.float32(poses) * np.float32([0.5, 1, 1, 1, 0.5, 0.5]) - np.float32([0, 0, 0, 0, 0.25, 0.25])
    return Heads(
        np.stack([cv2.resize(image, half, interpolation=cv2.INTER_AREA) for image in images]),
        np.stack([cv2.resize(c.astype(np.uint8), half, interpolation=cv2.INTER_AREA) > 0 for c in covered]),
        poses,
        np.array(real),
    )


def background_piece(grey: np.ndarray, landmarks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return what a photo shows beside the face: its left, its right, or the area below."""
    left, right = (int(np.clip(v, 8, grey.shape[1] - 8)) for v in (landmarks[:, 0].min(), landmarks[:, 0].max()))
    low = int(np.clip(landmarks[:, 1].max(), 8, grey.shape[0] - 8))
    pieces = [grey[:, :left], grey[:, right:], grey[low:]]
    piece = pieces[rng.integers(3)]
    return cv2.resize(piece, (SIZE, SIZE)) if min(piece.shape) < 12 else piece


def _with_hair(
    image: np.ndarray, covered: np.ndarray, points: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw hair or a hat on top and at the back of most heads, whose skin is stretched there; return where."""
    if rng.random() < 0.3:
        return image, covered
    columns = np.flatnonzero(covered.any(axis=0))
    middle, top = (columns[0] + columns[-1]) / 2.0, float(np.flatnonzero(covered.any(axis=1))[0])
    brow = float(points[17:27, 1].min()) - SCALE * rng.uniform(0.1, 0.45)
    wide = (columns[-1] - columns[0]) / 2.0 * rng.uniform(0.9, 1.25)
    high = (brow - top) * rng.uniform(0.9, 1.4) + SCALE * rng.uniform(0.1, 1.2)
    mask = np.zeros_like(image)
    cv2.ellipse(mask, (int(middle), int(top + high * 0.85)), (int(wide), max(int(high), 4)), 0, 0, 360, 255, -1)
    face = np.zeros_like(image)
    hull = cv2.convexHull(np.float32(np.vstack([points, points[17:27] - (0, points[17:27, 1].min() - brow)])))
    cv2.fillPoly(face, [np.round(hull).astype(np.int32)], 255)
    shown = cv2.bitwise_and(mask, cv2.bitwise_not(cv2.dilate(face, np.ones((5, 5), np.uint8))))
    strands = cv2.GaussianBlur(rng.normal(0, 1, image.shape).astype(np.float32), (0, 0), 0.8, sigmaY=6.0)
    hair = rng.uniform(5, 200) + strands / strands.std() * rng.uniform(2, 30)
    share = cv2.GaussianBlur(shown, (0, 0), 1.5).astype(np.float32) / 255.0
    out = np.clip(image * (1 - share) + hair * share, 0, 255).astype(np.uint8)
    return out, covered | (shown > 0)


def surfaces(photos: list[Photo], rng: np.random.Generator) -> list[np.ndarray]:
    """Return images without a face, at most as large as a scene: surroundings of faces in photos, and walls."""
    pieces = [background_piece(photo.grey(), photo.landmarks, rng) for photo in photos for _ in range(_PIECES)]
    pieces += [surface(rng) for _ in range(_WALLS)]
    out = []
    for piece in pieces:
        factor = min(1.0, SCENE / max(piece.shape))
        out.append(cv2.resize(piece, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))
    return out


class Scenes:
    """Draws scenes from heads and from surfaces without a face."""

    def __init__(self, heads: Heads, surfaces: list[np.ndarray], rng: np.random.Generator) -> None:
        self._heads, self._surfaces, self._rng = heads, surfaces, rng
        self._real, self._rendered = np.flatnonzero(heads.real), np.flatnonzero(~heads.real)

    def draw(self, count: int) -> SceneBatch:
        """Return `count` scenes and the values to be found in them."""
        cells = SCENE // STRIDE
        batch = SceneBatch(
            np.empty((count, 1, SCENE, SCENE), np.float32),
            np.zeros((count, 1, cells, cells), np.float32),
            np.ones((count, 1, cells, cells), np.float32),
            np.zeros((count, len(OUTPUTS), cells, cells), np.float32),
        )
        for row in range(count):
            image, poses = self._scene()
            batch.pictures[row, 0] = (degrade(image, self._rng, _COARSEST).astype(np.float32) - 128.0) / 64.0
            for pose in poses:
                mark(batch, row, pose)
        return batch

    def _scene(self) -> tuple[np.ndarray, list[np.ndarray]]:
        rng = self._rng
        image, poses = self._backdrop(), []
        if rng.random() < _PLAIN:
            return image, poses
        for _ in range(int(rng.choice([1, 2, 3], p=[0.45, 0.35, 0.2]))):
            size = float(np.exp(rng.uniform(np.log(0.75 * SMALLEST), np.log(1.2 * LARGEST))))
            x, y = rng.uniform(-0.05 * SCENE, 1.05 * SCENE, 2)
            if all(np.hypot(x - p[4], y - p[5]) > 1.6 * max(size, p[0]) for p in poses):
                image, pose = self._placed(image, size, np.array([x, y]))
                poses.append(pose)
        return image, poses

    def _backdrop(self) -> np.ndarray:
        """Return one or several surfaces, with edges between them."""
        rng = self._rng
        image = self._surface((SCENE, SCENE))
        for _ in range(int(rng.integers(0, 5))):
            w, h = (int(v) for v in np.exp(rng.uniform(np.log(10), np.log(SCENE), 2)))
            x, y = rng.integers(0, SCENE - 5, 2).tolist()
            part = self._surface((w, h))
            h, w = min(h, SCENE - y), min(w, SCENE - x)
            image[y : y + h, x : x + w] = part[:h, :w]
        for _ in range(int(rng.integers(0, 4))):
            ends = rng.integers(0, SCENE, 4).tolist()
            cv2.line(image, ends[:2], ends[2:], int(rng.integers(256)), int(rng.integers(1, 12)))
        return image

    def _surface(self, size: tuple[int, int]) -> np.ndarray:
        piece = self._surfaces[self._rng.integers(len(self._surfaces))]
        return cv2.resize(piece, size, interpolation=cv2.INTER_AREA)

    def _placed(self, image: np.ndarray, size: float, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Add a head of that size in pixels, its middle at `place`, to the image; also return the head's pose (6,)."""
        rng, heads = self._rng, self._heads
        rows = self._real if rng.random() < _REAL else self._rendered
        i = rows[rng.integers(len(rows))]
        picture, covered, pose = heads.images[i], heads.covered[i], heads.poses[i].astype(np.float64)
        if rng.random() < 0.5:
            picture, covered = picture[:, ::-1], covered[:, ::-1]
            pose[[2, 3, 4]] = -pose[2], -pose[3], _HALF - 1 - pose[4]
        roll = float(np.clip(rng.normal(0, _TILT), -2.5 * _TILT, 2.5 * _TILT))
        gain = size / pose[0]
        c, s = gain * np.cos(roll - pose[3]), gain * np.sin(roll - pose[3])
        linear = np.array([[c, -s], [s, c]])
        matrix = np.column_stack([linear, place - linear @ pose[4:6]])
        cut_out = not heads.real[i] and rng.random() < _CUT_OUT
        mask = covered.astype(np.float32) if cut_out else _patch_mask(rng)
        if gain < 0.5:
            picture, mask = (cv2.GaussianBlur(v, (0, 0), 0.3 / gain) for v in (picture, mask))
        where = {"M": matrix, "dsize": (SCENE, SCENE)}
        shown = cv2.warpAffine(np.ascontiguousarray(picture), **where, borderMode=cv2.BORDER_REPLICATE)
        share = cv2.warpAffine(np.ascontiguousarray(mask), **where)
        out = (image * (1 - share) + shown * share).astype(np.uint8)
        return out, np.array([size, pose[1], pose[2], roll, *place])


def _patch_mask(rng: np.random.Generator) -> np.ndarray:
    """Visible share of an image, (136, 136): all of it, or an ellipse with soft edges around head and shoulders."""
    mask = np.zeros((_HALF, _HALF), np.float32)
    if rng.random() < 0.5:
        edge = rng.integers(1, 14, 4)
        mask[edge[0] : _HALF - edge[1], edge[2] : _HALF - edge[3]] = 1.0
        return mask
    axes = (int(rng.uniform(42, 64)), int(rng.uniform(52, 66)))
    cv2.ellipse(mask, (_HALF // 2, _HALF // 2), axes, 0, 0, 360, 1.0, -1)
    return cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 5.0))


def mark(batch: SceneBatch, row: int, pose: np.ndarray) -> None:
    """Mark the cells that show a face of pose (6,), in pixels of the scene."""
    size, pitch, yaw, roll, x, y = pose
    cells = SCENE // STRIDE
    middles = (np.arange(cells) + 0.5) * STRIDE - 0.5
    dx, dy = x - middles[None, :], y - middles[:, None]
    away = np.hypot(dx, dy)
    uncertain = away < _UNCERTAIN * size
    batch.weights[row, 0][uncertain] = 0.0
    if not SMALLEST <= size <= LARGEST or not (0 <= x < SCENE and 0 <= y < SCENE):
        return
    shown = (away < _POSITIVE * size) | (away == away.min())
    batch.face[row, 0][shown] = 1.0
    batch.weights[row, 0][shown] = 1.0
    values = [dx / UNIT, dy / UNIT, np.log(size / UNIT), np.cos(roll), np.sin(roll), np.sin(yaw), np.sin(pitch)]
    for k, value in enumerate(values):
        batch.found[row, k][shown] = np.broadcast_to(value, shown.shape)[shown]

"""Clothing and hair drawn onto training images: made-up eyes, glasses, moustaches and beards.

Few of the photos show them, and each misleads a network in its own way: lashes and rims look like brows, the edge of a
moustache like the opening of the mouth.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, JAW, LOWER_LIP, MOUTH_OUTER, UPPER_LIP, from_ibug

from .drawing import line

_UPPER_LIDS = tuple(from_ibug(numbers) for numbers in (range(36, 40), range(42, 46)))
_LOWER_LIDS = tuple(from_ibug(numbers) for numbers in ((36, 41, 40, 39), (42, 47, 46, 45)))
_NOSTRILS = from_ibug(range(31, 36))


def dress(image: np.ndarray, landmarks: np.ndarray, unit: float, rng: np.random.Generator) -> np.ndarray:
    """Return a grey image with clothing and hair, or nothing, drawn onto it; `unit` is pixels per outer-eye distance.

    The landmarks (66, 2) are in pixels.
    """
    wardrobe: tuple[tuple[float, Callable[..., np.ndarray]], ...] = (
        (0.25, _lashes),
        (0.12, beard),
        (0.18, _glasses),
    )
    for share, draw in wardrobe:
        if rng.random() < share:
            image = draw(image, landmarks, unit, rng)
    return image


def blend(image: np.ndarray, mask: np.ndarray, level: np.ndarray | float, strength: float) -> np.ndarray:
    share = mask.astype(np.float32) * (strength / 255.0)
    out: np.ndarray = np.clip(image * (1.0 - share) + level * share, 0, 255).astype(np.uint8)
    return out


def _along(points: np.ndarray, count: int) -> np.ndarray:
    """Points (count, 2) spaced evenly along a curve through `points` (n, 2)."""
    x = np.linspace(0.0, len(points) - 1.0, count)
    return np.stack([np.interp(x, np.arange(len(points)), points[:, k]) for k in (0, 1)], axis=1)


def _lashes(image: np.ndarray, landmarks: np.ndarray, unit: float, rng: np.random.Generator) -> np.ndarray:
    """Draw eyeliner, lashes that reach towards the brow, and shadow above the lid."""
    mask, shade = np.zeros_like(image), np.zeros_like(image)
    length, wing, below = unit * rng.uniform(0.02, 0.09), rng.uniform(0.0, 0.12), rng.random() < 0.4
    thick = max(1, round(unit * rng.uniform(0.005, 0.03)))
    for side, (upper, lower, eye) in enumerate(zip(_UPPER_LIDS, _LOWER_LIDS, (EYE_RIGHT, EYE_LEFT), strict=True)):
        curve = _along(landmarks[upper], int(rng.integers(9, 20)))
        outwards = np.array([-1.0 if side == 0 else 1.0, 0.0])
        across = landmarks[upper[-1]] - landmarks[upper[0]]
        up = np.array([across[1], -across[0]]) / max(float(np.hypot(*across)), 1e-6)
        line(mask, np.vstack([curve, curve[-1] + wing * unit * (outwards + up)]) if side else curve, thick)
        middle = landmarks[eye].mean(axis=0)
        for root in curve:
            lean = 0.8 * (root - middle) / (0.15 * unit) * np.array([1.0, 0.0])
            line(mask, np.stack([root, root + length * (up + lean)]), 1)
        if below:
            for root in _along(landmarks[lower], 9):
                line(mask, np.stack([root, root - 0.5 * length * up]), 1)
        lid = np.vstack([curve, curve[::-1] + up * unit * rng.uniform(0.04, 0.13)])
        cv2.fillPoly(shade, [np.round(lid).astype(np.int32)], 255)
    shade = cv2.GaussianBlur(shade, (0, 0), 0.02 * unit)
    image = blend(image, shade, rng.uniform(0.0, 160.0), rng.uniform(0.0, 0.6))
    return blend(image, mask, rng.uniform(0.0, 40.0), rng.uniform(0.5, 1.0))


def _glasses(image: np.ndarray, landmarks: np.ndarray, unit: float, rng: np.random.Generator) -> np.ndarray:
    """Draw rims of any thickness with a bridge and temples, and tinted or mirroring lenses."""
    rim, lens = np.zeros_like(image), np.zeros_like(image)
    thick = max(1, round(unit * rng.uniform(0.008, 0.06)))
    wide, high = unit * rng.uniform(0.2, 0.3), unit * rng.uniform(0.13, 0.24)
    drop = unit * np.array([0.0, rng.uniform(-0.02, 0.08)])
    roundness, rimless = rng.uniform(2.0, 5.0), rng.random() < 0.15
    middles = []
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    c, s = np.cos(angle), np.sin(angle)
    outline = np.stack(
        [wide * np.sign(c) * np.abs(c) ** (2 / roundness), high * np.sign(s) * np.abs(s) ** (2 / roundness)], 1
    )
    across = landmarks[EYE_LEFT].mean(axis=0) - landmarks[EYE_RIGHT].mean(axis=0)
    along = across / max(float(np.hypot(*across)), 1e-6)
    # The lenses of a turned face are narrowed like the distance between its eyes.
    narrow = float(np.clip(np.hypot(*across) / (0.68 * unit), 0.3, 1.1))
    turn = np.array([[along[0], along[1]], [-along[1], along[0]]])
    for eye in (EYE_RIGHT, EYE_LEFT):
        middle = landmarks[eye].mean(axis=0) + drop
        edge = middle + (outline * (narrow, 1.0)) @ turn
        cv2.fillPoly(lens, [np.round(edge).astype(np.int32)], 255)
        line(rim, edge[20:] if rimless else edge, thick)  # the upper half, or all round
        middles.append(middle)
    inner = wide * narrow * along
    line(rim, np.stack([middles[0] + inner, middles[1] - inner]), thick)
    for middle, way, end in ((middles[0], -1.0, landmarks[JAW[0]]), (middles[1], 1.0, landmarks[JAW[-1]])):
        line(rim, np.stack([middle + way * inner, end]), thick)
    if rng.random() < 0.35:
        image = blend(image, lens, rng.uniform(0.0, 255.0), rng.uniform(0.05, 0.45))
    if rng.random() < 0.35:
        glare = np.zeros_like(image)
        for middle in middles:
            at = middle + rng.normal(0, 0.08, 2) * unit
            size = (int(unit * rng.uniform(0.02, 0.12)), int(unit * rng.uniform(0.02, 0.08)))
            cv2.ellipse(glare, tuple(int(v) for v in at), size, rng.uniform(0, 180), 0, 360, 255, -1)
        soft = cv2.GaussianBlur(cv2.bitwise_and(glare, lens), (0, 0), 1.0)
        image = blend(image, soft, 255.0, rng.uniform(0.2, 0.8))
    return blend(image, rim, rng.uniform(0.0, 255.0) if rng.random() < 0.3 else rng.uniform(0.0, 60.0), 0.95)


def beard(image: np.ndarray, landmarks: np.ndarray, unit: float, rng: np.random.Generator) -> np.ndarray:
    """Draw hair between nose and mouth or around the chin, over the rim of the upper lip but not inside the mouth."""
    mask = np.zeros_like(image)
    upper, lower = landmarks[UPPER_LIP], landmarks[LOWER_LIP]
    kind = rng.random()
    if kind < 0.75:  # a moustache, down to some way across the upper lip
        inner = landmarks[from_ibug((61, 61, 62, 63, 63))]
        down = upper + rng.uniform(-0.1, 0.9) * (inner - upper)
        corners = landmarks[from_ibug((48, 54))] + unit * rng.uniform(-0.02, 0.05) * np.array([[-1.0, 0.5], [1.0, 0.5]])
        top = upper + rng.uniform(0.3, 0.9) * (landmarks[_NOSTRILS] - upper)
        hair = np.vstack([corners[:1], top, corners[1:], down[::-1]])
        cv2.fillPoly(mask, [np.round(hair).astype(np.int32)], 255)
    if kind > 0.4:  # a beard below the mouth, along the jaw
        jaw = landmarks[JAW[3:14]]
        cheek = _along(np.vstack([jaw[0], landmarks[from_ibug((48,))] + (0.0, 0.02 * unit), lower]), 8)
        other = _along(np.vstack([lower[-1:], landmarks[from_ibug((54,))] + (0.0, 0.02 * unit), jaw[-1:]]), 5)
        beard = np.vstack([cheek, other, jaw[::-1]])
        below = np.zeros_like(image)
        cv2.fillPoly(below, [np.round(beard).astype(np.int32)], 255)
        cv2.fillPoly(below, [np.round(landmarks[MOUTH_OUTER]).astype(np.int32)], 0)
        mask = cv2.max(mask, below)
    mask = cv2.GaussianBlur(mask, (0, 0), unit * rng.uniform(0.004, 0.02))
    grain = rng.normal(0.0, 1.0, image.shape).astype(np.float32)
    strands = cv2.GaussianBlur(grain, (0, 0), sigmaX=0.5, sigmaY=rng.uniform(0.8, 2.5))
    level = rng.uniform(0.0, 90.0) if rng.random() < 0.8 else rng.uniform(90.0, 220.0)
    hair = level + strands / max(float(strands.std()), 1e-6) * rng.uniform(5.0, 40.0)
    return blend(image, mask, hair, rng.uniform(0.3, 1.0))

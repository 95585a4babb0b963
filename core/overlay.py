"""Landmarks drawn over a picture, and pictures put side by side."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray
from .landmarks import EDGES

Image = NDArray[np.uint8]

_LINE = (80, 220, 120)
_POINT = (255, 255, 255)
_TEXT = (235, 235, 235)
_SHIFT = 4


def draw_landmarks(image: Image, landmarks: FloatArray, thickness: float | None = None) -> Image:
    """Return a copy of a BGR `image` with (66, 2) `landmarks` in pixels drawn over it; untouched where they are NaN."""
    canvas = image.copy()
    if not np.isfinite(landmarks).all():
        return canvas
    extent = float(np.ptp(landmarks, axis=0).max())
    width = max(1, round(thickness if thickness is not None else extent / 220.0))
    fixed = np.round(np.clip(landmarks, -1e4, 1e4) * (1 << _SHIFT)).astype(np.int32)
    for a, b in EDGES:
        cv2.line(canvas, fixed[a].tolist(), fixed[b].tolist(), _LINE, width, cv2.LINE_AA, _SHIFT)
    radius = max(1, round(extent / 150.0)) << _SHIFT
    for point in fixed:
        cv2.circle(canvas, point.tolist(), radius, _POINT, -1, cv2.LINE_AA, _SHIFT)
    return canvas


def fit_into(image: Image, width: int, height: int, background: int = 24) -> Image:
    """Return `image` scaled to fit (height, width) and centred on a plain background."""
    scale = min(width / image.shape[1], height / image.shape[0])
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    canvas = np.full((height, width, 3), background, dtype=np.uint8)
    top, left = (height - size[1]) // 2, (width - size[0]) // 2
    canvas[top : top + size[1], left : left + size[0]] = resized
    return canvas


def crop_face(image: Image, landmarks: FloatArray, side: int, margin: float = 0.45) -> Image:
    """Return the square round (66, 2) `landmarks`, `margin` of the face's size wider on each side, as (side, side)."""
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    centre = (low + high) / 2 - (0.0, 0.12 * float(high[1] - low[1]))
    half = float((high - low).max()) * (0.5 + margin)
    scale = side / (2 * half)
    warp = np.array([[scale, 0, side / 2 - scale * centre[0]], [0, scale, side / 2 - scale * centre[1]]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.warpAffine(image, warp, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def label(image: Image, text: str) -> Image:
    """Return a copy of `image` with `text` in its lower left corner."""
    canvas = image.copy()
    scale = max(0.4, image.shape[0] / 640.0)
    place = (round(12 * scale), image.shape[0] - round(14 * scale))
    for colour, width in (((0, 0, 0), 4), (_TEXT, 1)):
        cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, width, cv2.LINE_AA)
    return canvas


def contact_sheet(pairs: Sequence[tuple[Image, Image]], columns: int = 3, gap: int = 10, background: int = 24) -> Image:
    """Return pairs of equally sized pictures as a grid, the two of each pair touching."""
    tiles = [np.hstack(pair) for pair in pairs]
    height, width = tiles[0].shape[:2]
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    shape = (rows * height + (rows + 1) * gap, columns * width + (columns + 1) * gap, 3)
    sheet = np.full(shape, background, dtype=np.uint8)
    for i, tile in enumerate(tiles):
        top = gap + (i // columns) * (height + gap)
        left = gap + (i % columns) * (width + gap)
        sheet[top : top + height, left : left + width] = tile
    return sheet

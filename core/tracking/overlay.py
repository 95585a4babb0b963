"""Drawing of landmarks over images, and of images side by side."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import EDGES
from ..numeric.arrays import FloatArray
from .result import TrackResult

Image = NDArray[np.uint8]
"""(H, W, 3), BGR."""

_LINE = (80, 220, 120)
_POINT = (255, 255, 255)
_TEXT = (235, 235, 235)
_BACKGROUND = (24, 24, 24)
_LINEAR = (np.arange(256) / 255.0) ** np.float32(2.2)
_SURE = np.array((90.0, 230.0, 90.0))
"""Colour of a landmark whose confidence is 1, BGR."""
_GUESSED = np.array((60.0, 60.0, 240.0))
"""Colour of a landmark whose confidence is 0, BGR."""
_SHIFT = 4
_THIN = 110.0
"""Size of a face relative to the radius of its landmarks in a preview, chosen so that the lids stay visible."""
_RADII = (0.7, 3.0)
"""Smallest and largest radius of a landmark in a preview, in pixels."""


def draw_landmarks(image: Image, landmarks: FloatArray) -> Image:
    """Draw landmarks (66, 2), in pixels, over a copy of an image; nothing is drawn if any is NaN."""
    canvas = image.copy()
    if not np.isfinite(landmarks).all():
        return canvas
    extent = float(np.ptp(landmarks, axis=0).max())
    width = max(1, round(extent / 280.0))
    radius = round(np.clip(extent / 170.0, 0.8, 12.0) * (1 << _SHIFT))
    fixed = np.round(np.clip(landmarks, -1e4, 1e4) * (1 << _SHIFT)).astype(np.int32)
    for a, b in EDGES:
        cv2.line(canvas, fixed[a].tolist(), fixed[b].tolist(), _LINE, width, cv2.LINE_AA, _SHIFT)
    for point in fixed:
        cv2.circle(canvas, point.tolist(), radius, _POINT, -1, cv2.LINE_AA, _SHIFT)
    return canvas


def draw_frame(image: Image, landmarks: FloatArray, width: int, height: int) -> Image:
    """Scale a frame to fit into `width` by `height` pixels, and draw its landmarks at that size.

    The landmarks (66, 2) are in pixels of `image`. What it does not cover is background.
    """
    scale = min(width / image.shape[1], height / image.shape[0])
    centre = np.array([image.shape[1], image.shape[0]]) / 2.0
    return _scaled(image, landmarks, scale, centre, width, height)


def draw_face(image: Image, landmarks: FloatArray, side: int, margin: float = 0.35) -> Image:
    """Crop a square of `side` pixels around a face, and draw its landmarks at the size of the crop.

    The landmarks are as for `draw_frame`; `margin`, on each side, is a share of their extent.
    """
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    centre = (low + high) / 2.0 - (0.0, 0.12 * float(high[1] - low[1]))
    scale = side / (float((high - low).max()) * (1.0 + 2.0 * margin))
    return _scaled(image, landmarks, scale, centre, side, side)


def _scaled(image: Image, landmarks: FloatArray, scale: float, centre: FloatArray, width: int, height: int) -> Image:
    offset = np.array([width, height]) / 2.0 - scale * centre
    if scale < 1:  # warpAffine alone would alias
        blur = 0.5 / scale
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.6 * blur), dtype=np.uint8)
    warp = np.array([[scale, 0.0, offset[0]], [0.0, scale, offset[1]]])
    scaled = cv2.warpAffine(image, warp, (width, height), flags=cv2.INTER_CUBIC, borderValue=_BACKGROUND)
    return draw_landmarks(np.asarray(scaled, dtype=np.uint8), scale * landmarks + offset)


def draw_preview(image: Image | None, results: Sequence[TrackResult], width: int) -> NDArray[np.float32] | None:
    """Draw a frame at `width` pixels with landmarks coloured by confidence from red to green; None without an image.

    Returns (h, width, 4) RGBA, 0 to 1, linear light, bottom row first, as a GPU expects.
    """
    if image is None:
        return None
    scale = width / image.shape[1]
    size = (width, max(1, round(image.shape[0] * scale)))
    canvas = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    for result in results:
        if not result.found:
            continue
        sure = np.sqrt(np.nan_to_num(result.landmark_confidence, nan=1.0))[:, None]
        colours = (1.0 - sure) * _GUESSED + sure * _SURE
        fixed = np.round(np.clip(scale * result.landmarks, -1e4, 1e4) * (1 << _SHIFT)).astype(np.int32)
        thin = scale * float(np.ptp(result.landmarks, axis=0).max()) / _THIN
        radius = round(np.clip(thin, *_RADII) * (1 << _SHIFT))
        for point, colour in zip(fixed.tolist(), colours.tolist(), strict=True):
            cv2.circle(canvas, point, radius, colour, -1, cv2.LINE_AA, _SHIFT)
    return picture_for_gpu(canvas)


def picture_for_gpu(image: Image) -> NDArray[np.float32]:
    """Convert an image to RGBA (H, W, 4), 0 to 1, linear light, bottom row first."""
    return np.asarray(_LINEAR[cv2.cvtColor(image[::-1], cv2.COLOR_BGR2RGBA)], dtype=np.float32)


def draw_label(image: Image, text: str) -> Image:
    """Draw text in the lower left corner of a copy of an image."""
    canvas = image.copy()
    scale = max(0.4, image.shape[0] / 640.0)
    place = (round(12 * scale), image.shape[0] - round(14 * scale))
    for colour, width in (((0, 0, 0), 4), (_TEXT, 1)):
        cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, width, cv2.LINE_AA)
    return canvas


def contact_sheet(pairs: Sequence[tuple[Image, Image]], columns: int = 3, gap: int = 10) -> Image:
    """Arrange pairs of images of one size in rows of `columns`, `gap` pixels apart, the two of each pair touching."""
    tiles = [np.hstack(pair) for pair in pairs]
    height, width = tiles[0].shape[:2]
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    shape = (rows * height + (rows + 1) * gap, columns * width + (columns + 1) * gap, 3)
    sheet = np.full(shape, _BACKGROUND, dtype=np.uint8)
    for i, tile in enumerate(tiles):
        top = gap + (i // columns) * (height + gap)
        left = gap + (i % columns) * (width + gap)
        sheet[top : top + height, left : left + width] = tile
    return sheet

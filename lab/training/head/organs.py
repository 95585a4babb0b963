"""Textures of the eye, the teeth and the tongue."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .canvas import Image, cloud, fade, mix, noise
from .complexion import Complexion

_EYE_SIZE = 512
_MOUTH_SIZE = (256, 1024)
_HAIR_SIZE = (256, 512)
HAIR_COLUMNS, BROW_COLUMNS, LASH_COLUMNS = (0.02, 0.78), (0.84, 0.88), (0.94, 0.98)
"""Parts of the texture's width that show the hair of the scalp, the hairs of the brows, and the lashes."""


def paint_eye(iris: float, look: Complexion) -> NDArray[np.uint8]:
    """Texture of an eye centred on the pupil, (512, 512, 3) BGR; `iris` is its radius as a share of the side."""
    x, y, place = _plane((_EYE_SIZE, _EYE_SIZE))
    radius, angle = np.hypot(x, y) / iris, np.arctan2(y, x)
    image = np.empty((_EYE_SIZE, _EYE_SIZE, 3), np.float32)
    image[:] = (0.880, 0.855, 0.830)
    mix(image, (0.80, 0.60, 0.55), 0.65 * fade(radius, 1.35, 3.2))
    veins = 1.0 - np.abs(cloud(place, 0.12, 3, 5))
    mix(image, (0.72, 0.30, 0.27), 0.40 * fade(veins, 0.93, 1.0) * fade(radius, 1.25, 2.4))
    ring = np.stack([np.cos(angle) * 6.0, np.sin(angle) * 6.0, radius * 0.55], axis=-1).astype(np.float32)
    fibres = noise(ring, 0.22, 6) + 0.6 * noise(ring, 0.10, 7)
    tint = np.empty_like(image)
    tint[:] = look.iris
    mix(tint, look.iris_inner, fade(radius, 0.80, 0.42))
    tint *= 1.0 + 0.26 * fibres[..., None]
    mix(tint, look.iris_edge, fade(radius, 0.74, 0.99))
    mix(tint, (0.62, 0.44, 0.22), 0.30 * np.exp(-(((radius - 0.52) / 0.08) ** 2)) * (0.6 + 0.4 * fibres))
    mix(image, tint, fade(radius, 1.05, 0.95))
    mix(image, (0.015, 0.012, 0.012), fade(radius, 0.43, 0.37))
    catch = np.hypot(x / iris + 0.36, y / iris + 0.20)
    lid_shade = fade((y / iris), -0.35, -1.5) * 0.45 + 0.10 * fade((y / iris), 0.9, 1.6)
    image *= 1.0 - lid_shade[..., None]
    mix(image, (1.0, 1.0, 1.0), 0.80 * fade(catch, 0.17, 0.10))
    return _finish(image)


def paint_teeth(count: int) -> NDArray[np.uint8]:
    """Texture of the teeth, (256, 1024, 3) BGR: upper teeth in the upper half, gum above; lower teeth mirrored."""
    height, width = _MOUTH_SIZE
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    place = np.stack([u / 400.0, v / 400.0, np.zeros_like(u)], axis=-1)
    across = (u / width * count) % 1.0
    down = np.where(v < height / 2, v, height - 1 - v) / (height / 2)
    image = np.empty((height, width, 3), np.float32)
    image[:] = (0.890, 0.850, 0.760)
    mix(image, (0.93, 0.91, 0.86), fade(down, 0.45, 0.60))
    image *= 1.0 + 0.02 * cloud(place, 0.05, 3, 3)[..., None]
    gap = np.minimum(across, 1.0 - across)
    mix(image, (0.42, 0.28, 0.22), 0.80 * fade(gap, 0.055, 0.005))
    gum_edge = 0.20 + 0.10 * np.abs(np.sin(np.pi * across)) ** 0.7 * -1.0 + 0.08
    gum = fade(down, gum_edge + 0.02, gum_edge - 0.02)
    mix(image, (0.70, 0.38, 0.37), gum)
    far = fade(np.abs(u / width - 0.5), 0.14, 0.36)
    image *= 1.0 - 0.80 * far[..., None]
    mix(image, (0.30, 0.12, 0.11), fade(down, 0.66, 0.82))
    return _finish(image)


def paint_tongue() -> NDArray[np.uint8]:
    """Texture of the tongue, (256, 256, 3) BGR: the upper side, from the tip to the root, in the upper half."""
    x, y, place = _plane((256, 256))
    image = np.empty((256, 256, 3), np.float32)
    image[:] = (0.690, 0.360, 0.350)
    image *= 1.0 + (0.07 * cloud(place, 0.03, 3, 8) + 0.05 * noise(place, 0.008, 9))[..., None]
    mix(image, (0.50, 0.22, 0.22), 0.5 * np.exp(-((x / 0.02) ** 2)))
    mix(image, (0.13, 0.035, 0.04), fade(y, -0.36, -0.08))  # from the tip, at the top, to the root in the dark
    return _finish(image)


def paint_hair(look: Complexion) -> NDArray[np.uint8]:
    """Texture of hair, (256, 512, 3) BGR, from the tips at the top to the roots: strands, and in the rightmost columns
    the darker ones of the brows and the lashes.
    """
    height, width = _HAIR_SIZE
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    u, v = (u + 0.5) / width, 1.0 - (v + 0.5) / height
    place = np.stack([u * 60.0, v * 1.6, np.zeros_like(u)], axis=-1)
    strands = 0.6 * noise(place, 0.9, 51) + 0.5 * noise(place, 0.35, 52)
    image = np.empty((height, width, 3), np.float32)
    image[:] = look.hair
    image *= 1.0 + (0.42 * strands + 0.35 * (v - 0.5))[..., None]
    mix(image, (0.62, 0.50, 0.40), 0.16 * fade(strands, 0.25, 0.9))
    image[:, u[0] > BROW_COLUMNS[0] - 0.02] = np.float32(look.hair) * 0.80
    image[:, u[0] > LASH_COLUMNS[0] - 0.02] = np.float32(look.hair) * 0.35
    return _finish(image)


def _plane(shape: tuple[int, int]) -> tuple[Image, Image, Image]:
    """Coordinates from the middle as shares of the width, and as positions for noise."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    x, y = (x + 0.5) / shape[1] - 0.5, (y + 0.5) / shape[0] - 0.5
    return x, y, np.stack([x, y, np.zeros_like(x)], axis=-1)


def _finish(image: Image) -> NDArray[np.uint8]:
    return np.asarray((np.clip(image[..., ::-1], 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))


def encode(image: NDArray[np.uint8], quality: int) -> bytes:
    """Encode the texture as JPEG."""
    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])
    if not ok:
        raise RuntimeError("cv2 cannot write JPEG")
    return bytes(data)

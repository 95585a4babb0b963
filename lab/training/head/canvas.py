"""Painting on the head: the surface under each texel, noise in space, and strokes drawn in the front view.

Everything is painted as a function of the place on the head rather than of the texture's layout, so that seams are
invisible, and a new layout needs no new image.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Texels:
    """The surface under each texel of a square texture.

    Attributes
    ----------
    place : (S, S, 3) float32
        Position in the head frame, metres, of the nearest covered texel.
    value : (S, S, K) float32
        Values of the vertices, interpolated.
    face : (S, S) int32
        Face of the nearest covered texel.
    """

    place: Image
    value: Image
    face: NDArray[np.int32]


def rasterise(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    uv: NDArray[np.float64],
    values: NDArray[np.float64],
    size: int,
) -> Texels:
    """Interpolate (V, 3) `vertices` and (V, K) `values` over the texture with the layout (F, 4, 2) `uv`, v up."""
    data = np.concatenate([vertices, values], axis=1).astype(np.float32)
    out = np.zeros((size, size, data.shape[1]), np.float32)
    face_map = np.full((size, size), -1, np.int32)
    pixel = np.stack([uv[..., 0] * size - 0.5, (1.0 - uv[..., 1]) * size - 0.5], axis=-1)
    for face, corners in enumerate(faces):
        for corner in ([0, 1, 2], [0, 2, 3]) if corners[3] >= 0 else ([0, 1, 2],):
            _triangle(out, face_map, pixel[face, corner], data[corners[corner]], face)
    _, nearest = cv2.distanceTransformWithLabels(
        (face_map < 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    covered = np.flatnonzero(face_map.ravel() >= 0)
    source = np.zeros(nearest.max() + 1, np.int64)
    source[nearest.ravel()[covered]] = covered
    fill = source[nearest]
    out = out.reshape(-1, out.shape[2])[fill]
    return Texels(out[..., :3], out[..., 3:], face_map.ravel()[fill])


def _triangle(
    out: Image, face_map: NDArray[np.int32], p: NDArray[np.float64], data: NDArray[np.float32], face: int
) -> None:
    low = np.maximum(np.floor(p.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(p.max(axis=0)).astype(int) + 1, len(out))
    edges = np.array([p[1] - p[0], p[2] - p[0]]).T
    if abs(np.linalg.det(edges)) < 1e-9 or (high <= low).any():
        return
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    share = np.linalg.solve(edges, np.stack([x.ravel() - p[0, 0], y.ravel() - p[0, 1]]))
    weights = np.stack([1.0 - share.sum(axis=0), *share])
    inside = (weights > -1e-6).all(axis=0)
    rows, columns = y.ravel()[inside], x.ravel()[inside]
    out[rows, columns] = weights[:, inside].T.astype(np.float32) @ data
    face_map[rows, columns] = face


def noise(place: Image, cell: float, seed: int) -> Image:
    """Smooth noise in space, from about -1 to 1, with features of `cell` metres."""
    scaled = place / np.float32(cell)
    base = np.floor(scaled)
    t = scaled - base
    t = t * t * (3.0 - 2.0 * t)
    corner = base.astype(np.int64)
    total = np.zeros(place.shape[:-1], np.float32)
    for dx in (0, 1):
        for dy in (0, 1):
            for dz in (0, 1):
                weight = np.ones_like(total)
                for axis, d in enumerate((dx, dy, dz)):
                    weight *= t[..., axis] if d else 1.0 - t[..., axis]
                total += weight * _hash(corner[..., 0] + dx, corner[..., 1] + dy, corner[..., 2] + dz, seed)
    return total


def cloud(place: Image, cell: float, octaves: int, seed: int) -> Image:
    """Noise in `octaves`, each half as large and half as strong as the one before."""
    total = np.zeros(place.shape[:-1], np.float32)
    for octave in range(octaves):
        total += noise(place, cell / 2**octave, seed + octave) * np.float32(0.5**octave)
    return total


def _hash(x: NDArray[np.int64], y: NDArray[np.int64], z: NDArray[np.int64], seed: int) -> Image:
    h = np.full(x.shape, seed * 0x9E3779B1 & 0xFFFFFFFF, np.uint32)
    for axis in (x, y, z):
        h = (h ^ axis.astype(np.uint32)) * np.uint32(0x85EBCA6B)
        h ^= h >> np.uint32(13)
        h *= np.uint32(0xC2B2AE35)
        h ^= h >> np.uint32(16)
    return (h & np.uint32(0xFFFF)).astype(np.float32) / np.float32(32767.5) - np.float32(1.0)


class FrontView:
    """An image of the face from the front, for drawing strokes in metres, and for looking them up by position."""

    def __init__(self, low: tuple[float, float], high: tuple[float, float], pixel: float) -> None:
        self.low, self.pixel = np.array(low), pixel
        width, height = np.ceil((np.array(high) - low) / pixel).astype(int)
        self.ink = np.zeros((height, width), np.float32)

    def stroke(self, points: NDArray[np.float64], width: float, strength: float) -> None:
        """Draw a tapering hair through (n, 2) `points`, x and y of the head frame, `width` metres at its root."""
        pixels = (points - self.low) / self.pixel
        layer_low = np.floor(pixels.min(axis=0) - 4).astype(int)
        layer_high = np.ceil(pixels.max(axis=0) + 4).astype(int)
        layer_low = np.maximum(layer_low, 0)
        layer_high = np.minimum(layer_high, self.ink.shape[::-1])
        if (layer_high <= layer_low).any():
            return
        layer = np.zeros(tuple((layer_high - layer_low)[::-1]), np.float32)
        for i, (a, b) in enumerate(pairwise(pixels)):
            share = 1.0 - i / (len(pixels) - 1)
            thick = max(1, round(width * share / self.pixel))
            ends = [tuple(np.round((p - layer_low) * 16).astype(int).tolist()) for p in (a, b)]
            cv2.line(layer, *ends, float(strength), thick, cv2.LINE_AA, 4)
        window = self.ink[layer_low[1] : layer_high[1], layer_low[0] : layer_high[0]]
        window += (1.0 - window) * layer

    def look_up(self, place: Image) -> Image:
        """The ink at (..., 3) positions, whatever their depth."""
        x = ((place[..., 0] - self.low[0]) / self.pixel).astype(np.float32)
        y = ((place[..., 1] - self.low[1]) / self.pixel).astype(np.float32)
        return np.asarray(cv2.remap(self.ink, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0))


def distance_to_line(place: Image, line: NDArray[np.float64], dims: int = 3) -> Image:
    """Distance of positions (..., 3) to the polyline `line` (n, 3), in the first `dims` coordinates."""
    points = place[..., :dims]
    nearest = np.full(points.shape[:-1], np.inf, np.float32)
    for a, b in zip(line[:-1, :dims].astype(np.float32), line[1:, :dims].astype(np.float32), strict=True):
        along = b - a
        t = np.clip((points - a) @ along / (along @ along + 1e-12), 0.0, 1.0)
        np.minimum(nearest, np.linalg.norm(points - (a + t[..., None] * along), axis=-1), out=nearest)
    return nearest


def distance_to_outline(place: Image, outline: NDArray[np.float64], pixel: float = 5e-5) -> Image:
    """Signed distance in the front view to a closed outline (n, 2+), positive inside; far places give -1."""
    margin = 0.006
    low = outline[:, :2].min(axis=0) - margin
    shape = np.ceil((np.ptp(outline[:, :2], axis=0) + 2 * margin) / pixel).astype(int)
    mask = np.zeros((shape[1], shape[0]), np.uint8)
    polygon = np.round((outline[:, :2] - low) / pixel * 16).astype(np.int32)
    cv2.fillPoly(mask, [polygon], 255, shift=4)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, 5) for m in (mask, 255 - mask))
    signed = ((inside - outside) * pixel).astype(np.float32)
    x = ((place[..., 0] - low[0]) / pixel).astype(np.float32)
    y = ((place[..., 1] - low[1]) / pixel).astype(np.float32)
    return np.asarray(cv2.remap(signed, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0))


def mix(image: Image, colour: tuple[float, float, float] | Image, amount: Image | float) -> None:
    """Blend `image` (..., 3) towards `colour` (0..1, or an image) by `amount`, in place."""
    share = amount[..., None] if isinstance(amount, np.ndarray) else amount
    image += (np.asarray(colour, np.float32) - image) * share


def fade(value: Image, start: float, end: float) -> Image:
    """Smooth step from 0 at `start` to 1 at `end`; `start` may be the larger."""
    t = np.clip((value - np.float32(start)) / np.float32(end - start), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float32)

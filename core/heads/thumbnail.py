"""A small picture of a head, drawn without Blender and without a graphics card."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .rig import HeadRig

SIDE = 96
"""Width and height in pixels."""
_EXTENT = 2.0
"""Width of what is drawn, in outer-eye distances: the face from the forehead to the chin."""
_BACK = 48
"""Grey of the background."""
_SKIN = 215
"""Grey of the skin in full light."""
_EYE = 240
"""Grey of the eyeballs in full light."""
_LIGHT = np.array([-0.4, -0.5, -0.77])
"""Direction to the light in the head frame: from above, on the left of the picture."""
_AMBIENT = 0.35
_SIZE, _SIZE_AT = struct.Struct(">II"), 16
"""Width and height in a PNG file."""
_SHIFT = 4
"""Bits of a pixel's fractions, so that edges are smooth."""


def thumbnail(rig: HeadRig, vertices: NDArray[np.float32]) -> bytes:
    """Draw a head with vertices (A, 3) from the front, as a PNG file."""
    middle = vertices[rig.landmarks].astype(np.float64).mean(axis=0)
    return bytes(cv2.imencode(".png", draw_head(rig, vertices, middle, SIDE))[1].tobytes())


def draw_head(rig: HeadRig, vertices: NDArray[np.floating[Any]], middle: FloatArray, side: int) -> NDArray[np.uint8]:
    """Draw a head with vertices (A, 3) from the front in grey, (side, side), around a point of its frame."""
    picture = np.full((side, side), _BACK, dtype=np.uint8)
    eyes = np.asarray(rig.eyeballs, dtype=np.float64)
    scale = side / (_EXTENT * rig.eye_distance)

    def pixels(places: FloatArray) -> NDArray[np.int32]:
        return np.asarray(np.rint(to_pixels(rig, places, middle, side) * 2**_SHIFT), dtype=np.int32)

    for *centre, radius in eyes:
        place = pixels(np.array(centre)).tolist()
        cv2.circle(picture, place, round(radius * scale * 2**_SHIFT), (_EYE,), cv2.FILLED, cv2.LINE_AA, _SHIFT)
    faces = rig.all_faces
    corners = vertices[np.where(faces < 0, faces[:, :1], faces)].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    lit = _AMBIENT + (1.0 - _AMBIENT) * np.abs(normals @ _LIGHT) / np.maximum(lengths, 1e-12)
    inside = np.abs(corners[..., :2].mean(axis=1) - middle[:2]).max(axis=1) * scale < side
    depths = corners[..., 2].mean(axis=1)
    drawn, shades = pixels(corners), np.rint(_SKIN * lit).astype(np.int64)
    for face in np.argsort(-depths, kind="stable"):
        if inside[face]:
            cv2.fillConvexPoly(picture, drawn[face], (int(shades[face]),), cv2.LINE_AA, _SHIFT)
    return picture


def to_pixels(rig: HeadRig, places: FloatArray, middle: FloatArray, side: int) -> FloatArray:
    """Return where points (..., 3) of the head frame are in a picture that `draw_head` draws, (..., 2)."""
    scale = side / (_EXTENT * rig.eye_distance)
    return np.asarray((places[..., :2] - middle[:2]) * scale + side / 2)


def pixels_of(png: bytes) -> NDArray[np.float32] | None:
    """Decode a thumbnail as RGBA from the lower left, (SIDE, SIDE, 4), 0 to 1; None if it is damaged."""
    # The size that a damaged file states is compared before memory is allocated.
    stated = _SIZE.unpack_from(png, _SIZE_AT) if len(png) > _SIZE_AT + _SIZE.size else (0, 0)
    image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if stated == (SIDE, SIDE) else None
    if image is None or image.shape != (SIDE, SIDE):
        return None
    grey = image[::-1, :, None].astype(np.float32) / 255.0
    return np.asarray(np.concatenate([grey, grey, grey, np.ones_like(grey)], axis=2), dtype=np.float32)

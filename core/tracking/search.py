"""Faces that Viola-Jones misses, looked for with the tracker's own face experts all over the image.

The layers of a convolutional network slide: shown a whole image instead of a face, it gives at every place what it
would say of the crop there, and the places share their work (OverFeat: Sermanet et al. 2014).
"""

from __future__ import annotations

from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .experts import FACE_SCALE, FACE_SIZE, FaceExperts

_STEP = 1.35
"""Ratio of neighbouring sizes; the experts know faces a fifth too large or small."""
_LARGEST, _SMALLEST = 0.5, 1.0 / 22.0
"""Eye distances looked for, in the image's shorter and longer side."""
_CELL = 16
"""Pixels a cell of the face's log odds."""
_MOST = 6


def search_faces(grey: NDArray[np.uint8], experts: FaceExperts, roll: float) -> list[FloatArray]:
    """Frontal poses (6,) where the experts see a face, rolled by about `roll` radians, best first.

    Some 100 ms for a 640 x 480 image.
    """
    height, width = grey.shape
    upright, back = _turned(grey, roll)
    found: list[tuple[float, FloatArray]] = []
    distance = _LARGEST * min(height, width)
    while distance >= max(_SMALLEST * max(height, width), 6.0):
        factor = FACE_SCALE / distance
        found += _look(upright, factor, experts)
        distance /= _STEP
    found.sort(key=lambda f: -f[0])
    kept: list[FloatArray] = []
    for _, pose in found:
        if all(_apart(pose, k) for k in kept):
            kept.append(pose)
    out = []
    for pose in kept[:_MOST]:
        place = back @ np.array([pose[4], pose[5], 1.0])
        out.append(np.array([pose[0], 0.0, 0.0, roll, *place]))
    return out


def _apart(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.hypot(*(a[4:6] - b[4:6])) > 0.6 * max(a[0], b[0]) or not 0.5 < a[0] / b[0] < 2.0)


def _turned(grey: NDArray[np.uint8], roll: float) -> tuple[NDArray[np.uint8], FloatArray]:
    """The image turned back by `roll` about its middle, and the affine map (2, 3) from there to the image."""
    if roll == 0.0:
        return grey, np.eye(2, 3)
    height, width = grey.shape
    forth = cv2.getRotationMatrix2D(((width - 1) / 2.0, (height - 1) / 2.0), float(np.degrees(roll)), 1.0)
    turned = cv2.warpAffine(grey, forth, (width, height), borderMode=cv2.BORDER_REPLICATE).astype(np.uint8)
    return turned, np.asarray(cv2.invertAffineTransform(forth), np.float64)


def _look(grey: NDArray[np.uint8], factor: float, experts: FaceExperts) -> list[tuple[float, FloatArray]]:
    """Log odds and poses of the faces of one size: the local maxima of the experts' opinion."""
    height, width = grey.shape
    method = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    small = cv2.resize(grey, (max(round(width * factor), 8), max(round(height * factor), 8)), interpolation=method)
    margin = FACE_SIZE // 2 - _CELL // 2
    rows, columns = (ceil(n / _CELL) * _CELL for n in small.shape)
    below, right = rows - small.shape[0] + margin, columns - small.shape[1] + margin
    framed = cv2.copyMakeBorder(small, margin, below, margin, right, cv2.BORDER_REPLICATE).astype(np.float32)
    odds = experts.search(framed)
    peaks = (odds > 0.0) & (odds >= cv2.dilate(odds, np.ones((3, 3), np.uint8)))
    out = []
    for row, column in np.argwhere(peaks):
        place = (np.array([column, row]) * _CELL + _CELL / 2.0) / factor - 0.5
        out.append((float(odds[row, column]), np.array([FACE_SCALE / factor, 0.0, 0.0, 0.0, *place])))
    return out

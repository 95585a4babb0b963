"""A head as a depth camera sees it: one skin, without openings for eyes and mouth."""

from __future__ import annotations

import cv2
import numpy as np

from facemime.core.head import load_head
from facemime.core.landmarks import OUTER_EYE_CORNERS

HEAD = load_head()
VERTICES = HEAD.vertices.astype(float)
UNIT = float(np.linalg.norm(np.subtract(*VERTICES[HEAD.landmarks[OUTER_EYE_CORNERS]])))


def scanned() -> tuple[np.ndarray, np.ndarray]:
    """The front of the head as a depth camera sees it: one skin, a grid of 2 % of the eye distance."""
    step = 0.02 * UNIT
    low = VERTICES[:, :2].min(axis=0) - step
    width, height = np.ceil((VERTICES[:, :2].max(axis=0) - low) / step).astype(int) + 2
    depth = np.full((height, width), np.nan, np.float32)
    triangles = np.concatenate([HEAD.faces[:, :3], HEAD.faces[HEAD.faces[:, 3] >= 0][:, [0, 2, 3]]])
    nearness = VERTICES[triangles, 2].mean(axis=1)
    for i in np.argsort(-nearness):
        corners = (VERTICES[triangles[i], :2] - low) / step
        cv2.fillConvexPoly(depth, np.round(corners).astype(np.int32), float(nearness[i]))
    seen = np.isfinite(depth)
    filled = np.where(seen, depth, np.nanmax(depth)).astype(np.float32)
    y, x = np.mgrid[:height, :width]
    places = np.stack([low[0] + step * x, low[1] + step * y, cv2.GaussianBlur(filled, (0, 0), 1.5)], axis=-1)
    number = np.arange(height * width).reshape(height, width)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    whole = seen[:-1, :-1] & seen[:-1, 1:] & seen[1:, 1:] & seen[1:, :-1]
    used, faces = np.unique(quads[whole], return_inverse=True)
    return places.reshape(-1, 3)[used].astype(float), faces.reshape(-1, 4)

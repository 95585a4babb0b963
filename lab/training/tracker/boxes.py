"""Place of a face in a Viola-Jones detector's box."""

from __future__ import annotations

import numpy as np

from facemime.core.tracking.cascade_detector import DETECTORS, EFFORTS, CascadeDetector, Step


def fit_box_offsets(pictures: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Median of `(dx, dy, scale)` in box widths, (D, 3), over grey images with known poses (6,)."""
    detector = CascadeDetector()
    seen: list[list[tuple[float, float, float]]] = [[] for _ in DETECTORS]
    for grey, pose in pictures:
        for face in (f for effort in EFFORTS for f in detector.boxes(grey, Step.whole(effort))):
            x, y, width, height = face.box
            away = pose[4:6] - (x + width / 2, y + height / 2)
            if face.roll == 0.0 and np.abs(away).max() < 0.35 * width and 0.25 < pose[0] / width < 0.8:
                seen[face.detector].append((away[0] / width, away[1] / width, pose[0] / width))
    offsets = np.array([np.median(s, axis=0) if s else (0.0, 0.1, 0.45) for s in seen])
    offsets[:, 0] = 0.0  # faces are symmetric, and profiles are searched on both sides
    return offsets

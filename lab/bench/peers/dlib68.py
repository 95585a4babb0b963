"""dlib's 68 landmarks (HOG detector, regression trees), by `dlib-bin` and `face_recognition_models`."""

from __future__ import annotations

import cv2
import numpy as np

from facemime.core.base.landmarks import IBUG68_INDICES, N_LANDMARKS


class Dlib:
    """dlib as a `Peer`. It has no tracking: each frame is detected from scratch."""

    name = "dlib"

    def __init__(self) -> None:
        import dlib
        import face_recognition_models

        self._detect = dlib.get_frontal_face_detector()
        self._shape = dlib.shape_predictor(face_recognition_models.pose_predictor_model_location())

    def locate(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.locate`."""
        rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.ndim == 3 else cv2.COLOR_GRAY2RGB)
        boxes = self._detect(rgb, 1 if max(image.shape) < 700 else 0)
        if not boxes:
            return np.full((N_LANDMARKS, 2), np.nan)
        points = self._shape(rgb, max(boxes, key=lambda b: b.area())).parts()
        return np.array([(p.x, p.y) for p in points], np.float64)[IBUG68_INDICES]

    def track(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.track`."""
        return self.locate(image)

    def reset(self) -> None:
        """See `Peer.reset`."""

"""MediaPipe's face mesh with refined eyes and lips: 478 points, of which those closest to Facemime's are used."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from facemime.core.face.landmarks import IBUG68_INDICES

VERTICES_68 = (
    # jaw line along the oval of the face, from the viewer's left ear to the right one
    *(127, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 356),
    # brows: the upper rim, at the inner ends the lower one
    *(70, 63, 105, 66, 55, 285, 296, 334, 293, 300),
    # bridge and underside of the nose
    *(168, 197, 5, 4, 75, 97, 2, 326, 305),
    # eyes: outer corner, upper lid, inner corner, lower lid
    *(33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380),
    # outer lip
    *(61, 39, 37, 0, 267, 269, 291, 321, 314, 17, 84, 91),
    # inner lip
    *(78, 82, 13, 312, 308, 317, 14, 87),
)
"""Vertex of the face mesh for each iBUG-68 landmark, chosen by the hand labels of people in the training set."""


class MediaPipe:
    """MediaPipe's face mesh as a `Peer` that returns some of its `vertices`, by default those of the 66 landmarks."""

    name = "MediaPipe"

    def __init__(self, vertices: Sequence[int] | None = None) -> None:
        import mediapipe

        mesh = mediapipe.solutions.face_mesh.FaceMesh
        self._make = lambda still: mesh(static_image_mode=still, refine_landmarks=True, max_num_faces=1)
        self._still, self._moving = self._make(True), self._make(False)
        self._vertices = np.array(VERTICES_68)[IBUG68_INDICES] if vertices is None else np.array(vertices)

    def locate(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.locate`."""
        return self._points(self._still, image)

    def track(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.track`."""
        return self._points(self._moving, image)

    def reset(self) -> None:
        """See `Peer.reset`."""
        self._moving.close()
        self._moving = self._make(False)

    def _points(self, mesh: object, image: np.ndarray) -> np.ndarray:
        rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.ndim == 3 else cv2.COLOR_GRAY2RGB)
        faces = mesh.process(rgb).multi_face_landmarks
        if not faces:
            return np.full((len(self._vertices), 2), np.nan)
        height, width = image.shape[:2]
        points = np.array([(p.x * width, p.y * height) for p in faces[0].landmark])
        return points[self._vertices] - 0.5

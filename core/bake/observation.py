"""Observations of tracked frames, from which ARKit's coefficients are found (method.md, section 9.3)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..drive.actions import ActionDriver
from ..drive.drive_settings import DriveSettings
from ..drive.eyes import EyeDriver, measured_eyes
from ..drive.posing import limit_rotation
from ..drive.retarget import retargeter_for
from ..face.actions import ACTIONS
from ..face.coefficient_names import COEFFICIENTS
from ..face.landmarks import outer_eye_distance
from ..face.rotation import euler_to_matrix
from ..heads.built_in import load_head
from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply
from ..takes.face_space import without_similarity
from ..takes.neutral import MIRROR_WIDTH, Neutral
from ..tracking.mirror import mirror_result
from ..tracking.result import TrackResult


class Observer:
    """Observes the face of a performer as that of the built-in head.

    Parameters
    ----------
    neutral : Neutral
        The performer's neutral face.
    options : DriveSettings
        Strength, mirror, the limits of the eyes, and whether only landmarks count. Depths are always used, although
        they are hardly known.
    """

    def __init__(self, neutral: Neutral, options: DriveSettings) -> None:
        landmarks = _landmarks()
        self._unit, self._own = outer_eye_distance(landmarks), _own_motion()
        self.options = options
        self.neutral = neutral.mirrored() if options.mirror else neutral
        self._retargeter = retargeter_for(self.neutral, landmarks, strength=options.strength)
        self._actions = ActionDriver(self.neutral.actions, self.neutral.shape, options.strength)
        self._gains = _gains(options)
        self._eyes = EyeDriver(self.neutral.gaze, self.neutral.vergence)

    def mirrored(self, result: TrackResult) -> TrackResult:
        """Return the result as the other methods expect it, flipped left to right if the settings say so."""
        return mirror_result(result, MIRROR_WIDTH) if self.options.mirror else result

    def displacements(self, result: TrackResult) -> FloatArray:
        """Return the displacements of the built-in head's landmarks, (66, 3), in its unit."""
        return self._retargeter.displacements(result.shape)

    def face(self, result: TrackResult) -> FloatArray:
        """Return the observation of a frame, (213,).

        It contains the displacements without those of the whole head, in outer-eye distances, and the activations above
        rest, which are NaN if they are unknown or ignored.
        """
        own = multiply((self.displacements(result) / self._unit).ravel(), self._own)
        above = np.full(len(ACTIONS), np.nan)
        if not self.options.only_landmarks:
            above = self._actions.above_rest(result.actions, result.shape) * self._actions.gains
        return np.concatenate([own, above])

    def stated(self, result: TrackResult) -> FloatArray:
        """Return the coefficients stated by the source, (52,), times the strength of their region; NaN without any."""
        return np.asarray(np.clip(result.coefficients * self._gains, 0.0, 1.0))

    def shown(self, result: TrackResult) -> FloatArray:
        """Return the activations that an avatar would show (equation 4.6), (15,)."""
        if self.options.only_landmarks:
            return np.zeros(len(ACTIONS))
        return self._actions.activations(result.actions, result.shape)

    def gaze(self, result: TrackResult) -> FloatArray:
        """Return the rotations of the right and left eyeball, (2, 3, 3). Frames have to be passed in order."""
        posing = self.options.posing
        turned = euler_to_matrix(*result.pose[1:4]) @ self.neutral.rotation.T
        if self.neutral.measured and np.isfinite(result.gaze).all():
            eyes = measured_eyes(result.gaze - self.neutral.gaze, result.vergence - self.neutral.vergence)
        else:
            eyes = self._eyes.rotations(result.gaze, result.vergence, turned)
        return np.stack([limit_rotation(eye, posing.eyes_strength, posing.eyes_limit) for eye in eyes])


def _gains(options: DriveSettings) -> FloatArray:
    """Strength of each coefficient, (52,), which is that of its region or of the eyes' direction."""
    upper, middle, lower = options.strength

    def gain(name: str) -> float:
        if name.startswith("eyeLook"):
            return options.posing.eyes_strength
        if name.startswith(("brow", "eye")):
            return upper
        return middle if name.startswith(("cheek", "nose")) else lower

    return np.array([gain(name) for name in COEFFICIENTS])


def _landmarks() -> FloatArray:
    """Landmarks of the built-in head at rest, (66, 3), in its unit."""
    head = load_head()
    return head.vertices[head.landmarks].astype(np.float64)


@lru_cache(maxsize=1)
def _own_motion() -> FloatArray:
    """Projection, (198, 198), whose rows map coordinates to what remains without the motion of the whole head.

    Removing a similarity is linear.
    """
    landmarks = _landmarks()
    every = np.eye(landmarks.size).reshape(-1, *landmarks.shape)
    return without_similarity(every, landmarks / outer_eye_distance(landmarks)).reshape(len(every), -1)

"""Takes with known shapes, for tests."""

import numpy as np

from facemime.core.actions import N_ACTIONS
from facemime.core.coefficient_names import N_COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.landmarks import OUTER_EYE_CORNERS, from_ibug
from facemime.core.takes.take import Take

CHIN_AND_LIP = from_ibug([*range(4, 13), *range(55, 60), *range(65, 68)])
BROWS = from_ibug(range(17, 27))


def make_take(
    shapes: np.ndarray,
    fps: float = 25.0,
    pose: np.ndarray | None = None,
    found: np.ndarray | None = None,
    gaze: np.ndarray | None = None,
) -> Take:
    """A take of pose-free shapes (N, 66, 3), frontal unless poses (N, 6) are given, without gaze."""
    count = len(shapes)
    found = np.ones(count, bool) if found is None else found
    return Take(
        times=np.arange(count) / fps,
        landmarks=(shapes[..., :2] * 100.0 + (320.0, 240.0)).astype(np.float32),
        pose=np.tile([100.0, 0.0, 0.0, 0.0, 320.0, 240.0], (count, 1)) if pose is None else pose,
        shape_params=np.zeros((count, 2), np.float32),
        shape=shapes.astype(np.float32),
        confidence=found.astype(np.float32),
        found=found,
        landmark_confidence=np.full((count, 66), np.nan, np.float32),
        pupils=np.full((count, 2, 2), np.nan, np.float32),
        gaze=np.full((count, 2), np.nan, np.float32) if gaze is None else gaze,
        vergence=np.full(count, np.nan, np.float32),
        actions=np.full((count, N_ACTIONS), np.nan, np.float32),
        coefficients=np.full((count, N_COEFFICIENTS), np.nan, np.float32),
        info={"source": "performance.mp4", "fps": fps, "image_size": [640, 480]},
    )


def performance(count: int = 60, fps: float = 25.0) -> Take:
    """A second of rest, then mouth and brows move while the head turns; one frame is lost."""
    head = load_head()
    rest = head.vertices[head.landmarks].astype(float)
    rest /= np.linalg.norm(np.subtract(*rest[OUTER_EYE_CORNERS]))
    phase = np.clip((np.arange(count) / fps - 1.0) * 4.0, 0.0, None)
    shape = np.tile(rest, (count, 1, 1))
    shape[:, CHIN_AND_LIP, 1] += 0.1 * np.abs(np.sin(phase))[:, None]
    shape[:, BROWS, 1] -= 0.08 * np.abs(np.sin(1.7 * phase))[:, None]
    pose = np.tile([100.0, 0.0, 0.0, 0.0, 320.0, 240.0], (count, 1))
    pose[:, 2] = 0.3 * np.sin(phase)
    pose[:, 4] += 20.0 * np.sin(phase)
    found = np.ones(count, bool)
    found[count // 2] = False
    shape[~found], pose[~found] = np.nan, np.nan
    return make_take(shape, fps, pose, found)

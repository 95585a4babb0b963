"""Takes with known shapes, for tests."""

import numpy as np

from facemime.core.face.landmarks import OUTER_EYE_CORNERS, from_ibug
from facemime.core.face.names import COEFFICIENT_INDEX, N_ACTIONS, N_COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.takes.format import HEADER, chunks_in
from facemime.core.takes.measured import coefficient_face
from facemime.core.takes.take import FIELDS, Take, TakeRecorder

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
        teeth=np.full(count, np.nan, np.float32),
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


def coefficient_take(count: int = 40, fps: float = 60.0) -> Take:
    """A take of coefficients, several of which change while the head turns."""
    face, recorder = coefficient_face(), TakeRecorder({"source": "phone", "measured": True})
    for number in range(count):
        values, share = np.zeros(N_COEFFICIENTS), 0.5 - 0.5 * np.cos(number / 6.0)
        for name, size in (("jawOpen", 0.8), ("eyeBlinkLeft", 0.9), ("mouthSmileRight", 0.5), ("eyeLookOutLeft", 0.4)):
            values[COEFFICIENT_INDEX[name]] = share * size
        recorder.append(number / fps, face.result(values, np.array([0.1, -0.2, 0.05]) * share))
    take = recorder.finish()
    take.info["calibration"] = face.neutral.to_dict()
    return take


def same_rows(part: Take, whole: Take) -> bool:
    """Whether every frame of `part` equals the frame of `whole` at that time, bit by bit."""
    rows = np.searchsorted(whole.times, part.times)
    return all(np.array_equal(getattr(part, f), getattr(whole, f)[rows], equal_nan=f != "found") for f in FIELDS)


def starts(data: bytes) -> list[int]:
    """Return where the chunks of an intact file begin."""
    places = [0]
    for chunk in chunks_in(data):
        places.append(places[-1] + HEADER.size + len(chunk.content))
    return places[:-1]

"""Whether the tracker stays with the chosen person when another passes in front."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.base.landmarks import BROWS, INNER
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.accuracy import eye_distances
from lab.bench.exact import Clip

_WIDTH, _HEIGHT = 640, 480
_FOREHEAD = 0.55
"""Distance above the brows, in eye distances, at which a head is cut out."""
_NEAR = 0.1
"""Mean error in eye distances below which the tracker counts as following a person."""
SPEEDS = (1.5, 2.0, 2.5, 3.0)
"""Speeds in pixels per frame, for eyes that are 100 pixels apart."""


@dataclass(frozen=True)
class Crossing:
    """Numbers of frames in which the tracker followed the chosen person, the other, no face, or neither of the two.

    `returned` is whether it followed the chosen person in the last frame.
    """

    own: int
    other: int
    nobody: int
    between: int
    returned: bool


def cross(behind: Clip, before: Clip, speed: float) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Render grey frames (480, 640) in which the second person passes in front of the first, with their landmarks."""
    count = min(len(behind.frames), len(before.frames))
    rng = np.random.default_rng(0)
    room = 110.0 + 6.0 * cv2.GaussianBlur(rng.normal(0, 40, (_HEIGHT, _WIDTH)).astype(np.float32), (0, 0), 12)
    frames, landmarks = [], np.empty((2, count, 66, 2))
    for i in range(count):
        picture = room
        for person, (clip, way) in enumerate(((behind, 1.0), (before, -1.0))):
            shown, points = clip.frames[i], clip.landmarks[i]
            shown = shown if shown.ndim == 2 else cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY)
            move = np.array([_WIDTH, _HEIGHT]) / 2.0 - np.array(shown.shape[::-1]) / 2.0
            move[0] += way * speed * (i - count / 2.0)
            matrix = np.column_stack([np.eye(2), move])
            landmarks[person, i] = points + move
            moved = cv2.warpAffine(shown, matrix, (_WIDTH, _HEIGHT)).astype(np.float32)
            share = _head(landmarks[person, i])
            picture = picture * (1.0 - share) + moved * share
        frames.append(np.clip(picture, 0, 255).astype(np.uint8))
    return frames, landmarks[0], landmarks[1]


def _head(points: np.ndarray) -> np.ndarray:
    """Mask, (480, 640), 0 to 1, of the face with landmarks (66, 2) and its forehead, with a soft edge."""
    raised = points[BROWS] - (0.0, _FOREHEAD * eye_distances(points[None])[0])
    hull = cv2.convexHull(np.concatenate([points, raised]).astype(np.float32))
    mask = np.zeros((_HEIGHT, _WIDTH), np.uint8)
    cv2.fillConvexPoly(mask, hull.astype(np.int32), 255)
    return cv2.GaussianBlur(cv2.dilate(mask, np.ones((9, 9))), (0, 0), 2.0).astype(np.float32) / 255.0


def follow(tracker: FaceTracker, frames: list[np.ndarray], own: np.ndarray, other: np.ndarray) -> Crossing:
    """Track the person with landmarks `own` (T, 66, 2), chosen in the first frame."""
    tracker.reset()
    tracker.choose(*own[0].mean(axis=0))
    units = eye_distances(own)
    counts = dict.fromkeys(("own", "other", "nobody", "between"), 0)
    where = "nobody"
    for frame, mine, theirs, unit in zip(frames, own, other, units, strict=True):
        result = tracker.track(frame)
        where = "nobody"
        if result.found:
            to_own, to_other = (
                np.linalg.norm(result.landmarks - x, axis=1)[INNER].mean() / unit for x in (mine, theirs)
            )
            where = "own" if to_own < min(_NEAR, to_other) else "other" if to_other < _NEAR else "between"
        counts[where] += 1
    return Crossing(**counts, returned=where == "own")


def on_crossings(tracker: FaceTracker, clips: list[Clip]) -> dict[str, dict[str, float]]:
    """All pairs of people at all speeds: shares of frames, and crossings that end on the chosen person, by speed."""
    out = {}
    for speed in SPEEDS:
        runs = [follow(tracker, *cross(a, b, speed)) for a in clips for b in clips if a is not b]
        frames = sum(r.own + r.other + r.nobody + r.between for r in runs)
        out[f"{speed:g}"] = {
            "crossings": len(runs),
            "returned": sum(r.returned for r in runs),
            **{k: sum(getattr(r, k) for r in runs) / frames for k in ("own", "nobody", "between", "other")},
        }
    return out

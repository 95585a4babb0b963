"""What pins have told about a performer: how far the tracker is off where a part of the face looks in a certain way."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import DataError, SourceError
from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, JAW, LIPS, NOSE
from ..files.reading import as_object
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..tracking.result import TrackResult, project_shape
from .take import Take
from .timing import project

PARTS: tuple[IntArray, ...] = (BROWS, EYE_RIGHT, EYE_LEFT, NOSE, LIPS, JAW)
"""Landmarks that correct each other; those of different parts do not."""
_TURN = 0.4
"""Rotation of the head, in radians, over which a correction fades."""
_MOST = 100.0
"""Largest number in a stored correction."""


@dataclass(frozen=True)
class Looks:
    """How a part looks in N frames: landmarks (N, 2 n), scaled by their number, and rotation (N, 2)."""

    landmarks: FloatArray
    rotation: FloatArray

    @classmethod
    def of(cls, shapes: FloatArray, poses: FloatArray, part: IntArray) -> Looks:
        """Describe shapes (N, 66, 3) with poses (N, 6)."""
        flat = shapes[:, part, :2].reshape(len(shapes), -1).astype(np.float64)
        return cls(flat / np.sqrt(len(part)), poses[:, 1:3].astype(np.float64))

    def likeness(self, others: Looks, look: float) -> FloatArray:
        """Likeness of these N frames to M others, 0 to 1, (N, M)."""
        away = _squares(self.landmarks, others.landmarks) / look**2
        away += _squares(self.rotation, others.rotation) / _TURN**2
        return np.asarray(np.exp(-0.5 * away))

    def part(self, chosen: IntArray) -> Looks:
        """Return those of the chosen frames."""
        return Looks(self.landmarks[chosen], self.rotation[chosen])


def _squares(these: FloatArray, others: FloatArray) -> FloatArray:
    """Squared distances between rows (N, D) and (M, D), (N, M)."""
    size = np.square(these).sum(axis=1)[:, None] + np.square(others).sum(axis=1)
    return np.asarray(np.maximum(size - 2.0 * linalg.multiply(these, others.T), 0.0))


@dataclass(frozen=True)
class Learnt:
    """What the pins of one part in F frames tell about alike frames.

    Attributes
    ----------
    part : int
        Index in `PARTS`.
    looks : Looks
        How the part looked in these frames, as tracked.
    look : float
        Root mean square of the landmarks' difference over which the correction fades, in eye distances.
    moved : (F, n, 3) float64
        What each frame adds where another looks the same, in eye distances.
    """

    part: int
    looks: Looks
    look: float
    moved: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """Convert to lists and numbers for JSON."""
        arrays = {"landmarks": self.looks.landmarks, "rotation": self.looks.rotation, "moved": self.moved}
        return {"part": self.part, "look": self.look} | {name: a.round(6).tolist() for name, a in arrays.items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Learnt:
        """Convert from the result of `to_dict`; ValueError or KeyError if it is anything else."""
        part = int(data["part"])
        points = len(PARTS[part]) if 0 <= part < len(PARTS) else -1
        landmarks, rotation, moved = (np.array(data[name], np.float64) for name in ("landmarks", "rotation", "moved"))
        count, look = len(moved), float(data["look"])
        shapes = (landmarks.shape, rotation.shape, moved.shape)
        if shapes != ((count, 2 * points), (count, 2), (count, points, 3)) or not 0.0 < look < _MOST:
            raise DataError("its numbers do not fit")
        if not all(np.isfinite(array).all() and np.abs(array).max() < _MOST for array in (landmarks, rotation, moved)):
            raise DataError("its numbers are out of range")
        return cls(part, Looks(landmarks, rotation), look, moved)

    def moves(self, shapes: FloatArray, poses: FloatArray) -> FloatArray:
        """Return the correction (N, n, 3) of shapes (N, 66, 3), as tracked, with poses (N, 6)."""
        like = Looks.of(shapes, poses, PARTS[self.part]).likeness(self.looks, self.look)
        return linalg.multiply(like, self.moved.reshape(len(self.moved), -1)).reshape(len(like), -1, 3)


def corrected(take: Take, learnt: Sequence[Learnt]) -> Take:
    """Return a take with what was learnt from the pins of another one of the same performer."""
    seen = take.found
    if not learnt or not seen.any():
        return take
    shape, landmarks = take.shape.copy(), take.landmarks.copy()
    tracked, poses = take.shape[seen].astype(np.float64), take.pose[seen]
    shapes = tracked.copy()
    for part in learnt:
        shapes[:, PARTS[part.part]] += part.moves(tracked, poses)
    shape[seen] = shapes
    landmarks[seen] += project(shapes, poses) - project(tracked, poses)
    return replace(take, shape=shape, landmarks=landmarks)


def corrected_result(result: TrackResult, learnt: Sequence[Learnt]) -> TrackResult:
    """Return a live result with what was learnt; see `corrected`."""
    if not learnt or not result.found:
        return result
    shape = result.shape.astype(np.float64)
    for part in learnt:
        shape[PARTS[part.part]] += part.moves(result.shape[None], result.pose[None])[0]
    moved = project_shape(shape, result.pose) - project_shape(result.shape, result.pose)
    return replace(result, shape=shape, landmarks=result.landmarks + moved)


def learnt_to_json(learnt: Sequence[Learnt]) -> str:
    """Return what was learnt as JSON."""
    return json.dumps([part.to_dict() for part in learnt])


def learnt_from_json(text: str) -> tuple[Learnt, ...]:
    """Parse the result of `learnt_to_json`; raises SourceError if it is damaged."""
    try:
        return tuple(Learnt.from_dict(as_object(item, "it")) for item in json.loads(text))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise SourceError("What was learnt from pins is damaged ({error}). Learn it again.", error=error) from error

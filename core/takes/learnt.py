"""What pins have told about a performer: how far the tracker is off where a part of the face looks in a certain way."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import DataError, SourceError
from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, JAW, LIPS, N_LANDMARKS, NOSE
from ..files.reading import as_object
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..tracking.result import TrackResult, project_shape
from .take import Take
from .timing import project

PARTS: tuple[IntArray, ...] = (JAW, BROWS[:5], BROWS[5:], NOSE, EYE_RIGHT, EYE_LEFT, LIPS)
"""Landmarks that correct each other, in their order; those of different parts do not."""
_STARTS = np.array([part[0] for part in PARTS])
_SIZES = np.array([len(part) for part in PARTS], dtype=np.float64)
_VALUES = 2 * N_LANDMARKS + 2
_COLUMNS = tuple(np.append((2 * part[:, None] + [0, 1]).ravel(), [_VALUES - 2, _VALUES - 1]) for part in PARTS)
"""Values of a face that a part is compared by: its landmarks and the rotation of the head."""
_TURN = 0.4
"""Rotation of the head, in radians, over which a correction fades; chosen on rendered clips (tracking.md, *Pins*)."""
_UNSURE = 0.015
"""Difference of the certainty of a part over which a correction fades, if it was stored without."""
_MOST = 100.0
"""Largest number in a stored correction."""


@dataclass(frozen=True)
class Faces:
    """What is compared of N faces.

    Attributes
    ----------
    values : (N, 134) float64
        Landmarks in the head frame without depth, in eye distances, then pitch and yaw.
    certainty : (N, 7) float64
        Certainty of each part; NaN where unknown. It tells a blink that the tracker missed from an open eye.
    """

    values: FloatArray
    certainty: FloatArray

    @classmethod
    def of(cls, shapes: FloatArray, poses: FloatArray, confidences: FloatArray) -> Faces:
        """Describe shapes (N, 66, 3) with poses (N, 6) and the certainty of each landmark, (N, 66)."""
        values = np.concatenate([shapes[:, :, :2].reshape(len(shapes), -1), poses[:, 1:3]], axis=1, dtype=np.float64)
        return cls(values, np.add.reduceat(confidences, _STARTS, axis=1, dtype=np.float64) / _SIZES)

    def chosen(self, frames: IntArray | slice) -> Faces:
        """Return those of some frames."""
        return Faces(self.values[frames], self.certainty[frames])

    def looks(self, part: int, frames: IntArray, reach: float, unsure: float) -> Looks:
        """Return how a part looks in some frames."""
        return Looks(part, self.values[frames][:, _COLUMNS[part]], self.certainty[frames, part], reach, unsure)


@dataclass(frozen=True)
class Looks:
    """How a part looks in F frames.

    Attributes
    ----------
    part : int
        Index in `PARTS`.
    values : (F, 2 n + 2) float64
        Its columns of `Faces.values`.
    certainty : (F,) float64
        Its certainty; NaN where unknown.
    reach : float
        Root mean square of the landmarks' difference over which a correction fades, in eye distances.
    unsure : float
        Difference of the certainty over which it fades.
    """

    part: int
    values: FloatArray
    certainty: FloatArray
    reach: float
    unsure: float


class Likeness:
    """How much N faces look like F frames of one or several parts: 0 to 1, (N, F)."""

    def __init__(self, looks: Sequence[Looks]) -> None:
        counts = [len(one.values) for one in looks]
        self._parts = np.repeat([one.part for one in looks], counts)
        self._unsure = np.repeat([one.unsure for one in looks], counts)
        self._certainty = np.concatenate([one.certainty for one in looks])
        # A weighted squared distance is a product with the squares of the values and with the values themselves.
        self._matrix = np.zeros((2 * _VALUES, len(self._parts)))
        self._constant = np.zeros(len(self._parts))
        start = 0
        for one in looks:
            columns, mine = _COLUMNS[one.part], slice(start, start := start + len(one.values))
            weights = np.full(len(columns), 1.0 / (len(PARTS[one.part]) * one.reach**2))
            weights[-2:] = 1.0 / _TURN**2
            self._matrix[columns, mine] = weights[:, None]
            self._matrix[_VALUES + columns, mine] = -2.0 * (weights * one.values).T
            self._constant[mine] = (weights * np.square(one.values)).sum(axis=1)

    def of(self, faces: Faces) -> FloatArray:
        """Compare faces."""
        away = _product(np.concatenate([np.square(faces.values), faces.values], axis=1), self._matrix) + self._constant
        unlike = (faces.certainty[:, self._parts] - self._certainty) / self._unsure
        unlike[np.isnan(unlike)] = 0.0
        return np.asarray(np.exp(-0.5 * np.maximum(away + np.square(unlike), 0.0)))


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Multiply matrices; for a single row, numpy is faster."""
    return np.asarray(left @ right) if len(left) == 1 else linalg.multiply(left, right)


@dataclass(frozen=True, eq=False)
class Learnt:
    """What the pins of one part in F frames tell about frames that are alike within one reach.

    Attributes
    ----------
    looks : Looks
        How the part looked in these frames, as tracked.
    moved : (F, n, 3) float64
        What each frame adds where another looks the same, in eye distances.
    """

    looks: Looks
    moved: FloatArray

    @property
    def part(self) -> int:
        """Index in `PARTS`."""
        return self.looks.part

    def to_dict(self) -> dict[str, Any]:
        """Convert to lists and numbers for JSON."""
        looks = self.looks
        return {
            "part": looks.part,
            "reach": looks.reach,
            "unsure": looks.unsure,
            "values": looks.values.round(6).tolist(),
            "certainty": [None if np.isnan(value) else round(value, 6) for value in looks.certainty.tolist()],
            "moved": self.moved.round(6).tolist(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Learnt:
        """Convert from the result of `to_dict`; ValueError, TypeError or KeyError if it is anything else."""
        part, reach, unsure = data["part"], float(data["reach"]), float(data.get("unsure", _UNSURE))
        if part not in range(len(PARTS)) or not (0.0 < reach < _MOST and 0.0 < unsure < _MOST):
            raise DataError("its numbers do not fit")
        values, certainty, moved = (np.array(data[name], np.float64) for name in ("values", "certainty", "moved"))
        count, points = len(moved), len(PARTS[part])
        shapes = (values.shape, certainty.shape, moved.shape)
        if not count or shapes != ((count, 2 * points + 2), (count,), (count, points, 3)):
            raise DataError("its numbers do not fit")
        known = (values, moved, certainty[~np.isnan(certainty)])
        if not all((np.abs(array) < _MOST).all() for array in known):
            raise DataError("its numbers are out of range")
        return cls(Looks(int(part), values, certainty, reach, unsure), moved)


class _Joined:
    """What was learnt about all parts."""

    def __init__(self, learnt: Sequence[Learnt]) -> None:
        self._likeness = Likeness([one.looks for one in learnt])
        moved = [np.zeros((len(one.moved), N_LANDMARKS, 3)) for one in learnt]
        for one, whole in zip(learnt, moved, strict=True):
            whole[:, PARTS[one.part]] = one.moved
        self._moved = np.concatenate(moved).reshape(-1, 3 * N_LANDMARKS)

    def moves(self, shapes: FloatArray, poses: FloatArray, confidences: FloatArray) -> FloatArray:
        """Return the correction (N, 66, 3) of shapes (N, 66, 3), as tracked; arguments as for `Faces.of`."""
        like = self._likeness.of(Faces.of(shapes, poses, confidences))
        return _product(like, self._moved).reshape(-1, N_LANDMARKS, 3)


@lru_cache(maxsize=8)
def _joined(learnt: tuple[Learnt, ...]) -> _Joined:
    """Prepare what was learnt once for all frames."""
    return _Joined(learnt)


def corrected(take: Take, learnt: Sequence[Learnt]) -> Take:
    """Return a take with what was learnt from the pins of another one of the same performer."""
    seen = take.found
    if not learnt or not seen.any():
        return take
    shape, landmarks = take.shape.copy(), take.landmarks.copy()
    poses = take.pose[seen]
    moved = _joined(tuple(learnt)).moves(take.shape[seen], poses, take.landmark_confidence[seen])
    shape[seen] += moved
    landmarks[seen] += project(moved, poses) - poses[:, None, 4:6]
    return replace(take, shape=shape, landmarks=landmarks)


def corrected_result(result: TrackResult, learnt: Sequence[Learnt]) -> TrackResult:
    """Return a live result with what was learnt; see `corrected`."""
    if not learnt or not result.found:
        return result
    pose = result.pose
    moved = _joined(tuple(learnt)).moves(result.shape[None], pose[None], result.landmark_confidence[None])[0]
    across = project_shape(moved, pose) - pose[4:]
    return replace(result, shape=result.shape + moved, landmarks=result.landmarks + across)


def learnt_to_json(learnt: Sequence[Learnt]) -> str:
    """Return what was learnt as JSON."""
    return json.dumps([part.to_dict() for part in learnt])


def learnt_from_json(text: str) -> tuple[Learnt, ...]:
    """Parse the result of `learnt_to_json`; raises SourceError if it is damaged."""
    try:
        return tuple(Learnt.from_dict(as_object(item, "it")) for item in json.loads(text))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise SourceError("What was learnt from pins is damaged ({error}). Learn it again.", error=error) from error

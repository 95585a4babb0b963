"""Control points for a head from a recorded take, and their file."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from .arrays import FloatArray
from .deform.greedy import DEFAULT_TOLERANCE, GreedySelection, GreedyStep, greedy_select
from .drive import HeadRig
from .errors import HeadError, SourceError
from .landmarks import IBUG68_INDICES, N_LANDMARKS, from_ibug
from .retarget import Neutral, calibrate, retargeter_for
from .takes.take import Take

_LEFT_OUT = frozenset(range(68)) - frozenset(IBUG68_INDICES.tolist())
_FORMAT = "facemime-control-points-1"


def select_for_take(
    rig: HeadRig,
    take: Take,
    *,
    neutral: Neutral | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    max_points: int = N_LANDMARKS,
    always: Iterable[int] = (),
    never: Iterable[int] = (),
) -> GreedySelection:
    """Choose the control points that `rig` needs for what happens in `take`; frames are numbered as in the take.

    Parameters
    ----------
    neutral : optional
        The performer's; found in the take by default.
    tolerance, max_points, always, never
        As for `greedy_select`.

    Raises
    ------
    SourceError
        Where no face was found in the take.
    """
    neutral = calibrate(take) if neutral is None else neutral
    landmarks = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    retargeter = retargeter_for(neutral, landmarks)
    found = np.flatnonzero(take.found)
    motion = np.stack([retargeter.displacements(take.shape[frame]) for frame in found])
    selection = greedy_select(
        landmarks,
        motion,
        tolerance=tolerance,
        max_points=max_points,
        always=always,
        never=never,
        skin=(rig.vertices, rig.region_weights),
    )
    return replace(selection, steps=tuple(replace(step, frame=int(found[step.frame])) for step in selection.steps))


def to_json(selection: GreedySelection) -> str:
    """The selection as text, landmarks by their iBUG numbers; of the covariance, its lower triangle to five digits."""
    steps = [
        asdict(replace(step, landmark=int(IBUG68_INDICES[step.landmark]), worst=int(IBUG68_INDICES[step.worst])))
        for step in selection.steps
    ]
    regions = [IBUG68_INDICES[row].tolist() for row in selection.membership]
    header = {"format": _FORMAT, "tolerance": selection.tolerance, "reached": selection.reached}
    if selection.covariance is not None:
        header["covariance"] = [float(f"{x:.5g}") for x in selection.covariance[np.tril_indices(N_LANDMARKS)]]
    return json.dumps(header | {"regions": regions, "steps": steps})


def from_json(text: str) -> GreedySelection:
    """The selection that `to_json` wrote.

    Raises
    ------
    SourceError
        Where the text is something else.
    """
    try:
        data: dict[str, Any] = json.loads(text)
        if data["format"] != _FORMAT:
            raise ValueError("another format")
        membership = np.zeros((3, N_LANDMARKS), dtype=np.bool_)
        for row, numbers in zip(membership, data["regions"], strict=True):
            row[from_ibug(numbers)] = True
        steps = tuple(_step(**step) for step in data["steps"])
        tolerance, reached = float(data["tolerance"]), bool(data["reached"])
        return GreedySelection(membership, steps, tolerance, reached, _covariance(data.get("covariance")))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(
            f"These are no control points of Facemime ({error}). Make some with: facemime select TAKE -o POINTS.json"
        ) from error


def _covariance(triangle: list[float] | None) -> FloatArray | None:
    if triangle is None:
        return None
    matrix = np.zeros((N_LANDMARKS, N_LANDMARKS))
    matrix[np.tril_indices(N_LANDMARKS)] = triangle
    if not np.isfinite(matrix).all():
        raise ValueError("its covariance is not finite")
    return np.asarray(matrix + np.tril(matrix, -1).T)


def _step(landmark: int, worst: int, **others: Any) -> GreedyStep:
    here, there = from_ibug((landmark, worst)).tolist()
    return GreedyStep(landmark=here, worst=there, **others)


def parse_landmarks(text: str) -> list[int]:
    """Positions in the 66 of iBUG numbers and ranges such as "17,19-21"; empty text gives none.

    A range runs over 60 and 64, which are not among the 66.

    Raises
    ------
    HeadError
        Where it is something else.
    """
    numbers: list[int] = []
    try:
        for part in filter(None, (part.strip() for part in text.split(","))):
            first, dash, last = part.partition("-")
            span = range(int(first), int(last or first) + 1)
            if not span:
                raise ValueError(f"{part} runs backwards")
            numbers += [number for number in span if not dash or number not in _LEFT_OUT]
        return [int(i) for i in from_ibug(numbers)]
    except ValueError as error:
        raise HeadError(f"{text!r} names no landmarks ({error}). Write iBUG numbers such as 17,19-21.") from error

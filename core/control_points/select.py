"""Selection of control points for a head from a take, and the file of a selection."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, replace
from math import isnan, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..deform.head_deformer import INFORMED
from ..drive.retarget import retargeter_for
from ..errors import DataError, HeadError, SourceError
from ..face.landmarks import IBUG68_INDICES, N_LANDMARKS, from_ibug
from ..files.reading import as_integer, as_list, as_number, as_object, as_text, parse_format, shown
from ..heads.regions import REGIONS
from ..heads.rig import HeadRig
from ..numeric import linalg
from ..numeric.arrays import FloatArray
from ..takes.neutral import Neutral, calibrate
from ..takes.take import Take
from .greedy import GreedySelection, GreedyStep, greedy_select
from .selection_settings import Search, SelectionSettings

_LEFT_OUT = frozenset(range(68)) - frozenset(IBUG68_INDICES.tolist())
_LAST = int(IBUG68_INDICES[-1])
_FORMAT = "facemime-control-points-1"
_BEYOND = 68
_ACTIONS = ("start", "add", "drop")
_MAX_STEPS = 10_000
_MAX_ERROR = 1e3
"""Largest error in a file, in widths of the face."""
_MAX_VARIANCE = 1e15
"""Largest covariance in a file, in squared units of the head."""
_ROUNDING = 1e-3
"""Share of the largest eigenvalue by which a zero one may be negative after rounding to five digits."""


def select_control_points(
    rig: HeadRig,
    take: Take,
    *,
    neutral: Neutral | None = None,
    tolerance: float = SelectionSettings.tolerance,
    max_points: int = SelectionSettings.max_points,
    always: Iterable[int] = (),
    never: Iterable[int] = (),
    search: Search = SelectionSettings.search,
    kernel: str | None = None,
) -> GreedySelection:
    """Select the control points that a head needs for a take.

    Parameters
    ----------
    rig : HeadRig
        The head.
    take : Take
        The take.
    neutral : Neutral, optional
        The performer's neutral face; by default it is found in the take.
    tolerance : float
        As for `greedy_select`.
    max_points : int
        As for `greedy_select`.
    always, never : iterable of int
        As for `greedy_select`.
    search : {"take", "paper"}
        As for `greedy_select`.
    kernel : str, optional
        As in `DriveSettings`; by default that of the search.

    Returns
    -------
    GreedySelection
        The selection; frames are numbered as in the take.

    Raises
    ------
    SourceError
        If the take has no face.

    Examples
    --------
    >>> from facemime import built_in_head, load_take, select_control_points
    >>> selection = select_control_points(built_in_head(), load_take("performance.facetake"), tolerance=0.02)
    >>> selection.membership.shape
    (3, 66)
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
        search=search,
        kernel=None if kernel == INFORMED else kernel,
        skin=(rig.vertices, rig.region_weights),
    )
    return replace(selection, steps=tuple(replace(step, frame=int(found[step.frame])) for step in selection.steps))


def to_json(selection: GreedySelection) -> str:
    """Serialise a selection: landmarks by iBUG number, and the lower triangle of the covariance to five digits."""
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
    """Parse a selection written by `to_json`; raises SourceError if the text is anything else."""
    try:
        data = parse_format(text, _FORMAT, nan=True)
        steps = as_list(data.get("steps"), "steps", _MAX_STEPS)
        reached = data.get("reached")
        if not isinstance(reached, bool):
            raise DataError("reached is {reached}, not true or false", reached=shown(reached))
        return GreedySelection(
            _members(data.get("regions")),
            tuple(_step(as_object(step, f"step {number}")) for number, step in enumerate(steps, 1)),
            as_number(data.get("tolerance"), "tolerance", 0.0, _MAX_ERROR),
            reached,
            _covariance(data.get("covariance")),
        )
    except ValueError as error:
        raise SourceError(
            "This is not a control point file ({error}). Create one: facemime select TAKE -o POINTS.json", error=error
        ) from error


def _members(regions: Any) -> NDArray[np.bool_]:
    """Parse control points, (3, 66), from lists of landmarks. Each needs at least one, and only those of its region."""
    rows = as_list(regions, "regions", len(REGIONS))
    if len(rows) != len(REGIONS):
        raise DataError("there are {rows} regions, not {regions}", rows=len(rows), regions=len(REGIONS))
    members = np.zeros((len(REGIONS), N_LANDMARKS), dtype=np.bool_)
    for row, region, numbers in zip(members, REGIONS, rows, strict=True):
        row[[_landmark(number) for number in as_list(numbers, region.name, N_LANDMARKS)]] = True
        if not row.any() or (np.delete(row, region.landmarks)).any():
            raise DataError("the region {name} has no control points, or one of another region", name=region.name)
    return members


def _landmark(number: Any) -> int:
    return int(from_ibug([as_integer(number, "a landmark", 0, 67)])[0])


def _covariance(triangle: Any) -> FloatArray | None:
    if triangle is None:
        return None
    rows = np.tril_indices(N_LANDMARKS)
    values = as_list(triangle, "covariance", len(rows[0]))
    if len(values) != len(rows[0]):
        raise DataError("covariance has {values} numbers, not {rows}", values=len(values), rows=len(rows[0]))
    matrix = np.zeros((N_LANDMARKS, N_LANDMARKS))
    matrix[rows] = [as_number(value, "covariance", -_MAX_VARIANCE, _MAX_VARIANCE) for value in values]
    matrix += np.tril(matrix, -1).T
    least, *_, largest = linalg.eigvalsh(matrix).tolist()
    if least < -_ROUNDING * largest or largest < 0.0:
        raise DataError("covariance is not a covariance matrix")
    return matrix


def _step(data: dict[str, Any]) -> GreedyStep:
    if data.get("action") not in _ACTIONS:
        raise DataError("the action of a step is {value}", value=shown(data.get("action")))
    error = data.get("error")
    unknown = isinstance(error, float) and isnan(error)  # for steps made by hand
    return GreedyStep(
        action=data["action"],
        landmark=_landmark(data.get("landmark")),
        region=as_integer(data.get("region"), "the region of a step", 0, len(REGIONS) - 1),
        reason=as_text(data.get("reason"), "the reason of a step"),
        points=as_integer(data.get("points"), "the points of a step", 0, N_LANDMARKS),
        error=nan if unknown else as_number(error, "the error of a step", 0.0, _MAX_ERROR),
        frame=as_integer(data.get("frame"), "the frame of a step", 0, 2**31),
        worst=_landmark(data.get("worst")),
    )


def parse_landmarks(text: str) -> list[int]:
    """Parse iBUG numbers and ranges such as "17,19-21" as positions in the 66 landmarks; an empty text gives none.

    Ranges skip 60 and 64, which are not among the 66 landmarks. Raises HeadError if the text is anything else.
    """
    numbers: list[int] = []
    try:
        for part in filter(None, (part.strip() for part in text.split(","))):
            first, dash, last = part.partition("-")
            span = range(int(first), min(int(last or first), _BEYOND) + 1)
            if not span:
                raise DataError("{part} is reversed", part=part)
            if not 0 <= span[0] <= span[-1] <= _LAST:  # before a long range is expanded in memory
                raise DataError("landmarks are numbered from 0 to {last}", last=_LAST)
            numbers += [number for number in span if not dash or number not in _LEFT_OUT]
        return [int(i) for i in from_ibug(numbers)]
    except ValueError as error:
        raise HeadError(
            "{text!r} is not a list of landmarks ({error}). Use iBUG numbers such as 17,19-21.", text=text, error=error
        ) from error

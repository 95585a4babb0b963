"""A selection of control points: its settings, its steps and result, and its file."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from math import isnan, nan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, SourceError
from ..face.landmarks import IBUG68_INDICES, N_LANDMARKS, from_ibug
from ..files.reading import as_integer, as_list, as_number, as_object, as_text, parse_format, shown
from ..files.setting import Choice, setting
from ..heads.regions import REGIONS
from ..numeric import linalg
from ..numeric.arrays import FloatArray

Search = Literal["take", "paper"]
_FORMAT = "facemime-control-points-1"
_ACTIONS = ("start", "add", "drop")
_MAX_STEPS = 10_000
_MAX_ERROR = 1e3
"""Largest error in a file, in widths of the face."""
_MAX_VARIANCE = 1e15
"""Largest covariance in a file, in squared units of the head."""
_ROUNDING = 1e-3
"""Share of the largest eigenvalue by which a zero one may be negative after rounding to five digits."""


@dataclass(frozen=True)
class SelectionSettings:
    """How control points are selected for a take.

    Attributes
    ----------
    search : {"take", "paper"}
        "take" predicts landmarks by distance and by how they moved in the take, and exchanges and drops points; "paper"
        predicts them by distance alone, with a Gaussian, and only adds points.
    tolerance : float
        Error allowed at the other landmarks, as a fraction of the face's width.
    """

    search: Search = setting(
        "take",
        "Search",
        "How the control points are selected",
        choices=(
            Choice("take", "Whole Take", "Other landmarks follow as they did in the take; points may be dropped"),
            Choice("paper", "Yao et al. 2019", "Other landmarks follow by distance alone, and points are only added"),
        ),
    )
    tolerance: float = setting(
        0.01,
        "Tolerance",
        "Error allowed at the other landmarks, relative to the width of the face",
        low=0.0001,
        high=1.0,
        soft_high=0.1,
        unit="percent",
    )
    max_points: int = setting(N_LANDMARKS, "Max Points", "Maximum number of control points", low=3, high=N_LANDMARKS)


@dataclass(frozen=True)
class GreedyStep:
    """A change of the selection, and the worst error after it.

    Attributes
    ----------
    action : {"start", "add", "drop"}
        What was done.
    landmark : int
        Position in the 66 landmarks.
    region : int
        Row of `REGIONS`.
    reason : str
        A muscle, or the error that the point removes.
    points : int
        Number of control points after the step.
    error : float
        Largest error of any landmark in any frame, as a fraction of the face's width.
    frame, worst : int
        Frame and landmark of that error.
    """

    action: str
    landmark: int
    region: int
    reason: str
    points: int
    error: float
    frame: int
    worst: int


@dataclass(frozen=True)
class GreedySelection:
    """A selection of control points.

    Attributes
    ----------
    membership : (3, 66) bool
        Whether a landmark is a control point of a region.
    steps : tuple of GreedyStep
        Steps in order; users see the curve of `error` over `points`.
    tolerance : float
        Allowed error, as a fraction of the face's width.
    reached : bool
        Whether the error fell to the tolerance within the allowed number of points.
    covariance : (66, 66) float, optional
        Covariance of the landmarks' displacements in the take, by which the other landmarks follow.
    """

    membership: NDArray[np.bool_]
    steps: tuple[GreedyStep, ...]
    tolerance: float
    reached: bool
    covariance: FloatArray | None = None

    @property
    def landmarks(self) -> NDArray[np.intp]:
        """Landmarks that are control points of any region, ascending, (P,)."""
        return np.flatnonzero(self.membership.any(axis=0))

    def reason(self, landmark: int) -> str:
        """Return the reason why `landmark` was chosen; "" if it was not."""
        chosen = [step for step in self.steps if step.landmark == landmark and self.membership[step.region, landmark]]
        return "; ".join(dict.fromkeys(step.reason for step in chosen if step.action != "drop"))


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

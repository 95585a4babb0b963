"""Control points as a table and a curve, and their selection by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import IBUG68_INDICES, N_LANDMARKS
from ..heads.regions import REGIONS, membership
from ..numeric.arrays import FloatArray, IntArray
from .selection import GreedySelection, GreedyStep

BY_HAND = "added by hand"
REGION_COLOURS = ((0.10, 0.50, 0.85), (0.95, 0.65, 0.10), (0.05, 0.65, 0.45))
"""Colours of the regions upper, middle and lower in sRGB, which colour-blind people can distinguish."""


@dataclass(frozen=True)
class PointRow:
    """A row of the table of control points.

    Attributes
    ----------
    landmark : int
        Position in the 66 landmarks.
    regions : tuple of int
        Rows of `REGIONS` that it controls; empty if it is not a control point.
    order : int
        Position in the order of selection, from 1; 0 if the search did not select it.
    reason : str
        A muscle, or the error that the point removes.
    error : float
        Worst error after the point was added, as a fraction of the face's width; NaN if unknown.
    """

    landmark: int
    regions: tuple[int, ...]
    order: int = 0
    reason: str = ""
    error: float = float("nan")


def point_rows(selection: GreedySelection | None) -> list[PointRow]:
    """Return the rows of all 66 landmarks, in order; without a `selection`, all are control points."""
    if selection is None:
        return [PointRow(i, tuple(np.flatnonzero(column).tolist())) for i, column in enumerate(membership().T)]
    added: dict[int, GreedyStep] = {}
    for step in selection.steps:
        if step.action == "drop":
            if not selection.membership[step.region, step.landmark]:
                added.pop(step.landmark, None)
        else:
            added.setdefault(step.landmark, step)
    order = {landmark: place for place, landmark in enumerate(added, 1)}
    rows = []
    for landmark, column in enumerate(selection.membership.T):
        row = PointRow(landmark, tuple(np.flatnonzero(column).tolist()))
        if row.regions and landmark in added:
            row = replace(row, order=order[landmark], reason=selection.reason(landmark), error=added[landmark].error)
        rows.append(row)
    return rows


def add_by_hand(selection: GreedySelection, landmark: int) -> GreedySelection:
    """Make a landmark, a position in the 66, a control point of all its regions; raises HeadError if it already is."""
    if selection.membership[:, landmark].any():
        raise HeadError(
            "Landmark {landmark} is already a control point. Choose another one.", landmark=IBUG68_INDICES[landmark]
        )
    return _changed(selection, landmark, "add", BY_HAND, membership()[:, landmark])


def drop_by_hand(selection: GreedySelection | None, landmark: int) -> GreedySelection:
    """Remove a landmark, a position in the 66, from a selection; None stands for one of all landmarks.

    Raises HeadError if the landmark is not a control point, or is the last one of a region.
    """
    selection = selection or GreedySelection(membership(), (), 0.0, True)
    column = selection.membership[:, landmark]
    if not column.any():
        raise HeadError(
            "Landmark {landmark} is not a control point. Choose one that is.", landmark=IBUG68_INDICES[landmark]
        )
    last = [region.name for region, row in zip(REGIONS, selection.membership, strict=True) if row.sum() == 1]
    last = [name for name, has in zip([r.name for r in REGIONS], column, strict=True) if has and name in last]
    if last:
        raise HeadError(
            "It is the last control point of the region {region}. Add another one to that region first.", region=last[0]
        )
    return _changed(selection, landmark, "drop", "removed by hand", np.zeros(len(REGIONS), dtype=np.bool_))


def _changed(
    selection: GreedySelection, landmark: int, action: str, reason: str, column: NDArray[np.bool_]
) -> GreedySelection:
    table = selection.membership.copy()
    touched = np.flatnonzero(table[:, landmark] | column).tolist()
    table[:, landmark] = column
    points = int(table.any(axis=0).sum())
    steps = tuple(GreedyStep(action, landmark, region, reason, points, float("nan"), 0, 0) for region in touched)
    return replace(selection, membership=table, steps=selection.steps + steps)


def error_curve(selection: GreedySelection) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return numbers of control points, ascending, and the lowest worst error that was reached with each."""
    best: dict[int, float] = {}
    for step in selection.steps:
        if np.isfinite(step.error):
            best[step.points] = min(step.error, best.get(step.points, np.inf))
    counts = sorted(best)
    return np.array(counts, dtype=np.intp), np.array([best[count] for count in counts], dtype=np.float64)


def draw_curve(selection: GreedySelection, width: int = 320, height: int = 200) -> NDArray[np.float32]:
    """Draw the worst error, in per cent, over the number of control points, as (height, width, 4) float32.

    This is RGBA, bottom row first as in Blender. The background is transparent, and the ink is legible on light and
    dark panels.
    """
    counts, errors = error_curve(selection)
    return draw_errors(counts, errors, selection.tolerance, N_LANDMARKS, width, height)


def draw_errors(
    counts: IntArray, errors: FloatArray, level: float, most: int, width: int = 320, height: int = 200
) -> NDArray[np.float32]:
    """Draw errors (N,) over counts (N,) from 1 to `most`, as `draw_curve` does, with a horizontal line at an error."""
    picture = np.zeros((height, width, 4), dtype=np.uint8)
    left, right, low, top = 46, width - 12, height - 26, 14
    ink, line, goal = (128, 128, 128, 255), (40, 130, 220, 255), (235, 150, 30, 255)
    cv2.line(picture, (left, low), (right, low), ink, 1, cv2.LINE_AA)
    cv2.line(picture, (left, top), (left, low), ink, 1, cv2.LINE_AA)
    if len(counts) == 0:
        return picture.astype(np.float32)[::-1] / 255.0
    largest = max(float(errors.max()), level, 1e-9) * 1.05
    across = left + (right - left) * (counts - 1) / max(most - 1, 1)
    up = low - (low - top) * errors / largest
    place = round(low - (low - top) * level / largest)
    cv2.line(picture, (left, place), (right, place), goal, 1, cv2.LINE_AA)
    points = np.round(np.stack([across, up], axis=1)).astype(np.int32)
    cv2.polylines(picture, [points], False, line, 2, cv2.LINE_AA)
    for x, y in points.tolist():
        cv2.circle(picture, (x, y), 3, line, -1, cv2.LINE_AA)
    for text, at in (
        (f"{100 * largest:.1f}%", (2, top + 8)),
        (f"{100 * level:.1f}%", (2, max(place + 4, top + 24))),
        ("1", (left, height - 8)),
        (str(most), (right - 16, height - 8)),
    ):
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, 1, cv2.LINE_AA)
    return np.ascontiguousarray(picture[::-1], dtype=np.float32) / 255.0


def region_colours(weights: NDArray[np.float32] | NDArray[np.float64], opacity: float) -> NDArray[np.float32]:
    """Colour vertices by their region weights (3, V): RGBA (V, 4), transparent outside all regions.

    `opacity` is reached where the weights sum to 1.
    """
    weights = np.clip(np.asarray(weights, dtype=np.float32), 0.0, 1.0)
    total = weights.sum(axis=0)
    colours = np.zeros((weights.shape[1], 4), dtype=np.float32)
    colours[:, :3] = (weights.T @ np.array(REGION_COLOURS, dtype=np.float32)) / np.maximum(total, 1e-6)[:, None]
    colours[:, 3] = opacity * np.minimum(total, 1.0)
    return colours

"""Coefficients over time as a take, as an ideal tracker would have recorded it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .from_animation import IMAGE_SIZE
from .from_coefficients import coefficient_face
from .take import Take, TakeRecorder, describe

_RATE = 30.0
"""Rate in Hz of a take with a single frame."""


def coefficient_take(
    name: str,
    times: FloatArray,
    values: FloatArray,
    rotations: Iterable[FloatArray],
    *,
    positions: FloatArray | None = None,
    eyes: Iterable[FloatArray | None] | None = None,
    found: NDArray[np.bool_] | None = None,
    notes: Sequence[str] = (),
) -> Take:
    """Return coefficients over time as a take.

    Parameters
    ----------
    name : str
        Of the file that they come from.
    times : (N,) float64
        Seconds, increasing.
    values : (N, 52) float64
        Coefficients in the order of `COEFFICIENTS`.
    rotations : N arrays (3,)
        Pitch, yaw and roll of the head in radians, as in `TrackResult`.
    positions : (N, 3) float64, optional
        Translations of the head: head frame, metres.
    eyes : N arrays (2, 2) or None, optional
        As for `CoefficientFace.result`.
    found : (N,) bool, optional
        Which frames have a face; all by default.
    notes : sequence of str
        What was assumed; they are in ``info["notes"]``.
    """
    count, face = len(times), coefficient_face()
    rate = 1.0 / float(np.median(np.diff(times))) if count > 1 else _RATE
    recorder = TakeRecorder(
        describe(name, min(max(rate, 1e-3), 1e5), IMAGE_SIZE, "coefficients")
        | {"measured": True, "calibration": face.neutral.to_dict()}
    )
    moved = np.zeros((count, 3)) if positions is None else positions
    looks = [None] * count if eyes is None else eyes
    seen = np.ones(count, dtype=bool) if found is None else found
    for time, row, turn, move, look, there in zip(times.tolist(), values, rotations, moved, looks, seen, strict=True):
        result = face.result(row, turn, move, eyes=look)
        recorder.append(time, result if there else TrackResult.nothing(len(result.shape_params)))
    take = recorder.finish()
    return replace(take, info=take.info | ({"notes": list(notes)} if notes else {}))

"""Values of shape keys or coefficients over time, as takes: what programs other than trackers record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..face.names import N_COEFFICIENTS
from ..heads.key_presets import best_preset
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .measured import IMAGE_SIZE, coefficient_face
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
    """Return coefficients over time as a take, from a file called `name`.

    The arrays are times (N,) in seconds, increasing; `values` (N, 52) in the order of `COEFFICIENTS`; N pitches, yaws
    and rolls of the head in radians, as in `TrackResult`; its translations (N, 3) in the head frame, in metres; N
    `eyes` (2, 2) or None, as for `CoefficientFace.result`; and which frames have a face, by default all. The notes, on
    what was assumed, are in ``info["notes"]``.
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


@dataclass(frozen=True)
class CoefficientTrack:
    """A performance as coefficients.

    Attributes
    ----------
    times : (N,) float64
        Seconds, increasing.
    values : (N, 52) float64
        Coefficients in the order of `COEFFICIENTS`.
    rotations : (N, 3) float64 or None
        Pitch, yaw and roll of the head in radians, as in `TrackResult`.
    positions : (N, 3) float64 or None
        Translations of the head: head frame, metres.
    found : (N,) bool or None
        Which frames have a face; all by default.
    notes : list of str
        What was assumed.
    """

    times: FloatArray
    values: FloatArray
    rotations: FloatArray | None = None
    positions: FloatArray | None = None
    found: NDArray[np.bool_] | None = None
    notes: list[str] = field(default_factory=list)


def coefficients_of_keys(curves: Mapping[str, FloatArray]) -> tuple[FloatArray, list[str]]:
    """Return the coefficients (N, 52) that the values (N,) of shape keys, by their names, show.

    The notes that are returned with them state the set of keys that was recognised, and what it lacks. Raises
    ValueError if the names are not of a known set.
    """
    table = best_preset(list(curves))
    if table is None:
        raise DataError("none of its {curves} curves has the name of a known expression", curves=len(curves))
    length = len(next(iter(curves.values())))
    values = table.invert(curves, np.zeros((length, N_COEFFICIENTS)))
    return values, [table.summary()]


def recorded(performance: CoefficientTrack, name: str) -> Take:
    """Return a performance as a take; raises ValueError if it has no frame, or its times do not increase."""
    times = performance.times - performance.times[:1]
    if not len(times):
        raise DataError("it has no frames")
    if (np.diff(times) <= 0.0).any():
        raise DataError("its times do not increase")
    still = np.zeros((len(times), 3))
    return coefficient_take(
        name,
        times,
        performance.values,
        still if performance.rotations is None else performance.rotations,
        positions=performance.positions,
        found=performance.found,
        notes=performance.notes,
    )

"""Values of shape keys over time, of any known set, as takes: what programs other than trackers write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..bake.key_map import best_preset
from ..errors import DataError
from ..face.coefficient_names import N_COEFFICIENTS
from ..numeric.arrays import FloatArray
from ..takes.coefficient_take import coefficient_take
from ..takes.take import Take


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
    """Return the coefficients that the values of shape keys show.

    Parameters
    ----------
    curves : mapping of str to (N,) array
        Values by the name of the key.

    Returns
    -------
    values : (N, 52) float64
    notes : list of str
        The set that was recognised, and what it lacks.

    Raises
    ------
    ValueError
        If the names are not of a known set.
    """
    table = best_preset(list(curves))
    if table is None:
        raise DataError("none of its {curves} curves has the name of a known expression", curves=len(curves))
    length = len(next(iter(curves.values())))
    values = table.invert(curves, np.zeros((length, N_COEFFICIENTS)))
    return values, [table.summary()]


def recorded(performance: CoefficientTrack, name: str) -> Take:
    """Return a performance as a take.

    Parameters
    ----------
    name : str
        Of the file that it comes from.

    Raises
    ------
    ValueError
        If the times do not increase, or there is no frame.
    """
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

"""What a sender sends at this moment, as a table for whoever sets it up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..face.coefficient_names import COEFFICIENTS, N_COEFFICIENTS
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .protocols.frames import FaceValues

_COLUMNS = 3
"""Columns of the table, which fit into 80 characters."""
_WIDTH = 26
"""Characters in each column."""
_AXES = ("Pitch", "Yaw", "Roll")


@dataclass(frozen=True)
class Incoming:
    """The newest frame of a sender, before it is played.

    Attributes
    ----------
    sender : str
        Address and name of the sender.
    rate : float
        Frames per second.
    found : bool
        Whether the sender sees a face.
    rotation : (3,) float64
        Pitch, yaw and roll of the head in degrees, as in `TrackResult`.
    coefficients : (52,) float64
        Coefficients in the order of `COEFFICIENTS`; NaN if the protocol has none.
    """

    sender: str
    rate: float
    found: bool
    rotation: FloatArray
    coefficients: FloatArray

    def rows(self) -> list[tuple[str, float]]:
        """Return the values with their names; none if there is no face, or the protocol has no values."""
        known = self.found and bool(np.isfinite(self.coefficients).all())
        return list(zip(COEFFICIENTS, self.coefficients.tolist(), strict=True)) if known else []

    def pose(self) -> str:
        """Return the rotation of the head as text."""
        return ", ".join(f"{axis} {angle:.0f}°" for axis, angle in zip(_AXES, self.rotation, strict=True))


def incoming(sender: str, rate: float, face: FaceValues | TrackResult | None) -> Incoming:
    """Return what a sender sends.

    Parameters
    ----------
    sender : str
        Address and name of the sender.
    rate : float
        Frames per second.
    face : FaceValues, TrackResult or None
        Its newest frame; None for no face.

    Returns
    -------
    Incoming
        The same as numbers for a table.
    """
    rotation, coefficients = np.zeros(3), np.full(N_COEFFICIENTS, np.nan)
    if isinstance(face, TrackResult) and face.found:
        rotation, coefficients = face.pose[1:4], face.coefficients
    elif isinstance(face, FaceValues):
        rotation, coefficients = face.rotation, face.coefficients
    found = face.found if isinstance(face, TrackResult) else face is not None
    return Incoming(sender, rate, found, np.degrees(rotation), coefficients)


def table(senders: list[Incoming]) -> str:
    """Return the values of all senders as text of at most 80 columns."""
    return "\n\n".join(map(_table, senders))


def _table(one: Incoming) -> str:
    head = f"{one.sender}: {one.rate:.0f} frames/s, {one.pose() if one.found else 'no face'}"
    cells = [f"{name:<20}{value:5.2f}".ljust(_WIDTH) for name, value in one.rows()]
    height = -(-len(cells) // _COLUMNS)
    lines = ["".join(cells[row::height]).rstrip() for row in range(height)]
    return "\n".join([head, *lines])

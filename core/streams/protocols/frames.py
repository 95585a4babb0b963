"""The content of packets with faces, whatever their protocol, and the checks that all decoders share.

Packets come from strangers. A decoder bounds what it reads, and refuses anything else with a `PacketError`, whose
messages are constants, so that a bad packet costs next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Protocol

import numpy as np

from ...face.names import N_COEFFICIENTS
from ...face.rotation import from_face_axes
from ...numeric import linalg
from ...numeric.arrays import FloatArray
from ...takes.neutral import Neutral
from ...tracking.result import TrackResult

MAX_DATAGRAM = 16_384
"""Largest size of a datagram in bytes, far more than any of the protocols sends."""
MAX_SUBJECT = 64
"""Largest number of characters in the name of a face."""
_MAX_ANGLE = 7.0
"""Largest angle of a pose in radians."""
_MAX_MOVED = 100.0
"""Largest distance of a pose in metres."""


class PacketError(ValueError):
    """A packet is malformed, or not of this protocol."""


@dataclass(frozen=True)
class FaceValues:
    """A face as coefficients.

    Attributes
    ----------
    coefficients : (52,) float64
        Coefficients in the order of `COEFFICIENTS`, 0 to 1.
    rotation : (3,) float64
        Pitch, yaw and roll of the head in radians, as in `TrackResult`.
    position : (3,) float64 or None
        Position of the head in metres: axes of the head frame, any origin.
    eyes : (2, 2) float64 or None
        `(pitch, yaw)` of the right and the left eye in radians, as for the gaze in `TrackResult`; None if they follow
        from the coefficients.
    """

    coefficients: FloatArray
    rotation: FloatArray
    position: FloatArray | None = None
    eyes: FloatArray | None = None


@dataclass(frozen=True)
class StreamFrame:
    """A frame of a stream.

    Attributes
    ----------
    face : FaceValues, TrackResult or None
        The face; None if the sender sees none.
    subject : str
        Name of the face among those of the sender.
    time : float or None
        Time in seconds on the sender's clock, if the protocol states it.
    sequence : int or None
        Number of the frame, if the protocol states it.
    neutral : Neutral or None
        The neutral face, if the protocol states it.
    """

    face: FaceValues | TrackResult | None
    subject: str = ""
    time: float | None = None
    sequence: int | None = None
    neutral: Neutral | None = None


class Decoder(Protocol):
    """Interface of a decoder for the datagrams of one sender, in order of arrival."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Return the frames that `data` completes, usually one; PacketError if it is malformed."""


class Receiver(Protocol):
    """Interface of a receiver of packets, which may have to answer them."""

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Receive a packet at a time in seconds on any clock.

        Returns the frames that it completes, usually one, and the packets to be sent back. Raises PacketError if it is
        malformed, or not from this sender.
        """


class Decoding:
    """A receiver that never answers."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Receive a packet. See `Receiver.receive`."""
        return self._decoder.decode(data), []


def no_coefficients() -> FloatArray:
    """Return coefficients of a face at rest, (52,), to be filled in."""
    return np.zeros(N_COEFFICIENTS)


def checked(face: FaceValues) -> FaceValues:
    """Return a face with coefficients clipped to 0 and 1; PacketError if a number of it is impossible."""
    position = np.zeros(3) if face.position is None else face.position
    if not (
        np.isfinite(face.coefficients).all()
        and (np.abs(face.rotation) <= _MAX_ANGLE).all()
        and (np.abs(position) <= _MAX_MOVED).all()
    ):
        raise PacketError("a number is impossible")
    return replace(face, coefficients=np.clip(face.coefficients, 0.0, 1.0))


def finite(value: float) -> float:
    """Return a number; PacketError if it is NaN or infinite."""
    if not isfinite(value):
        raise PacketError("a number is not finite")
    return value


def turned(x: float, y: float, z: float) -> FloatArray:
    """Convert radians as `from_face_axes` does; raises PacketError if one is impossible."""
    return from_face_axes(possible(x), possible(y), possible(z))


def possible(angle: float) -> float:
    """Return an angle in radians; PacketError if no head or eye turns as far."""
    if not abs(angle) <= _MAX_ANGLE:
        raise PacketError("an angle is impossible")
    return angle


def from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """Convert a quaternion, w its real part, to a rotation (3, 3); raises PacketError if its length is far from 1."""
    size = finite(x * x + y * y + z * z + w * w)
    if not 0.25 <= size <= 4.0:
        raise PacketError("a rotation has no length")
    return np.asarray(linalg.part("spatial.transform").Rotation.from_quat((x, y, z, w)).as_matrix())

"""What a packet says of a face, whatever its protocol, and the checks that all decoders share.

Packets come from strangers. A decoder bounds what it reads, and refuses anything else with a `PacketError`, whose
messages are constants, so that a bad packet costs next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Protocol

import numpy as np

from ..arrays import FloatArray
from ..coefficient_names import N_COEFFICIENTS
from ..rotation import from_face_axes
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult

MAX_DATAGRAM = 16_384
"""Bytes of a datagram at most, far more than any of the protocols sends."""
MAX_SUBJECT = 64
"""Letters of the name of a face at most."""
_MAX_ANGLE, _MAX_MOVED = 7.0, 100.0
"""Radians and metres beyond which a pose is refused."""


class PacketError(ValueError):
    """A packet is malformed, or not of this protocol."""


@dataclass(frozen=True)
class FaceValues:
    """A face as coefficients.

    Attributes
    ----------
    coefficients : (52,) float64
        In the order of `COEFFICIENTS`, 0 to 1.
    rotation : (3,) float64
        Pitch, yaw and roll of the head, radians, as in `TrackResult`.
    position : (3,) float64 or None
        Of the head: axes of the head frame, metres, from any origin.
    """

    coefficients: FloatArray
    rotation: FloatArray
    position: FloatArray | None = None


@dataclass(frozen=True)
class StreamFrame:
    """A frame of a stream.

    Attributes
    ----------
    face : FaceValues, TrackResult or None
        None if the sender sees no face.
    subject : str
        Which of the sender's faces it is.
    time : float or None
        Seconds on the sender's clock, if the protocol states them.
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
    """Decodes the datagrams of one sender, in the order of their arrival."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Return the frames that `data` completes, most often one; PacketError if it is malformed."""


class Receiver(Protocol):
    """Takes the packets of a protocol in which the receiver may have to answer."""

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Take a packet.

        Parameters
        ----------
        data : bytes
        now : float
            Seconds on any clock.

        Returns
        -------
        frames : list of StreamFrame
            That `data` completes, most often one.
        answers : list of bytes
            Packets to be sent back.

        Raises
        ------
        PacketError
            If it is malformed, or not of this sender.
        """


class Decoding:
    """A receiver that never answers.

    Parameters
    ----------
    decoder : Decoder
    """

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Take a packet; as `Receiver.receive`."""
        return self._decoder.decode(data), []


def no_coefficients() -> FloatArray:
    """(52,) coefficients of a face at rest, to be filled in."""
    return np.zeros(N_COEFFICIENTS)


def checked(face: FaceValues) -> FaceValues:
    """Return a face whose numbers are possible, with coefficients within 0 and 1; PacketError if they are not."""
    position = np.zeros(3) if face.position is None else face.position
    if not (
        np.isfinite(face.coefficients).all()
        and (np.abs(face.rotation) <= _MAX_ANGLE).all()
        and (np.abs(position) <= _MAX_MOVED).all()
    ):
        raise PacketError("a number is impossible")
    return FaceValues(np.clip(face.coefficients, 0.0, 1.0), face.rotation, face.position)


def finite(value: float) -> float:
    """Return a number; PacketError if it is NaN or infinite."""
    if not isfinite(value):
        raise PacketError("a number is not finite")
    return value


def turned(x: float, y: float, z: float) -> FloatArray:
    """(3,) pitch, yaw and roll of angles as `from_face_axes` takes them; PacketError if they are impossible."""
    if not all(abs(finite(angle)) <= _MAX_ANGLE for angle in (x, y, z)):
        raise PacketError("an angle is impossible")
    return from_face_axes(x, y, z)


def from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion that is nearly of unit length; PacketError if it is not."""
    size = finite(x * x + y * y + z * z + w * w)
    if not 0.25 <= size <= 4.0:
        raise PacketError("a rotation has no length")
    x, y, z, w = (value / size**0.5 for value in (x, y, z, w))
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def to_quaternion(turn: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w), w at least 0, of a rotation matrix (3, 3)."""
    # The symmetric matrix whose greatest eigenvalue is 1 and has the quaternion as its eigenvector (Bar-Itzhack 2000).
    t = turn
    k = np.array(
        [
            [t[0, 0] - t[1, 1] - t[2, 2], t[1, 0] + t[0, 1], t[2, 0] + t[0, 2], t[2, 1] - t[1, 2]],
            [0.0, t[1, 1] - t[0, 0] - t[2, 2], t[2, 1] + t[1, 2], t[0, 2] - t[2, 0]],
            [0.0, 0.0, t[2, 2] - t[0, 0] - t[1, 1], t[1, 0] - t[0, 1]],
            [0.0, 0.0, 0.0, t[0, 0] + t[1, 1] + t[2, 2]],
        ]
    )
    vector = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    x, y, z, w = (vector if vector[3] >= 0.0 else -vector).tolist()
    return x, y, z, w

"""Face Cap: OSC messages for the head, the eyes, and each coefficient by its number (streams.md)."""

from __future__ import annotations

from math import pi

import numpy as np

from ...face.names import COEFFICIENT_INDEX
from ...numeric.arrays import FloatArray
from . import osc
from .frames import FaceValues, PacketError, StreamFrame, checked, no_coefficients, turned

PORT = 8080
NAMES: tuple[str, ...] = (
    *("browInnerUp", "browDownLeft", "browDownRight", "browOuterUpLeft", "browOuterUpRight", "eyeLookUpLeft"),
    *("eyeLookUpRight", "eyeLookDownLeft", "eyeLookDownRight", "eyeLookInLeft", "eyeLookInRight", "eyeLookOutLeft"),
    *("eyeLookOutRight", "eyeBlinkLeft", "eyeBlinkRight", "eyeSquintLeft", "eyeSquintRight", "eyeWideLeft"),
    *("eyeWideRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight"),
    *("jawOpen", "jawForward", "jawLeft", "jawRight", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight"),
    *("mouthRollUpper", "mouthRollLower", "mouthShrugUpper", "mouthShrugLower", "mouthClose", "mouthSmileLeft"),
    *("mouthSmileRight", "mouthFrownLeft", "mouthFrownRight", "mouthDimpleLeft", "mouthDimpleRight"),
    *("mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthPressLeft"),
    *("mouthPressRight", "mouthStretchLeft", "mouthStretchRight", "tongueOut"),
)
"""The coefficients in the order of their numbers in this protocol."""
_COLUMNS = tuple(COEFFICIENT_INDEX[name] for name in NAMES)
_ADDRESSES = ("/W", "/HT", "/HR", "/HRQ", "/ELR", "/ERR")


class FaceCapDecoder:
    """Collects the messages of a frame, which ends with a bundle or with the last coefficient."""

    def __init__(self) -> None:
        self._coefficients = no_coefficients()
        self._rotation: FloatArray = np.zeros(3)
        self._position: FloatArray | None = None
        self._ends = self._any_value = False

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram. See `Decoder.decode`."""
        self._ends, self._any_value = osc.is_bundle(data), False
        osc.read_each(data, self._read)
        if not (self._ends and self._any_value):
            return []
        return [StreamFrame(checked(FaceValues(self._coefficients.copy(), self._rotation, self._position)))]

    def _read(self, message: osc.Message) -> bool:
        """Read a message; returns whether it is one of Face Cap."""
        address, arguments = message
        if address == "/W":
            self._value(*osc.numbers(arguments, 2))
        elif address == "/HR":
            self._rotation = turned(*(angle * pi / 180.0 for angle in osc.numbers(arguments, 3)))
        elif address == "/HT":
            position = np.array(osc.numbers(arguments, 3)) * (1.0, -1.0, -1.0)
            self._position = checked(FaceValues(self._coefficients, self._rotation, position)).position
        return address in _ADDRESSES

    def _value(self, number: float, value: float) -> None:
        if number not in range(len(NAMES)):
            raise PacketError("not a coefficient")
        self._coefficients[_COLUMNS[int(number)]] = value
        self._any_value, self._ends = True, self._ends or number == len(NAMES) - 1

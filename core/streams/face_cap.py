"""Face Cap: OSC messages for the head, the eyes, and each coefficient by its number (docs/streams.md)."""

from __future__ import annotations

from math import pi

import numpy as np

from ..arrays import FloatArray
from ..coefficient_names import COEFFICIENT_INDEX
from . import osc
from .frames import FaceValues, PacketError, StreamFrame, checked, finite, no_coefficients, turned

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
_COUNTS = {"/HT": 3, "/HR": 3, "/HRQ": 4, "/ELR": 2, "/ERR": 2}
"""Number of floats in each message that is not a coefficient."""


class FaceCapDecoder:
    """Collects the messages of a frame, which ends with a bundle or with the last coefficient."""

    def __init__(self) -> None:
        self._coefficients = no_coefficients()
        self._rotation: FloatArray = np.zeros(3)
        self._position: FloatArray | None = None

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram. See `Decoder.decode`."""
        messages = osc.decode(data)
        ends, any_value = osc.is_bundle(data), False
        for address, arguments in messages:
            if address == "/W":
                number = self._value(arguments)
                any_value, ends = True, ends or number == len(NAMES) - 1
            elif (count := _COUNTS.get(address)) is not None:
                self._pose(address, _floats(arguments, count))
            else:
                raise PacketError("not Face Cap")
        if not (ends and any_value):
            return []
        return [StreamFrame(checked(FaceValues(self._coefficients.copy(), self._rotation, self._position)))]

    def _value(self, arguments: tuple[osc.Argument, ...]) -> int:
        if len(arguments) != 2:
            raise PacketError("not a coefficient")
        number, value = arguments
        if type(number) is not int or not 0 <= number < len(NAMES) or not isinstance(value, float):
            raise PacketError("not a coefficient")
        self._coefficients[_COLUMNS[number]] = finite(value)
        return number

    def _pose(self, address: str, values: tuple[float, ...]) -> None:
        if address == "/HR":
            self._rotation = turned(*(angle * pi / 180.0 for angle in values))
        elif address == "/HT":
            self._position = np.array(values) * (1.0, -1.0, -1.0)


def _floats(arguments: tuple[osc.Argument, ...], count: int) -> tuple[float, ...]:
    values = tuple(value for value in arguments if isinstance(value, float))
    if len(values) != count or len(arguments) != count:
        raise PacketError("numbers are missing")
    return values

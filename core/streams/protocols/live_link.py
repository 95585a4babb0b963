"""Live Link Face, sent by Epic's iPhone app in its ARKit mode and received by Unreal Engine (streams.md).

All numbers are big-endian: the version as a byte; the device and the subject, each as its length and UTF-8; the number
of the frame, its fraction, the rate's numerator and denominator; and, if there is a face, a count of 61 and as many
floats.
"""

from __future__ import annotations

import struct
from math import pi
from typing import Literal

import numpy as np

from ...face.names import COEFFICIENT_INDEX
from ...heads.built_in import LOOKS, eyes_of_gaze, gaze_of
from ...takes.coefficient_table import LIVE_LINK_ORDER
from ...takes.table_angles import EYES, HEAD, eye_angles, eye_directions, head_angles, head_rotation
from .frames import MAX_SUBJECT, FaceValues, PacketError, StreamFrame, checked, no_coefficients, possible

PORT = 11111
Angles = Literal["radians", "degrees", "half-turns"]
ANGLES: dict[Angles, float] = {"radians": 1.0, "degrees": pi / 180.0, "half-turns": pi}
"""Radians per unit. The app sends radians; senders modelled on Unreal's plug-in send shares of 180 degrees."""
_SWAPPED = {"jawLeft": "jawRight", "jawRight": "jawLeft", "mouthLeft": "mouthRight", "mouthRight": "mouthLeft"}
CURVES: tuple[str, ...] = tuple(_SWAPPED.get(name, name) for name in LIVE_LINK_ORDER)
"""The coefficients in the order of this protocol; nine angles follow."""
_COLUMNS = np.array([COEFFICIENT_INDEX[name] for name in CURVES])
_VERSIONS = range(6, 10)
_LENGTH = struct.Struct(">I")
_TIME = struct.Struct(">IfII")
_FACE = struct.Struct(">B61f")
_MAX_TEXT = 256
_MAX_RATE = 1000.0


class LiveLinkDecoder:
    """Decodes Live Link Face from a sender whose angles are in "radians", "degrees" or "half-turns"."""

    def __init__(self, angles: Angles = "radians") -> None:
        self._unit = ANGLES[angles]

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a packet. See `Decoder.decode`."""
        if len(data) < 25 or data[0] not in _VERSIONS:
            raise PacketError("not Live Link Face")
        _, at = _text(data, 1)
        subject, at = _text(data, at)
        if at + _TIME.size > len(data):
            raise PacketError("a packet is truncated")
        number, part, rate, per = _TIME.unpack_from(data, at)
        if not (0.0 <= part <= 1.0 and per and 0.0 < rate / per <= _MAX_RATE):
            raise PacketError("a time is impossible")
        time = (number + part) * per / rate
        rest = data[at + _TIME.size :]
        if not rest:
            return [StreamFrame(None, subject, time)]
        if len(rest) != _FACE.size or rest[0] != len(CURVES) + len(HEAD) + len(EYES):
            raise PacketError("not 61 values")
        values = _FACE.unpack(rest)[1:]
        coefficients = no_coefficients()
        coefficients[_COLUMNS] = values[:52]
        angles = np.array([possible(value * self._unit) for value in values[52:]])
        face = FaceValues(coefficients, head_rotation(*angles[:3].tolist()), eyes=eye_directions(angles[3:]))
        return [StreamFrame(checked(face), subject, time)]


def encode(face: FaceValues | None, time: float, *, subject: str, device: str, rate: int = 60) -> bytes:
    """Encode a frame with angles in radians, or without a face, for the named face and sender.

    The time in seconds, at least 0, is counted in frames at `rate` per second.
    """
    whole, part = divmod(max(time, 0.0) * rate, 1.0)
    head = b"\x06" + b"".join(_LENGTH.pack(len(raw)) + raw for raw in (device.encode(), subject.encode()))
    head += _TIME.pack(int(whole) & 0xFFFFFFFF, part, rate, 1)
    if face is None:
        return head
    eyes = eyes_of_gaze(*gaze_of(face.coefficients[LOOKS])) if face.eyes is None else face.eyes
    values = face.coefficients[_COLUMNS].tolist()
    return head + _FACE.pack(61, *values, *head_angles(face.rotation), *eye_angles(eyes))


def _text(data: bytes, at: int) -> tuple[str, int]:
    if at + 4 > len(data):
        raise PacketError("a packet is truncated")
    (length,) = _LENGTH.unpack_from(data, at)
    end = at + 4 + length
    if length > _MAX_TEXT or end > len(data):
        raise PacketError("a text is too long")
    try:
        return data[at + 4 : end].decode("utf-8")[:MAX_SUBJECT], end
    except UnicodeDecodeError:
        raise PacketError("a text is not UTF-8") from None

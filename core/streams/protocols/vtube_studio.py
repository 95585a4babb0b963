"""VTube Studio's iPhone app and MeowFace: JSON, sent for as long as a request allows (streams.md)."""

from __future__ import annotations

import json
from math import pi
from typing import Any, TypeGuard

import numpy as np

from ...face.names import combined
from ...files.reading import parse_json
from .frames import MAX_DATAGRAM, FaceValues, PacketError, StreamFrame, checked, finite, no_coefficients, turned

PORT = 21412
"""Port of the phone, which answers on a port named in the request."""
_LEASE = 5
"""Seconds that a request asks for; the phone allows 0.5 to 10."""
_MAX_ENTRIES = 1000
"""Largest number of values in a packet."""
_MAX_TIME = 1e13
"""Largest time of a packet in milliseconds."""


def request(port: int) -> bytes:
    """Encode a request for the phone to send to `port`, which has to be repeated within five seconds."""
    # Programs that do this are divided over the name of the duration.
    lease = {"time": _LEASE, "sendForSeconds": _LEASE}
    asked = {"messageType": "iOSTrackingDataRequest", **lease, "sentBy": "Facemime", "ports": [port]}
    return json.dumps(asked).encode()


class VTubeStudioDecoder:
    """Decodes the phone's answers."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a packet. See `Decoder.decode`."""
        if len(data) > MAX_DATAGRAM or not data.startswith(b"{"):
            raise PacketError("not VTube Studio")
        try:
            packet = parse_json(data)
        except ValueError:
            raise PacketError("not JSON") from None
        found, stamp = packet.get("FaceFound"), packet.get("Timestamp")
        if not isinstance(found, bool):
            raise PacketError("the face is missing")
        # Programs that send as the phone does leave the time out, or always send 0.
        time = 1e-3 * stamp if _is_number(stamp) and 0 < stamp <= _MAX_TIME else None
        if not found:
            return [StreamFrame(None, time=time)]
        coefficients = _coefficients(packet.get("BlendShapes"))
        # Named like the parameters of VTube Studio: x to the performer's left, y down, z as about the axis.
        x, y, z = _vector(packet.get("Rotation")) or (0.0, 0.0, 0.0)
        rotation = turned(*(angle * pi / 180.0 for angle in (y, x, z)))
        # In centimetres, to the viewer's right, up, and towards the viewer.
        place = _vector(packet.get("Position"))
        position = None if place is None else 0.01 * np.array(place) * (1.0, -1.0, -1.0)
        return [StreamFrame(checked(FaceValues(coefficients, rotation, position)), time=time)]


def _coefficients(entries: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    if not isinstance(entries, list) or len(entries) > _MAX_ENTRIES:
        raise PacketError("the values are missing")
    stated = [(str(entry.get("k")), entry.get("v")) for entry in entries if isinstance(entry, dict)]
    known = combined((name, value) for name, value in stated if _is_number(value))
    if not known:
        raise PacketError("the values are missing")
    coefficients = no_coefficients()
    coefficients[list(known)] = list(known.values())
    return coefficients


def _vector(value: Any) -> tuple[float, float, float] | None:
    """Return a vector; None if it is missing."""
    if not isinstance(value, dict) or not all(_is_number(value.get(axis)) for axis in "xyz"):
        return None
    x, y, z = (finite(float(value[axis])) for axis in "xyz")
    return x, y, z


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)

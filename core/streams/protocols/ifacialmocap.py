"""iFacialMocap and Facemotion3d, versions 1 and 2, which are text; for version 3 see `face_motion` (streams.md).

The phone sends only after a start message. A packet is `name-percent|...|` (1) or `name&percent|...|` (2), followed by
the head's angles in degrees and its position in metres after `=head#`, and the angles of the eyes. Other programs write
the same with other white space, more fields, and without a `|` before the `=`, so each part is read by itself.
"""

from __future__ import annotations

import re
from math import pi

import numpy as np
from numpy.typing import NDArray

from ...face.names import combined
from .frames import MAX_DATAGRAM, FaceValues, PacketError, StreamFrame, checked, no_coefficients, turned

PORT = 49983
"""Port of the receiver."""
PHONE_PORT = 49983
"""Port of iFacialMocap on the phone."""
FACEMOTION_PORT = 49993
"""Port of Facemotion3D on the phone."""
START = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719|sendDataVersion=v2"
FACEMOTION_START = b"FACEMOTION3D_OtherStreaming"
"""Messages that ask the phone to send, to `PHONE_PORT` and `FACEMOTION_PORT`."""
TCP_PORT = 49986
"""Port of the receiver to which the apps connect if they are asked for TCP."""
TCP_START = b"iFacialMocap_UDPTCP_sahuasouryya9218sauhuiayeta91555dy3719|sendDataVersion=v2"
TCP_STOP = b"iFacialMocap_UDPTCPSTOP_sahuasouryya9218sauhuiayeta91555dy3719"
FACEMOTION_TCP_START = FACEMOTION_START + b"|protocol=tcp"
FACEMOTION_STOP = b"StopStreaming_FACEMOTION3D"
"""Datagrams to the same ports that ask the phone to connect, and to end."""
TCP_END = b"___iFacialMocap"
"""End of each packet of iFacialMocap over TCP."""
FACEMOTION_TCP_END = b"___FACEMOTION3D"
"""End of each packet of Facemotion3D over TCP."""
_NUMBER = r"[+-]?\d{1,6}(?:\.\d{0,20})?(?:[eE][+-]?\d{1,2})?"
_VALUE = re.compile(rf"([^-&#]{{1,64}})[-&]({_NUMBER})")
_HEAD = re.compile(rf"head#({_NUMBER}(?:,{_NUMBER}){{2,5}})")
_PARTS = re.compile(r"[|=]")
_TRACKED = "trackingStatus"
_MAX_PARTS = 5000
"""Largest number of parts of a packet."""


class IFacialMocapDecoder:
    """Decodes both versions. A packet without the head leaves it as it was."""

    def __init__(self) -> None:
        self._head: tuple[float, ...] = (0.0, 0.0, 0.0)

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a packet. See `Decoder.decode`."""
        if len(data) > MAX_DATAGRAM:
            raise PacketError("not iFacialMocap")
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            raise PacketError("not iFacialMocap") from None
        parts = _PARTS.split("".join(text.split()), _MAX_PARTS)
        values = {entry[1]: entry[2] for part in parts if (entry := _VALUE.fullmatch(part)) is not None}
        if _TRACKED in values and float(values.pop(_TRACKED)) == 0.0:
            return [StreamFrame(None)]
        known = combined((name, 0.01 * float(value)) for name, value in values.items())
        if not known:
            raise PacketError("no value of a face")
        coefficients = no_coefficients()
        coefficients[list(known)] = list(known.values())
        poses = [pose[1] for part in parts if (pose := _HEAD.fullmatch(part)) is not None]
        head = tuple(map(float, poses[0].split(","))) if poses else self._head
        face = phone_face(coefficients, head)
        self._head = head
        return [StreamFrame(face)]


def phone_face(coefficients: NDArray[np.float64], head: tuple[float, ...]) -> FaceValues:
    """Return a face from the values that the apps state in every version of the protocol.

    `head` has three angles in degrees, and a position in metres unless it is unknown, in ARKit's axes: to the viewer's
    right, up, and towards the viewer. Raises PacketError if a number is impossible.
    """
    rotation = turned(*(angle * pi / 180.0 for angle in head[:3]))
    position = np.array(head[3:6]) * (1.0, -1.0, -1.0) if len(head) >= 6 else None
    return checked(FaceValues(coefficients, rotation, position))

"""iFacialMocap and Facemotion3d, versions 1 and 2, which are text; for version 3 see `face_motion` (docs/streams.md).

The phone sends only after a start message. A packet is `name-percent|...|` (1) or `name&percent|...|` (2), followed by
the head's angles in degrees and its position in metres after `=head#`, and the angles of the eyes.
"""

from __future__ import annotations

import re
from math import pi

import numpy as np
from numpy.typing import NDArray

from ..coefficient_names import column_of
from .frames import MAX_DATAGRAM, FaceValues, PacketError, StreamFrame, checked, no_coefficients, turned

PORT, PHONE_PORT, FACEMOTION_PORT = 49983, 49983, 49993
"""Ports of the receiver, and of the two apps on the phone."""
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
TCP_END, FACEMOTION_TCP_END = b"___iFacialMocap", b"___FACEMOTION3D"
"""End of each packet over TCP."""
_VALUE = re.compile(r"([A-Za-z][A-Za-z0-9_]{0,63})[-&](-?\d{1,6}(?:\.\d{1,9})?)")
_NUMBERS = re.compile(r"=?(head|rightEye|leftEye)#(-?[\d.eE+-]{1,24}(?:,-?[\d.eE+-]{1,24}){2,5})")
_MAX_PARTS, _MIN_NAMES = 400, 10
"""Largest number of parts of a packet, and smallest number of known names."""


class IFacialMocapDecoder:
    """Decodes both versions."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a packet. See `Decoder.decode`."""
        if len(data) > MAX_DATAGRAM or not data.isascii():
            raise PacketError("not iFacialMocap")
        parts = data.decode("ascii").removesuffix("|").split("|")
        if len(parts) > _MAX_PARTS:
            raise PacketError("too many parts")
        coefficients, known, poses = no_coefficients(), 0, {}
        for part in parts:
            if (value := _VALUE.fullmatch(part)) is not None:
                if (column := column_of(value[1])) is not None:
                    coefficients[column] = 0.01 * float(value[2])
                    known += 1
            elif (numbers := _NUMBERS.fullmatch(part)) is not None:
                poses[numbers[1]] = _floats(numbers[2])
            else:
                raise PacketError("a part is neither a value nor a pose")
        head = poses.get("head", ())
        if known < _MIN_NAMES or len(head) != 6:
            raise PacketError("the face or its pose is missing")
        return [StreamFrame(phone_face(coefficients, head))]


def phone_face(coefficients: NDArray[np.float64], head: tuple[float, ...]) -> FaceValues:
    """Return a face from the values that the apps state in every version of the protocol.

    Parameters
    ----------
    coefficients : (52,) float64
        Coefficients in the order of `COEFFICIENTS`.
    head : tuple of float
        Three angles in degrees and a position in metres, in ARKit's axes: to the viewer's right, up, and towards the
        viewer.

    Returns
    -------
    FaceValues
        The face.

    Raises
    ------
    PacketError
        If a number is impossible.
    """
    rotation = turned(*(angle * pi / 180.0 for angle in head[:3]))
    return checked(FaceValues(coefficients, rotation, np.array(head[3:]) * (1.0, -1.0, -1.0)))


def _floats(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise PacketError("a pose is not numbers") from None

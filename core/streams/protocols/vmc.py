"""The VMC protocol: OSC between VTuber programs, with the expressions of VRM or ARKit (streams.md)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Literal

import numpy as np

from ...face.names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS, column_of, combined
from ...face.rotation import euler_to_matrix, matrix_to_euler, to_quaternion
from ...heads.built_in import LOOKS, looks_of_eyes
from ...heads.key_presets import presets
from ...numeric.arrays import FloatArray
from . import osc
from .frames import FaceValues, PacketError, StreamFrame, checked, from_quaternion, no_coefficients

PORT = 39539
"""Port on which avatars listen."""
Names = Literal["arkit", "vrm"]
"""Names of expressions that are sent: ARKit's, or those of VRM."""
_MAX_BUNDLE = 1400
"""Largest size of a bundle in bytes, which fits into one packet of most networks."""
_BOTH = {"lookleft": ("eyeLookOutLeft", "eyeLookInRight"), "lookright": ("eyeLookInLeft", "eyeLookOutRight")}
_SHARES: dict[str, tuple[tuple[str, float], ...]] = {
    **dict.fromkeys(("a", "aa"), (("jawOpen", 1.0),)),
    **dict.fromkeys(("i", "ih"), (("mouthStretchLeft", 0.5), ("mouthStretchRight", 0.5), ("jawOpen", 0.2))),
    **dict.fromkeys(("u", "ou"), (("mouthPucker", 1.0),)),
    **dict.fromkeys(("e", "ee"), (("mouthStretchLeft", 0.4), ("mouthStretchRight", 0.4), ("jawOpen", 0.3))),
    **dict.fromkeys(("o", "oh"), (("mouthFunnel", 0.8), ("jawOpen", 0.4))),
    "blink": (("eyeBlinkLeft", 1.0), ("eyeBlinkRight", 1.0)),
    **dict.fromkeys(("blink_l", "blinkleft"), (("eyeBlinkLeft", 1.0),)),
    **dict.fromkeys(("blink_r", "blinkright"), (("eyeBlinkRight", 1.0),)),
    **dict.fromkeys(("joy", "happy"), (("mouthSmileLeft", 1.0), ("mouthSmileRight", 1.0))),
    **dict.fromkeys(("angry",), (("browDownLeft", 1.0), ("browDownRight", 1.0))),
    **dict.fromkeys(("sorrow", "sad"), (("browInnerUp", 0.8), ("mouthFrownLeft", 0.8), ("mouthFrownRight", 0.8))),
    **dict.fromkeys(("fun", "relaxed"), (("mouthSmileLeft", 0.5), ("mouthSmileRight", 0.5))),
    "surprised": (("browOuterUpLeft", 0.8), ("browOuterUpRight", 0.8), ("eyeWideLeft", 0.6), ("eyeWideRight", 0.6)),
    "lookup": (("eyeLookUpLeft", 1.0), ("eyeLookUpRight", 1.0)),
    "lookdown": (("eyeLookDownLeft", 1.0), ("eyeLookDownRight", 1.0)),
    **{name: tuple((part, 1.0) for part in parts) for name, parts in _BOTH.items()},
}
"""VRM's expressions, in lower case, as ARKit's coefficients, for senders that have nothing else."""
_EYES = ("RightEye", "LeftEye")
_LEAST_GAZE = 1e-4
"""Smallest angle in radians of eyes that are tracked, as the bones of others are sent without a rotation."""
_MAX_GAZE = np.radians(60.0)
"""Largest angle in radians of eyes that are tracked, as some avatars have eye bones that are turned at rest."""
_MAX_NAMES = 1000
"""Largest number of names that are remembered."""
_MAX_NAME = 64
"""Largest number of characters of a name that are remembered."""


class VmcDecoder:
    """Collects the values of a frame, which ends with `/VMC/Ext/Blend/Apply`.

    Until the first one, it also ends when a value comes again, as some senders leave it out.
    """

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._bones = {name: np.eye(3) for name in ("Neck", "Head", *_EYES)}
        self._time: float | None = None
        self._tracked = True
        self._came: set[str] | None = set()

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram. See `Decoder.decode`."""
        frames: list[StreamFrame] = []
        osc.read_each(data, lambda message: self._read(message, frames))
        return frames

    def _read(self, message: osc.Message, frames: list[StreamFrame]) -> bool:
        """Read a message; returns whether it is one of VMC."""
        address, arguments = message
        kind = address.removeprefix("/VMC/Ext/")
        if kind == "Blend/Val":
            self._value(arguments, frames)
        elif kind == "Bone/Pos":
            self._bone(arguments)
        elif kind == "T":
            (self._time,) = osc.numbers(arguments, 1)
        elif kind == "OK":
            self._tracked = len(arguments) < 4 or arguments[3] != 0
        elif kind == "Blend/Apply":
            self._came = None
            frames.append(self._frame())
        return address.startswith("/VMC/")

    def _frame(self) -> StreamFrame:
        if not self._tracked:
            return StreamFrame(None, time=self._time)
        turn = self._bones["Neck"] @ self._bones["Head"]
        coefficients, eyes = _coefficients(self._values), self._eyes()
        if eyes is not None and not coefficients[LOOKS].any():
            coefficients[LOOKS] = looks_of_eyes(eyes)
        face = FaceValues(coefficients, np.array(matrix_to_euler(turn)), eyes=eyes)
        return StreamFrame(checked(face), time=self._time)

    def _eyes(self) -> FloatArray | None:
        """Return pitch and yaw of the right and left eye; None if the bones do not show them."""
        turns = np.stack([self._bones[name] for name in _EYES])
        down, across = np.arcsin(np.clip(-turns[:, 1, 2], -1.0, 1.0)), np.arctan2(turns[:, 0, 2], turns[:, 2, 2])
        eyes = np.stack([down, across], axis=1)
        size = np.abs(eyes).max()
        return eyes if _LEAST_GAZE < size < _MAX_GAZE else None

    def _value(self, arguments: tuple[osc.Argument, ...], frames: list[StreamFrame]) -> None:
        (value,) = osc.numbers(arguments[1:], 1)
        if not isinstance(arguments[0], str):
            raise PacketError("not an expression")
        name = arguments[0].lower()[:_MAX_NAME]
        if name not in self._values and len(self._values) >= _MAX_NAMES:
            raise PacketError("too many expressions")
        if self._came is not None:
            if arguments[0] in self._came:  # avatars may have names that differ in their case only
                frames.append(self._frame())
                self._came.clear()
            if len(self._came) < _MAX_NAMES:
                self._came.add(arguments[0])
        self._values[name] = value

    def _bone(self, arguments: tuple[osc.Argument, ...]) -> None:
        x, y, z, w = osc.numbers(arguments[4:], 4)
        if (name := arguments[0]) in self._bones:
            # Unity's axes are opposite to those of the head frame, so the matrices are the same.
            self._bones[str(name)] = from_quaternion(x, y, z, w)


def _coefficients(values: dict[str, float]) -> FloatArray:
    coefficients = no_coefficients()
    known = combined(values.items())
    # A sender for both kinds of avatar sends the names of one kind as 0.
    if any(known.values()):
        coefficients[list(known)] = list(known.values())
        return coefficients
    for name, value in values.items():
        for part, share in _SHARES.get(name, ()):
            coefficients[COEFFICIENT_INDEX[part]] += share * value
    return coefficients


def has_arkit_names(data: bytes) -> bool:
    """Return whether a datagram, which a program sends about its avatar, has ARKit's names of expressions."""
    try:
        messages = osc.decode(data)
    except PacketError:
        return False
    values = (arguments for address, arguments in messages if address == "/VMC/Ext/Blend/Val" and arguments)
    return any(column_of(str(name)) is not None for name, *_ in values)


def encode(face: FaceValues | None, time: float, names: Names = "arkit") -> Iterator[bytes]:
    """Encode a frame as bundles, as 52 values exceed a packet. The message that applies them comes last.

    `names` are "arkit", ARKit's with a capital, as used by avatars made for *perfect sync*; or "vrm", for all other
    avatars, the expressions of VRM 1 and VRM 0, by Facemime's key mappings. The other names are sent as 0, as an avatar
    that has both would move twice as far.
    """
    messages = [
        osc.encode_message("/VMC/Ext/OK", 1, 3, 0, int(face is not None)),
        osc.encode_message("/VMC/Ext/T", time),
    ]
    if face is not None:
        turn = to_quaternion(euler_to_matrix(*face.rotation))
        messages.append(osc.encode_message("/VMC/Ext/Bone/Pos", "Head", 0.0, 0.0, 0.0, *turn))
        expressions, gains, offsets = _expressions()
        values = np.clip(gains @ face.coefficients + offsets, 0.0, 1.0)
        is_arkits = np.arange(len(expressions)) < N_COEFFICIENTS
        values[is_arkits != (names == "arkit")] = 0.0
        for name, value in zip(expressions, values.tolist(), strict=True):
            messages.append(osc.encode_message("/VMC/Ext/Blend/Val", name, value))
    messages.append(osc.encode_message("/VMC/Ext/Blend/Apply"))
    return osc.encode_bundles(messages, _MAX_BUNDLE)


@lru_cache(maxsize=1)
def _expressions() -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return names of the expressions of ARKit, VRM 1 and VRM 0, and gains (E, 52) and offsets (E,) of each."""
    gains = {name[0].upper() + name[1:]: row for name, row in zip(COEFFICIENTS, np.eye(N_COEFFICIENTS), strict=True)}
    offsets = dict.fromkeys(gains, 0.0)
    for table in presets():
        for row in table.rows if table.name in ("VRM 0", "VRM 1") else ():
            gains.setdefault(row.key, np.zeros(N_COEFFICIENTS))[COEFFICIENT_INDEX[row.source]] += row.gain
            offsets[row.key] = offsets.get(row.key, 0.0) + row.offset
    return tuple(gains), np.stack(list(gains.values())), np.array(list(offsets.values()))

"""VRCFaceTracking: OSC from headsets to the parameters of avatars in VRChat (streams.md).

A parameter is a number, or several bits of it. An avatar has only some of the parameters, which overlap, and a sender
may send only those that changed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import asin, pi

import numpy as np

from ...face.names import COEFFICIENT_INDEX
from ...heads.built_in import LOOKS, looks_of_eyes
from ...numeric.arrays import FloatArray
from . import osc
from .frames import FaceValues, PacketError, StreamFrame, checked, no_coefficients

PORT = 9000
"""Port on which VRChat listens."""
Part = tuple[str, float, float]
"""A parameter, gain and offset; what is below 0 is cut."""
_SIDES = ("Left", "Right")
_OPEN = 0.75
"""EyeLid of an open eye; more is a wide one."""
_LID = 0.8
"""The same of version 4, whose LeftEyeLidExpanded is 1 for a wide eye."""
_PARAMETER = re.compile(r"/avatar/parameters/(?:.*/)?(\w+?)(Negative|[1-9]\d{0,2})?")
_ACTIVE = re.compile(r"/avatar/parameters/(?:.*/)?(Eye|Expression|Lip)TrackingActive")
_GAZE = "/tracking/eye/LeftRightPitchYaw"
"""VRChat's own message of the gaze of each eye, in degrees down and to the performer's right."""
_CLOSED = "/tracking/eye/EyesClosedAmount"
"""VRChat's own message of how far both eyes are closed, as a share."""
_PREFIXES = ("/avatar/", "/tracking/")
_MOVED = 5
"""Values that have to change, since a sender stated that nothing is tracked, for a face to be there all the same."""
_BITS = tuple(1 << bit for bit in range(8))


def _mean(*names: str, gain: float = 1.0) -> tuple[Part, ...]:
    return tuple((name, gain / len(names), 0.0) for name in names)


def _both(name: str, gain: float = 1.0) -> tuple[Part, ...]:
    return _mean(*(name + side for side in _SIDES), gain=gain)


def _recipes() -> dict[str, tuple[tuple[Part, ...], ...]]:
    """How each coefficient follows from parameters, from the most specific ones to those that combine the most."""
    found: dict[str, tuple[tuple[Part, ...], ...]] = {
        "browInnerUp": (
            _mean("BrowInnerUp"),
            _both("BrowInnerUp"),
            _both("BrowUp"),
            _mean("BrowUp"),
            _both("BrowExpression"),
            _mean("BrowExpression"),
        ),
        "cheekPuff": (_both("CheekPuff"), _both("CheekPuffSuck"), _mean("CheekPuffSuck")),
        "jawOpen": (_mean("JawOpen"),),
        "jawForward": (_mean("JawForward"), _mean("JawZ")),
        "jawLeft": (_mean("JawLeft"), _mean("JawX", gain=-1.0)),
        "jawRight": (_mean("JawRight"), _mean("JawX")),
        "mouthClose": (_mean("MouthClosed"),),
        "mouthShrugUpper": (_mean("MouthRaiserUpper"),),
        "mouthShrugLower": (_mean("MouthRaiserLower"),),
        "tongueOut": (_mean("TongueOut"),),
        "mouthFunnel": (
            _mean("LipFunnel"),
            _mean("LipFunnelUpper", "LipFunnelLower"),
            _both("LipFunnelUpper", 0.5) + _both("LipFunnelLower", 0.5),
            _both("LipSuckFunnelUpper", -0.5) + _both("LipSuckFunnelLower", -0.5),
            _mean("LipSuckFunnelUpper", "LipSuckFunnelLower", gain=-1.0),
        ),
        "mouthPucker": (
            _mean("LipPucker"),
            _mean("LipPuckerUpper", "LipPuckerLower"),
            _both("LipPuckerUpper", 0.5) + _both("LipPuckerLower", 0.5),
            _both("LipPucker"),
        ),
    }
    for lip in ("Upper", "Lower"):
        suck, both = f"LipSuck{lip}", f"LipSuckFunnel{lip}"
        found[f"mouthRoll{lip}"] = (_mean(suck), _both(suck), _both(both), _mean(both), _mean("LipSuck"))
    for side, sign in zip(_SIDES, (-1.0, 1.0), strict=True):
        found[f"mouth{side}"] = (
            _mean(f"MouthUpper{side}", f"MouthLower{side}"),
            _mean("MouthUpperX", "MouthLowerX", gain=sign),
            _mean("MouthX", gain=sign),
        )
    for side in _SIDES:
        found |= {f"{coefficient}{side}": recipes for coefficient, recipes in _sided(side).items()}
    return found


def _sided(side: str) -> dict[str, tuple[tuple[Part, ...], ...]]:
    """The same for a coefficient of one side, without its side."""

    def plain(name: str) -> tuple[tuple[Part, ...], ...]:
        return _mean(name + side), _mean(name)

    def each(name: str, gain: float, offset: float = 0.0) -> tuple[tuple[Part, ...], ...]:
        return ((name + side, gain, offset),), ((name, gain, offset),)

    closed, wide = each("EyeLid", -1.0 / _OPEN, 1.0), each("EyeLid", 1.0 / (1.0 - _OPEN), -_OPEN / (1.0 - _OPEN))
    squints = (*plain("EyeSquint"), _mean("EyesSquint"))
    return {
        "eyeBlink": (*plain("EyeClosed"), *each("EyeOpen", -1.0, 1.0), *closed, _mean(_CLOSED)),
        "eyeWide": (_mean(f"EyeWide{side}"), *wide, _mean("EyeWide")),
        "eyeSquint": squints,
        "browDown": (
            _mean(f"BrowDown{side}"),
            ((f"BrowLowerer{side}", 0.75, 0.0), (f"BrowPinch{side}", 0.25, 0.0)),
            _mean("BrowDown"),
            *each("BrowExpression", -1.0),
        ),
        "browOuterUp": (*plain("BrowOuterUp"), *plain("BrowUp"), *plain("BrowExpression")),
        "cheekSquint": plain("CheekSquint"),
        "noseSneer": plain("NoseSneer"),
        "mouthSmile": (
            _mean(f"MouthSmile{side}"),
            ((f"MouthCornerPull{side}", 0.8, 0.0), (f"MouthCornerSlant{side}", 0.2, 0.0)),
            _mean(f"SmileFrown{side}"),
            _mean(f"SmileSad{side}"),
            _mean("SmileFrown"),
            _mean("SmileSad"),
        ),
        "mouthFrown": (
            _mean(f"MouthFrown{side}"),
            _mean(f"MouthSad{side}"),
            _mean(f"SmileFrown{side}", gain=-1.0),
            _mean(f"SmileSad{side}", gain=-1.0),
            *each("MouthCornerY", -1.0),
            _mean("SmileFrown", gain=-1.0),
            _mean("SmileSad", gain=-1.0),
        ),
        "mouthStretch": (*plain("MouthStretch"), *each("MouthTightenerStretch", -1.0)),
        "mouthDimple": plain("MouthDimple"),
        "mouthPress": plain("MouthPress"),
        "mouthUpperUp": (*plain("MouthUpperUp"), _mean("MouthOpen")),
        "mouthLowerDown": (*plain("MouthLowerDown"), _mean("MouthOpen")),
    }


def _earlier_names() -> dict[str, str]:
    """Parameters of version 4, which older avatars have, and today's that mean the same."""
    found = {
        **{"EyesX": "EyeX", "EyesY": "EyeY", "CombinedEyeLid": "EyeOpen", "EyesWiden": "EyeWide"},
        **{"EyesSqueeze": "EyesSquint", "MouthApeShape": "MouthClosed", "MouthPout": "LipPucker"},
        **{"MouthUpperOverturn": "LipFunnelUpper", "MouthLowerOverturn": "LipFunnelLower"},
        **{"MouthUpperInside": "LipSuckUpper", "MouthLowerInside": "LipSuckLower"},
        **{"MouthLowerOverlay": "MouthRaiserLower", "TongueLongStep1": "TongueOut", "PuffSuck": "CheekPuffSuck"},
    }
    for side in _SIDES:
        found |= {f"{side}EyeX": f"Eye{side}X", f"{side}EyeY": f"Eye{side}Y", f"{side}EyeLid": f"EyeOpen{side}"}
        found |= {f"{side}EyeWiden": f"EyeWide{side}", f"{side}EyeSqueeze": f"EyeSquint{side}"}
        found |= {f"PuffSuck{side}": f"CheekPuffSuck{side}"}
    return found


_EARLIER = _earlier_names()
_EXPANDED = re.compile(r"(Left|Right|Combined)EyeLidExpanded(?:Squeeze)?")
"""Lids of version 4: shut at 0, open at `_LID` and wide at 1; below 0 they are squeezed."""
_RECIPES = tuple((COEFFICIENT_INDEX[name], recipes) for name, recipes in _recipes().items())
_KNOWN = {name for _, recipes in _RECIPES for parts in recipes for name, _, _ in parts} | {
    f"Eye{side}{axis}" for side in ("", *_SIDES) for axis in "XY"
}


class VrcFaceTrackingDecoder:
    """Collects parameters. A bundle is a frame; without bundles, a frame ends when a parameter comes again.

    Some headsets never state that they track, so values that change are a face as well.
    """

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._bits: dict[str, dict[str, bool]] = {}
        self._gaze: FloatArray | None = None
        self._active: dict[str, bool] = {}
        self._came: set[str] = set()
        self._moved = 0

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram. See `Decoder.decode`."""
        messages = [message for message in osc.decode(data) if message.address.startswith(_PREFIXES)]
        if not messages:
            raise PacketError("not VRCFaceTracking")
        frames: list[StreamFrame] = []
        bundled = osc.is_bundle(data)
        for address, arguments in messages:
            if address in self._came and not bundled:
                frames.append(self._frame())
                self._came.clear()
            if self._read(address, arguments):
                self._came.add(address)
        if bundled and self._came:
            frames.append(self._frame())
            self._came.clear()
        return frames

    def _read(self, address: str, arguments: tuple[osc.Argument, ...]) -> bool:
        """Read a message; returns whether it is about the face."""
        numbers = [float(value) for value in arguments if isinstance(value, int | float)]
        if len(numbers) != (4 if address == _GAZE else 1):
            return False
        if address == _GAZE:
            left_down, left_across, right_down, right_across = numbers
            self._gaze = pi / 180.0 * np.array([[right_down, right_across], [left_down, left_across]])
        elif address == _CLOSED:
            self._values[_CLOSED] = numbers[0]
        elif (active := _ACTIVE.fullmatch(address)) is not None:
            self._active[active[1]], self._moved = numbers[0] != 0.0, 0
        elif (matched := _PARAMETER.fullmatch(address)) is None:
            return False
        elif (lid := _EXPANDED.fullmatch(matched[1])) is not None and matched[2] is None:
            self._lid(lid[1].replace("Combined", ""), numbers[0])
        elif (name := _EARLIER.get(matched[1], matched[1])) not in _KNOWN:
            return False
        elif matched[2] is None:
            self._set(name, numbers[0])
        else:
            return self._bit(name, matched[2], numbers[0] != 0.0)
        return True

    def _set(self, name: str, value: float) -> None:
        self._moved += self._values.get(name) not in (None, value)
        self._values[name] = value

    def _lid(self, side: str, value: float) -> None:
        """Set the lids of a side, or of both, from a value of version 4."""
        wide = (1.0 - _OPEN) / (1.0 - _LID) * (value - _LID)
        self._set(f"EyeLid{side}", max(value, 0.0) * _OPEN / _LID if value < _LID else _OPEN + wide)
        self._set(f"EyeSquint{side}" if side else "EyesSquint", max(-value, 0.0))

    def _bit(self, name: str, bit: str, value: bool) -> bool:
        """Read a bit of a parameter, or its sign; returns whether it is one."""
        if bit != "Negative" and int(bit) not in _BITS:
            return False
        bits = self._bits.setdefault(name, {})
        bits[bit] = value
        places = [int(place) for place in bits if place != "Negative"]
        if places:
            share = sum(place for place in places if bits[str(place)]) / (2 * max(places) - 1)
            self._set(name, -share if bits.get("Negative") else share)
        return True

    def _frame(self) -> StreamFrame:
        if self._active and not any(self._active.values()) and self._moved < _MOVED:
            return StreamFrame(None)
        coefficients, eyes = no_coefficients(), self._eyes()
        for column, recipes in _RECIPES:
            coefficients[column] = next((value for parts in recipes if (value := self._value(parts)) is not None), 0.0)
        if eyes is not None:
            coefficients[LOOKS] = looks_of_eyes(eyes)
        return StreamFrame(checked(FaceValues(coefficients, np.zeros(3), eyes=eyes)))

    def _value(self, parts: tuple[Part, ...]) -> float | None:
        """Return the sum of the parts whose parameters are known, as if the others were like them; None if none is."""
        known = [part for part in parts if part[0] in self._values]
        if not known:
            return None
        whole = sum(abs(gain) for _, gain, _ in parts) / sum(abs(gain) for _, gain, _ in known)
        return whole * sum(max(gain * self._values[name] + offset, 0.0) for name, gain, offset in known)

    def _eyes(self) -> FloatArray | None:
        """Return pitch and yaw of the right and left eye; None if there is no gaze."""
        both = [_direction(self._values, side) for side in _SIDES[::-1]]
        if all(eye is None for eye in both):
            return self._gaze
        right, left = both
        return np.array([right or left, left or right])


def _direction(values: Mapping[str, float], side: str) -> tuple[float, float] | None:
    """Return pitch and yaw of an eye, from how far its direction of length 1 points right and up."""
    across, up = (values.get(f"Eye{side}{axis}", values.get(f"Eye{axis}")) for axis in "XY")
    if across is None and up is None:
        return None
    return asin(min(max(-(up or 0.0), -1.0), 1.0)), asin(min(max(across or 0.0, -1.0), 1.0))

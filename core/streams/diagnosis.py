"""What a sender sends at this moment, as a table for whoever sets it up, and why packets that arrive move nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import Message
from ..face.names import COEFFICIENTS, N_COEFFICIENTS
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult
from .casting import Address
from .protocols.face_motion import MAGIC
from .protocols.frames import FaceValues, PacketError
from .stream_settings import PROTOCOLS, StreamSettings
from .transport.addresses import is_loopback
from .transport.datagram import OwnReceiver, Refusal, RefusedError

_COLUMNS = 3
"""Columns of the table, which fit into 80 characters."""
_WIDTH = 26
"""Characters in each column."""
_AXES = ("Pitch", "Yaw", "Roll")
_LOOKS = 0.5
"""Seconds between two attempts to recognise a packet by trying all decoders."""
_FACELESS = 2.0
"""Seconds of accepted packets without a face after which the sender is taken to send none."""
_RECENT = 2.0
"""Seconds for which what arrived counts as arriving."""


@dataclass(frozen=True)
class Incoming:
    """The newest frame of a sender, before it is played.

    Attributes
    ----------
    sender : str
        Address and name of the sender.
    rate : float
        Frames per second.
    found : bool
        Whether the sender sees a face.
    rotation : (3,) float64
        Pitch, yaw and roll of the head in degrees, as in `TrackResult`.
    coefficients : (52,) float64
        Coefficients in the order of `COEFFICIENTS`; NaN if the protocol has none.
    """

    sender: str
    rate: float
    found: bool
    rotation: FloatArray
    coefficients: FloatArray

    def rows(self) -> list[tuple[str, float]]:
        """Return the values with their names; none if there is no face, or the protocol has no values."""
        known = self.found and bool(np.isfinite(self.coefficients).all())
        return list(zip(COEFFICIENTS, self.coefficients.tolist(), strict=True)) if known else []

    def pose(self) -> str:
        """Return the rotation of the head as text."""
        return ", ".join(f"{axis} {angle:.0f}°" for axis, angle in zip(_AXES, self.rotation, strict=True))


def incoming(sender: str, rate: float, face: FaceValues | TrackResult | None) -> Incoming:
    """Return the newest frame of a sender as numbers for a table; `face` is None if the sender sees none."""
    rotation, coefficients = np.zeros(3), np.full(N_COEFFICIENTS, np.nan)
    if isinstance(face, TrackResult) and face.found:
        rotation, coefficients = face.pose[1:4], face.coefficients
    elif isinstance(face, FaceValues):
        rotation, coefficients = face.rotation, face.coefficients
    found = face.found if isinstance(face, TrackResult) else face is not None
    return Incoming(sender, rate, found, np.degrees(rotation), coefficients)


def table(senders: list[Incoming]) -> str:
    """Return the values of all senders as text of at most 80 columns."""
    return "\n\n".join(map(_table, senders))


def _table(one: Incoming) -> str:
    head = f"{one.sender}: {one.rate:.0f} frames/s, {one.pose() if one.found else 'no face'}"
    cells = [f"{name:<20}{value:5.2f}".ljust(_WIDTH) for name, value in one.rows()]
    height = -(-len(cells) // _COLUMNS)
    lines = ["".join(cells[row::height]).rstrip() for row in range(height)]
    return "\n".join([head, *lines])


class Diagnosis:
    """Collects why packets are not accepted, and says what to change in the settings, which have been checked."""

    def __init__(self, settings: StreamSettings) -> None:
        self._settings = settings
        self._faceless: tuple[float, str] | None = None  # since when, and from which host
        self._looked = float("-inf")
        self._last: tuple[float, str] | None = None

    def accept(self, address: Address, now: float, *, frames: int) -> None:
        """Note an accepted packet, and how many frames it completed."""
        if frames:
            self._faceless, self._last = None, None
            return
        since, _ = self._faceless = self._faceless or (now, address[0])
        if now - since >= _FACELESS:
            self._say(_no_face(address[0]), now)

    def refuse(self, error: PacketError, data: bytes, address: Address, now: float) -> None:
        """Note a packet that was not accepted, with its sender and the time in seconds on any clock."""
        if isinstance(error, RefusedError):
            if text := self._refusal(error.reason, address[0]):
                self._say(text, now)
        elif now - self._looked >= _LOOKS:
            self._looked = now
            self._say(self._foreign(data, address[0]), now)

    def message(self, now: float | None = None) -> str:
        """Return why nothing is played; "" if packets are accepted, or none came lately (with `now`)."""
        if self._last is None or (now is not None and now - self._last[0] > _RECENT):
            return ""
        return self._last[1]

    def nothing_came(self) -> str:
        """Return what to do if no face has come at all."""
        settings = self._settings
        if self._faceless is not None:
            return _no_face(self._faceless[1])
        if settings.pairing is not None:
            address = settings.pairing.address
            return Message(
                "Nothing arrived from {address}. Check that it is sending, and the firewall there.", address=address
            )
        if settings.phone:
            return Message(
                "Nothing arrived from the phone {phone}. Check its address and the firewall, and that the app is open.",
                phone=settings.phone,
            )
        place = f"{settings.host}:{settings.port}"
        if is_loopback(settings.host):
            return Message(
                "Nothing arrived at {place}, which only this computer can send to. "
                "Check the address and the port in the sender; for other devices, listen on 0.0.0.0.",
                place=place,
            )
        return Message(
            "Nothing arrived at {place}. Check the address and the port in the app, and the firewall.", place=place
        )

    def _say(self, text: str, now: float) -> None:
        self._last = now, text

    def _refusal(self, reason: Refusal, host: str) -> str:
        if reason is Refusal.NO_KEY_HERE:
            return Message(
                "{host} sends with a shared key, and none is set here. Choose its file under Key.", host=host
            )
        if reason is Refusal.NO_KEY_THERE:
            return Message(
                "{host} sends without a key, but one is set here. Use the same key on both computers, or none.",
                host=host,
            )
        if reason is Refusal.OTHER_KEY:
            return Message("{host} sends with a different key. Copy one key file to both computers.", host=host)
        if reason is Refusal.NOT_THE_PHONE:
            phone = self._settings.phone
            return Message(
                "Packets arrive from {host}, but the phone is {phone}. Check the phone's address.",
                host=host,
                phone=phone,
            )
        return ""

    def _foreign(self, data: bytes, host: str) -> str:
        label = Message(PROTOCOLS[self._settings.protocol].label)
        if (name := recognise(data, self._settings)) is None:
            return Message(
                "What arrives from {host} is not {label}, nor another protocol known here. Check what it sends.",
                host=host,
                label=label,
            )
        other = Message(PROTOCOLS[name].label)
        return Message(
            "What arrives from {host} looks like {other}, not {label}. Choose protocol {name}.",
            host=host,
            other=other,
            label=label,
            name=name,
        )


def _no_face(host: str) -> str:
    return Message(
        "Packets arrive from {host}, but no face in them. Check in the app that it sends the face.", host=host
    )


def recognise(data: bytes, settings: StreamSettings) -> str | None:
    """Return the name in `PROTOCOLS` of a packet's protocol, if it is another one than is set; otherwise None."""
    mine = PROTOCOLS[settings.protocol]
    if data.startswith(MAGIC) and not mine.motion_port:
        return next(name for name, protocol in PROTOCOLS.items() if protocol.motion_port)
    for name, protocol in PROTOCOLS.items():
        if protocol.connected or protocol is mine:
            continue
        try:
            if protocol.decoder is not None:
                protocol.decoder(settings).decode(data)
            else:
                OwnReceiver(None).receive(data, 0.0)
        except RefusedError:
            return name
        except PacketError:
            continue
        return name
    return None

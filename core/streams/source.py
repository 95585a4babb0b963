"""A live source of faces that arrive over the network."""

from __future__ import annotations

import select
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from ..errors import Message
from ..face.names import COEFFICIENT_MIRROR
from ..numeric.arrays import FloatArray
from ..puppet.sources import LiveFrame, LiveSource
from ..takes.measured import coefficient_face
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from .casting import SILENT, Address, Casting, FaceName, Role, label_of
from .diagnosis import Diagnosis, Incoming, incoming
from .links import ConnectionsLink, DatagramLink, Link
from .phone import Phone, PhoneLink
from .playout import Playout, Shown, StreamCounts
from .ports import Ports
from .protocols.frames import Decoding, FaceValues, PacketError, Receiver, StreamFrame
from .stream_settings import AXES, OWN, PROTOCOLS, StreamSettings
from .tls_client import TlsLink
from .transport.datagram import OwnReceiver, Refusal, RefusedError

_MAX_SENDERS = 16
"""Largest number of senders, and of faces of each."""
_RATE = 8000.0
"""Packets per second that are processed; VMC may send a packet per value."""
_BURST = 2000.0
"""Largest number of packets that are processed in a burst."""
_DRAINED = 512
"""Number of packets that are read before the next frame is shown."""
_LATE = 0.25
"""Seconds by which a frame may be late before it is skipped."""
_PATIENCE = 5.0
"""Seconds without any packet after which the message says what to check."""
_FOLLOWED = 0.05
"""Share of the difference by which the mean interval between frames follows each of them."""
_NOTHING = TrackResult.nothing(0)


@dataclass
class _Face:
    """A face of a sender."""

    playout: Playout
    heard: float
    origin: FloatArray | None = None
    neutral: Neutral | None = None
    newest: FaceValues | TrackResult | None = None
    interval: float = 0.0


@dataclass
class _Sender:
    """A sender."""

    receiver: Receiver
    heard: float
    faces: dict[str, _Face] = field(default_factory=dict)


class StreamSource(LiveSource):
    """Receives faces, and plays them evenly.

    The socket is read by `read`, so there is no thread. For each head one face is played: the one chosen for it, or
    else the next one that comes, until nothing of it has come for two seconds and there is another one (`Casting`).

    Parameters
    ----------
    settings : StreamSettings
        Source and playout of the stream.
    clock : callable, optional
        Returns the time in seconds; tests replace it.
    every : bool
        Whether frames for which `read` is late are played nevertheless, as a recording needs them.

    Attributes
    ----------
    counts : StreamCounts
        Numbers of packets.
    chosen : tuple of str
        For each head, the address or name of its sender, or ""; may be replaced at any time.

    Raises
    ------
    SourceError
        If the settings cannot be used, or the key cannot be read.
    """

    def __init__(
        self, settings: StreamSettings, clock: Callable[[], float] = perf_counter, *, every: bool = False
    ) -> None:
        self.settings = settings.checked()
        self._protocol = PROTOCOLS[self.settings.protocol]
        self.name = self.settings.label
        self.counts = StreamCounts()
        self._clock, self._late = clock, np.inf if every else _LATE
        self._own = OwnReceiver(self.settings.secret()) if self.settings.protocol == OWN else None
        self._phone = Phone(self.settings)
        self._diagnosis = Diagnosis(self.settings)
        self._signs = np.array([-1.0 if axis in self.settings.flip else 1.0 for axis in AXES])
        self._link = self._open_link()
        self._wake, self._woken = socket.socketpair()
        self._closed = False
        self._senders: dict[Address, _Sender] = {}
        self._ports = Ports()
        self.chosen: tuple[str, ...] = self.settings.senders
        self._casting = Casting(self._wanted())
        self._turn, self._began = 0, float("inf")
        self._tokens, self._counted = _BURST, 0.0

    @property
    def address(self) -> Address:
        """Address at which packets are received, once the first `read` has opened the socket."""
        return self._link.address

    @property
    def senders(self) -> tuple[str, ...]:
        """The faces that are arriving now, each as an address and a name."""
        now = self._clock()
        return tuple(label_of(name) for name, face in self._faces() if now - face.heard < SILENT)

    @property
    def incoming(self) -> list[Incoming]:
        """The newest frame of each of `senders`, as it came."""
        now = self._clock()
        return [
            incoming(label_of(name), 1.0 / face.interval if face.interval else 0.0, face.newest)
            for name, face in self._faces()
            if now - face.heard < SILENT
        ]

    @property
    def problem(self) -> str:
        """What to change if no face has arrived: the address, the protocol, the key or the sender."""
        if self.senders and (wanted := ", ".join(filter(None, self._wanted()))):
            names = ", ".join(self.senders)
            return Message(
                "Faces arrive from {names}, but not from {wanted}. Choose one of these senders.",
                names=names,
                wanted=wanted,
            )
        return self._diagnosis.message() or self._diagnosis.nothing_came()

    @property
    def driven(self) -> dict[str, tuple[int, ...]]:
        """The heads that each of `senders` drives."""
        roles = {role.followed: role.heads for role in tuple(self._casting.roles)}
        return {label_of(name): roles.get(name, ()) for name, _ in self._faces()}

    def read(self, timeout: float) -> LiveFrame | None:
        """Return the next frame that is due. See `LiveSource.read`."""
        if self._closed:
            return None
        self._link.open()
        self._phone.find()
        self._began = min(self._began, self._clock())
        end = self._clock() + timeout
        while not self._closed:
            now = self._clock()
            self._tell(self._phone.due(now, self._link, heard=self._heard(now)))
            self._drain(now)
            if (frame := self._due(now)) is not None:
                return frame
            if now >= end:
                return None
            self._wait(min(end, self._next(now)) - now)
        return None

    def close(self) -> None:
        """Close the socket, so that a waiting `read` returns None."""
        self._closed = True
        with suppress(OSError):
            self._wake.send(b"\0")
        self._tell(self._phone.farewell())
        self._link.close()
        self._wake.close()

    def _open_link(self) -> Link:
        if self.settings.pairing is not None:
            return TlsLink(self.settings.pairing)
        host, port, protocol = self.settings.host, self.settings.port, self._protocol
        if protocol.connected and protocol.motion_port:
            return PhoneLink(host, port, protocol.end, protocol.motion_port)
        if protocol.connected:
            return ConnectionsLink(host, port)
        return DatagramLink(host, port)

    def _wait(self, seconds: float) -> None:
        readers, writers = self._link.waits()
        with suppress(OSError, ValueError):  # closed meanwhile
            select.select([*readers, self._woken], writers, [], max(seconds, 0.0))

    def _heard(self, now: float) -> bool:
        return any(now - face.heard < SILENT for _, face in self._faces())

    def _tell(self, packets: Iterable[tuple[bytes, Address]]) -> None:
        for packet, address in packets:
            self._link.reply(packet, address)

    def _drain(self, now: float) -> None:
        self._tokens = min(_BURST, self._tokens + _RATE * max(now - self._counted, 0.0))
        self._counted = now
        for _ in range(_DRAINED):
            came = self._link.receive(now)
            self.message = self._link.message
            if came is None:
                if not self._heard(now):
                    self.message = self.message or self._phone.message or self._diagnosis.message(now)
                    if not self.counts.received and now - self._began > _PATIENCE:
                        self.message = self.message or self._diagnosis.nothing_came()
                return
            self.counts.received += 1
            if self._tokens < 1.0:
                self.counts.flooded += 1
                continue
            self._tokens -= 1.0
            self._take(*came, now)

    def _take(self, data: bytes, address: Address, now: float) -> None:
        """Process a datagram from any sender."""
        source = self._ports.sender_of(address, now)
        try:
            sender = self._sender(source, now)
            frames = self._decoded(sender, data, address, now)
            for frame in frames:
                self._add(sender, frame, now)
        except PacketError as error:
            refused = isinstance(error, RefusedError)
            self.counts.refused += refused
            self.counts.malformed += not refused
            self._diagnosis.refuse(error, data, address, now)
        else:
            self.counts.accepted += 1
            self._diagnosis.accept(address, now, frames=len(frames))
            self._senders.setdefault(source, sender).heard = now
            for other in self._ports.note(address, now):
                self._senders.pop(other, None)

    def _decoded(self, sender: _Sender, data: bytes, address: Address, now: float) -> list[StreamFrame]:
        if len(data) > self._link.largest:
            raise PacketError("too long")
        receiver = self._phone.receiver(data, address) or sender.receiver
        frames, answers = receiver.receive(data, now)
        self._tell((answer, address) for answer in answers)
        return frames

    def _sender(self, address: Address, now: float) -> _Sender:
        if not self._phone.may_send(address):
            raise RefusedError(Refusal.NOT_THE_PHONE)
        if (sender := self._senders.get(address)) is not None:
            return sender
        if len(self._senders) >= _MAX_SENDERS:
            oldest = min(self._senders, key=lambda known: self._senders[known].heard)
            if now - self._senders[oldest].heard < SILENT:
                raise RefusedError(Refusal.TOO_MANY)
            del self._senders[oldest]
        return _Sender(self._receiver(), now)

    def _receiver(self) -> Receiver:
        """Create the receiver for a new sender; Facemime's own one distinguishes senders by their sessions."""
        if self._own is not None:
            return self._own
        decoder = self._protocol.decoder
        assert decoder is not None
        return Decoding(decoder(self.settings))

    def _add(self, sender: _Sender, frame: StreamFrame, now: float) -> None:
        face = sender.faces.get(frame.subject)
        if face is None:
            if len(sender.faces) >= _MAX_SENDERS:
                sender.faces.pop(min(sender.faces, key=lambda name: sender.faces[name].heard))
            face = sender.faces[frame.subject] = _Face(Playout(self.settings.delay, self.counts), now)
        step = now - face.heard
        face.interval += (_FOLLOWED if face.interval else 1.0) * (step - face.interval)
        face.heard, face.neutral, face.newest = now, frame.neutral, frame.face
        face.playout.push(self._result(face, frame.face), frame.time, now, frame.sequence)

    def _result(self, face: _Face, values: FaceValues | TrackResult | None) -> TrackResult:
        if values is None:
            return _NOTHING
        if isinstance(values, TrackResult):
            return values
        moved = None
        if values.position is not None:
            face.origin = values.position if face.origin is None else face.origin
            moved = values.position - face.origin
        coefficients, eyes = values.coefficients, values.eyes
        if self.settings.swap:
            coefficients = coefficients[COEFFICIENT_MIRROR]
            eyes = None if eyes is None else eyes[::-1] * (1.0, -1.0)
        return coefficient_face().result(coefficients, values.rotation * self._signs, moved, eyes)

    def _faces(self) -> Iterator[tuple[FaceName, _Face]]:
        for address, sender in tuple(self._senders.items()):
            for subject, face in tuple(sender.faces.items()):
                yield (address, subject), face

    def _wanted(self) -> tuple[str, ...]:
        return tuple(chosen or self.settings.sender for chosen in self.chosen) or (self.settings.sender,)

    def _cast(self, now: float) -> list[tuple[Role, FaceName, _Face]]:
        """Return the face that is played for each role."""
        self._casting.choose(self._wanted())
        faces = dict(self._faces())
        self._casting.update({name: face.heard for name, face in faces.items()}, now)
        roles = [(role, role.followed) for role in self._casting.roles]
        return [(role, name, faces[name]) for role, name in roles if name is not None and name in faces]

    def _due(self, now: float) -> LiveFrame | None:
        cast = self._cast(now)
        self._turn += 1
        for number in range(len(cast)):
            role, name, face = cast[(self._turn + number) % len(cast)]
            if (frame := self._frame_of(role, face, now)) is not None:
                heads = None if len(self._casting.roles) == 1 else role.heads
                return replace(frame, performer=role.number, heads=heads, sender=label_of(name))
        return None

    def _frame_of(self, role: Role, face: _Face, now: float) -> LiveFrame | None:
        dropped, shown = -1, None
        # All frames in turn, so that none is missing from a recording, unless they are more than a little late.
        while (next_one := face.playout.pop(now)) is not None:
            if shown is not None and next_one.predicted:
                break
            shown, dropped = next_one, dropped + (not next_one.predicted)
            if now - next_one.due <= self._late:
                break
        if shown is None:
            return role.timeline.filled(now)
        start = 0.0 if role.timeline.begun else self._casting.start_of(shown.due)
        return role.timeline.frame(shown, face.neutral or self._neutral(shown), now, max(dropped, 0), start)

    def _neutral(self, shown: Shown) -> Neutral | None:
        return coefficient_face().neutral if np.isfinite(shown.result.coefficients).all() else None

    def _next(self, now: float) -> float:
        """Return the time at which there will be something to show, unless a packet comes before."""
        moments = [now + 1.0]
        for role, _, face in self._cast(now):
            moments += [moment for moment in (face.playout.due(), role.timeline.due()) if moment is not None]
        return min(moments)

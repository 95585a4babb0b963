"""A phone that sends only on request, or over TCP: it connects to this computer, or is called (streams.md).

Text ends with a marker; messages of `face_motion` state their length in the header.
"""

from __future__ import annotations

import socket
from contextlib import suppress

import numpy as np

from ..errors import SourceError
from .casting import Address
from .links import PORTION, Connection, ConnectionsLink, Link, call, has_answered
from .protocols.face_motion import HEADER, MAGIC, MAX_MESSAGE, FaceMotionReceiver, length_of
from .protocols.frames import MAX_DATAGRAM
from .stream_settings import PROTOCOLS, StreamSettings
from .transport.addresses import resolve

_ASK_AGAIN = 2.0
"""Seconds after which a phone is asked again."""
_ASK_OTHERWISE = 1.0
"""Seconds after which a phone that has not answered is asked for its other protocol."""
_SILENT = 8.0
"""Seconds without a message after which a call is ended, as a phone answers each `PING`."""


class Phone:
    """Makes the packets for the phone in the settings; without one, nothing is sent.

    An app that may support `face_motion` is asked for it and for text alternately.
    """

    def __init__(self, settings: StreamSettings) -> None:
        self._protocol = PROTOCOLS[settings.protocol]
        self._host = settings.phone
        self._address: Address | None = None
        self._motion = FaceMotionReceiver(connected=self._protocol.connected) if self._protocol.motion_port else None
        self._motion_phone: Address = ("", 0)
        self._motion_address = self._motion_phone
        self._asked, self._requests = -np.inf, 0

    @property
    def message(self) -> str:
        """Reason why the phone refuses to send; otherwise ""."""
        return "" if self._motion is None else self._motion.message

    def find(self) -> None:
        """Look up the address of the phone, once; SourceError if its name is unknown."""
        if self._host and self._address is None:
            _, self._address = resolve(self._host, self._protocol.phone_port)
            self._motion_phone = self._motion_address = self._address[0], self._protocol.motion_port

    def may_send(self, address: Address) -> bool:
        """Return whether packets from `address` are accepted: only the phone's, if its address is known."""
        return self._address is None or address[0] == self._address[0]

    def receiver(self, data: bytes, address: Address) -> FaceMotionReceiver | None:
        """Return the receiver for a packet of `face_motion`, or None; later packets are sent to `address`."""
        if self._motion is None or not data.startswith(MAGIC):
            return None
        self._motion_address = address
        return self._motion

    def due(self, now: float, link: Link, *, heard: bool) -> list[tuple[bytes, Address]]:
        """Return the packets that the phone needs now, in seconds on any clock, and their addresses."""
        if self._motion is not None and link.is_lost(self._motion_address):
            self._motion.end()
            self._motion_address = self._motion_phone
        packets = [] if self._motion is None else [(data, self._motion_address) for data in self._motion.due(now)]
        if self._address is None or now - self._asked < (_ASK_AGAIN if self._motion is None else _ASK_OTHERWISE):
            return packets
        self._asked = now
        sends = heard or (self._motion is not None and self._motion.active(now))
        if self._protocol.leased or not sends:
            packets.append(self._request(link.address[1]))
        return packets

    def farewell(self) -> list[tuple[bytes, Address]]:
        """Return the packets that end the session, and their addresses."""
        packets = [] if self._motion is None else [(data, self._motion_address) for data in self._motion.stop()]
        if not packets and self._protocol.stop and self._address is not None:
            packets.append((self._protocol.stop, self._address))
        return packets

    def _request(self, port: int) -> tuple[bytes, Address]:
        """Ask for the newest protocol first, as the app would end it if asked for the older one."""
        assert self._address is not None
        self._requests += 1
        if self._motion is not None and self._requests % 2:
            return self._motion.hello(), self._motion_address
        return self._protocol.request(port), self._address


class PhoneLink(ConnectionsLink):
    """Messages over TCP from a phone; each text ends with `end`.

    `motion_port` is a second port to listen on, if it is free: the one to which a phone connects that was started by
    hand.
    """

    largest = MAX_MESSAGE

    def __init__(self, host: str, port: int, end: bytes, motion_port: int) -> None:
        super().__init__(host, port)
        self._end, self._motion_port = end, motion_port
        self._called: Address | None = None
        self._heard: float | None = None

    def open(self) -> None:
        """Listen on both ports. See `Link.open`."""
        opened = bool(self._listeners)
        super().open()
        if not opened and self._port != self._motion_port:
            with suppress(SourceError):
                self._listen(self._motion_port)

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next message of the phone. See `Link.receive`."""
        received = super().receive(now)
        if self._called is not None:
            if self._heard is None or (received is not None and received[1] == self._called):
                self._heard = now
            if self._called not in self._connections:
                self._called = None
            elif now - self._heard > _SILENT:
                self._connections.pop(self._called).close()
                self._called = None
        return received

    def reply(self, data: bytes, address: Address) -> None:
        """Send a message over the connection to `address`, or call it; text goes by datagram. See `Link.reply`."""
        with suppress(OSError, SourceError):
            if (connection := self._connections.get(address)) is not None:
                assert isinstance(connection, _PhoneConnection)
                connection.send(data)
            elif data.startswith(MAGIC):
                self._call(data, address)
            else:
                family, place = resolve(*address)
                with socket.socket(family, socket.SOCK_DGRAM) as asking:
                    asking.sendto(data, place)

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """See `Link.waits`."""
        readers, _ = super().waits()
        calls = [c.socket for c in self._connections.values() if isinstance(c, _Call) and not c.answered]
        return [reader for reader in readers if reader not in calls], calls

    def _connection(self, connected: socket.socket) -> Connection:
        return _PhoneConnection(connected, self._end)

    def _call(self, data: bytes, address: Address) -> None:
        """Call the phone, and send `data` once it answers; a phone in this computer does not have its own port."""
        if address in [listener.getsockname()[:2] for listener in self._listeners]:
            return
        called, place = call(*address)
        self._called, self._heard = place, None
        self._connections[place] = _Call(called, self._end, data)


class _PhoneConnection(Connection):
    """A connection with a phone, whose first bytes tell whether it sends text or `face_motion`."""

    def __init__(self, connected: socket.socket, end: bytes) -> None:
        super().__init__(connected)
        self._end = end

    def send(self, data: bytes) -> None:
        """Send a message; OSError if that is not possible without waiting."""
        self.socket.send(data)

    def take(self) -> bytes | None:
        """Return the next message. See `Connection.take`."""
        while (message := self._message()) is None:
            if not self._read(PORTION):
                return None
        return message

    def _message(self) -> bytes | None:
        """Remove and return the first message, if it is complete."""
        if MAGIC.startswith(bytes(self._data[: len(MAGIC)])):
            length = length_of(bytes(self._data[: HEADER.size]))
            return None if length is None or length > len(self._data) else self._cut(length)
        while self._data.startswith(self._end):  # some apps write it before a message, too
            del self._data[: len(self._end)]
        if (place := self._data.find(self._end)) >= 0:
            return self._cut(place, len(self._end))
        if len(self._data) > MAX_DATAGRAM:
            raise ConnectionError("a message is too long")
        return None

    def _cut(self, length: int, more: int = 0) -> bytes:
        message = bytes(self._data[:length])
        del self._data[: length + more]
        return message


class _Call(_PhoneConnection):
    """A connection that this computer begins."""

    def __init__(self, called: socket.socket, end: bytes, first: bytes) -> None:
        super().__init__(called, end)
        self.answered, self._first = False, first

    def send(self, data: bytes) -> None:
        """Send a message, or replace the first one if the phone has not answered yet."""
        if self.answered:
            super().send(data)
        else:
            self._first = data

    def take(self) -> bytes | None:
        """Return the next message. See `Connection.take`."""
        if not self.answered and has_answered(self.socket):
            self.answered = True
            self.socket.send(self._first)
        return super().take() if self.answered else None

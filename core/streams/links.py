"""Transport of packets to this computer: datagrams, TCP, or TLS from a paired sender."""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress

from .casting import Address
from .protocols.frames import MAX_DATAGRAM
from .transport.addresses import bind, cannot_listen, listening, resolve

LENGTH = struct.Struct("<I")
"""Prefix of each message over TCP."""
_BUFFER = 1 << 20
PORTION = 1 << 16
"""Number of bytes that are read at a time."""
_MAX_CONNECTIONS = 4
_MAX_MESSAGE = 1 << 25
"""Largest size in bytes of a message after its length."""


class Link:
    """Base class of transports of packets. None of its methods waits.

    Attributes
    ----------
    address : (str, int)
        Address at which packets are received, or from which they come.
    message : str
        Reason why no data arrive; otherwise "".
    largest : int
        Largest size of a packet in bytes.
    """

    address: Address
    message: str
    largest: int

    def open(self) -> None:
        """Open the link, unless it is open; SourceError if it cannot be used."""

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next packet and its sender, or None if nothing has come yet; `now` is in seconds on any clock.

        Raises SourceError if another computer answers than the intended sender.
        """
        raise NotImplementedError

    def reply(self, data: bytes, address: Address) -> None:
        """Send a packet back, if senders need answers and that is possible without waiting."""

    def is_lost(self, address: Address) -> bool:
        """Return whether nothing can be sent to a sender; False for datagrams, which need no connection."""
        return False

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """Return the sockets that have to become readable, and writable, before there is anything to receive."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the link. May be called twice, and by another thread."""


class _Listening(Link):
    """A link to senders that find this computer at an address of it."""

    def __init__(self, host: str, port: int) -> None:
        self.address: Address = ("", 0)
        self.message = ""
        self._host, self._port = host, port


class DatagramLink(_Listening):
    """Datagrams on a port and an address of this computer."""

    largest = MAX_DATAGRAM

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Bind the port. See `Link.open`."""
        if self._socket is not None:
            return
        family, address = resolve(self._host, self._port)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            with suppress(OSError):
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            bind(opened, address)
        except OSError as error:
            opened.close()
            raise cannot_listen(self._host, self._port, error) from error
        self._socket, self.address = opened, opened.getsockname()[:2]

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next datagram. See `Link.receive`."""
        while self._socket is not None:
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM + 1)
            except ConnectionResetError:  # Windows reports in this way that a receiver is gone
                continue
            except OSError:
                break
            return data, (str(address[0]), int(address[1]))
        return None

    def reply(self, data: bytes, address: Address) -> None:
        """Send a datagram. See `Link.reply`."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(data, address)

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """See `Link.waits`."""
        return ([], []) if self._socket is None else ([self._socket], [])

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


class ConnectionsLink(_Listening):
    """Messages over TCP from senders that connect to a port of this computer. Each message follows its length."""

    largest = _MAX_MESSAGE

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self._listeners: list[socket.socket] = []
        self._connections: dict[Address, Connection] = {}

    def open(self) -> None:
        """Listen on the port. See `Link.open`."""
        if not self._listeners:
            self._listen(self._port)
            self.address = self._listeners[0].getsockname()[:2]

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next message of any sender. See `Link.receive`."""
        self._accept()
        for address, connection in tuple(self._connections.items()):
            try:
                if (message := connection.take()) is not None:
                    self._connections[address] = self._connections.pop(address)  # the others come first next time
                    return message, address
            except OSError:
                self._connections.pop(address).close()
        return None

    def is_lost(self, address: Address) -> bool:
        """Return whether the sender has gone. See `Link.is_lost`."""
        return address not in self._connections

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """See `Link.waits`."""
        return self._listeners + [connection.socket for connection in self._connections.values()], []

    def close(self) -> None:
        """Close all connections, and stop listening."""
        for connection in tuple(self._connections.values()):
            connection.close()
        for listener in self._listeners:
            listener.close()

    def _listen(self, port: int) -> None:
        self._listeners.append(listening(self._host, port, _MAX_CONNECTIONS))

    def _accept(self) -> None:
        for listener in self._listeners:
            with suppress(OSError):  # nobody else, or closed
                while True:
                    connected, address = listener.accept()
                    if len(self._connections) >= _MAX_CONNECTIONS:
                        connected.close()
                        continue
                    connected.setblocking(False)
                    self._connections[str(address[0]), int(address[1])] = self._connection(connected)

    def _connection(self, connected: socket.socket) -> Connection:
        return Connection(connected)


class Connection:
    """A connected sender on a socket that does not block, and the received part of its next message."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket, self._data = connected, bytearray()

    def take(self) -> bytes | None:
        """Return the next message, or None until it is complete; OSError if the sender has gone, or sends too much."""
        while (wanted := self._wanted()) > len(self._data):
            if not self._read(max(PORTION, wanted - len(self._data))):
                return None
        message = bytes(self._data[LENGTH.size : wanted])
        del self._data[:wanted]
        return message

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()

    def _read(self, size: int) -> bool:
        """Read up to `size` bytes, and return whether any had come; ConnectionError if the sender has ended."""
        try:
            portion = self.socket.recv(size)
        except BlockingIOError:
            return False
        if not portion:
            raise ConnectionError("the sender has ended")
        self._data += portion
        return True

    def _wanted(self) -> int:
        """Number of bytes of the next message, including its length."""
        if len(self._data) < LENGTH.size:
            return LENGTH.size
        (length,) = LENGTH.unpack_from(self._data)
        if length > _MAX_MESSAGE:
            raise ConnectionError("a message is too long")
        return int(LENGTH.size + length)


def call(host: str, port: int) -> tuple[socket.socket, Address]:
    """Begin to connect to another computer, and return a socket that does not block, and the numeric address.

    See `has_answered`. Raises SourceError if the computer is unknown, and OSError if it cannot be reached.
    """
    family, address = resolve(host, port)
    opened = socket.socket(family, socket.SOCK_STREAM)
    opened.setblocking(False)
    try:
        with suppress(BlockingIOError):
            opened.connect(address)
    except OSError:
        opened.close()
        raise
    return opened, address


def has_answered(called: socket.socket) -> bool:
    """Return whether a connection that `call` began is established; OSError if it has failed."""
    if number := called.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
        raise OSError(number, os.strerror(number))
    try:
        called.getpeername()
    except OSError:
        return False
    return True

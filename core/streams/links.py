"""How packets of a stream come to this computer: as datagrams, or over TLS from a sender that was paired."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Protocol

from .addresses import cannot_listen, resolve
from .casting import Address
from .frames import MAX_DATAGRAM

_BUFFER = 1 << 20


class Link(Protocol):
    """Interface of a way by which packets come; nothing in it waits.

    Attributes
    ----------
    address : (str, int)
        Where packets are received, or where they come from.
    message : str
        Why nothing comes; otherwise "".
    """

    address: Address
    message: str

    def open(self) -> None:
        """Begin; does nothing if it was opened. SourceError if it cannot be used."""

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next packet and its sender, or None if nothing has come yet.

        Parameters
        ----------
        now : float
            Seconds on any clock.

        Raises
        ------
        SourceError
            If whoever is there is not the sender that was meant.
        """

    def reply(self, data: bytes, address: Address) -> None:
        """Send a packet back, if that is possible now."""

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """Return the sockets that have to become readable, and writable, before there is anything to receive."""

    def close(self) -> None:
        """End it; may be called twice, and by another thread."""


class DatagramLink:
    """Datagrams on a port of this computer.

    Parameters
    ----------
    host : str
    port : int
    """

    def __init__(self, host: str, port: int) -> None:
        self.address: Address = ("", 0)
        self.message = ""
        self._host, self._port = host, port
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Bind the port; as `Link.open`."""
        if self._socket is not None:
            return
        family, address = resolve(self._host, self._port)
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            with suppress(OSError):
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            opened.bind(address)
        except OSError as error:
            opened.close()
            raise cannot_listen(self._host, self._port, error) from error
        self._socket, self.address = opened, opened.getsockname()[:2]

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Take the next datagram; as `Link.receive`."""
        while self._socket is not None:
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM + 1)
            except ConnectionResetError:  # as Windows tells that somebody no longer listens
                continue
            except OSError:
                break
            return data, (str(address[0]), int(address[1]))
        return None

    def reply(self, data: bytes, address: Address) -> None:
        """Send a datagram; as `Link.reply`."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(data, address)

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """As `Link.waits`."""
        return ([], []) if self._socket is None else ([self._socket], [])

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()

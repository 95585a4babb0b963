"""A stream over TLS from a paired sender. The certificate is pinned, and a lost connection is restored.

No method waits: each call of `receive` gets as far as it can.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import suppress

from ..errors import Message, SourceError, messages
from .casting import Address
from .links import Link, call, has_answered
from .transport.addresses import ACCEPTED, ANSWER, GREETING, LENGTH, MAGIC, MAX_MESSAGE, VERSION, Pairing, resolve

_AGAIN = 1.0
"""Seconds from a failed attempt to the next one."""
_PATIENCE = 8.0
"""Seconds for a connection to be established."""
_SILENT = 4.0
"""Seconds without any message after which an established connection counts as lost."""
_PORTION = 1 << 14
"""Number of bytes read at a time, which is also the most that is buffered besides a message."""
_MAX_EMPTY = 16
"""Largest number of consecutive empty messages, which show that the sender is connected; one is sent each second."""
_EXPLANATIONS = messages(
    {
        "tls": "it does not support TLS 1.3",
        "cut": "the connection was lost",
        "ended": "it closed the connection",
        "silent": "it does not answer",
        "other": "it is not Facemime, or is a different version",
        "faceless": "it sends something other than a face",
        "certificate": "its certificate is different",
        "token": "it does not know this token",
    }
)
"""Reasons why no data arrive."""
_CONNECTING, _SHAKING, _GREETED, _STREAMING = range(4)


class TlsLink(Link):
    """Packets over TLS from a paired sender."""

    largest = MAX_MESSAGE

    def __init__(self, pairing: Pairing) -> None:
        self.pairing, self.message = pairing, ""
        self.address: Address = (pairing.host, pairing.port)
        self._socket: socket.socket | None = None
        self._state = _CONNECTING
        self._since = self._heard = 0.0
        self._again = float("-inf")
        self._data = bytearray()
        self._writing = False
        self._closed = False
        # The certificate is not verified by an authority: its fingerprint is compared before anything is sent.
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        self._context.check_hostname, self._context.verify_mode = False, ssl.CERT_NONE
        self._context.minimum_version = ssl.TLSVersion.TLSv1_3

    def open(self) -> None:
        """Look up the sender. See `Link.open`."""
        if self._socket is None and not self.message:
            resolve(self.pairing.host, self.pairing.port)

    def receive(self, now: float) -> tuple[bytes, Address] | None:
        """Return the next message. See `Link.receive`."""
        if self._closed or (self._socket is None and now < self._again):
            return None
        try:
            if (message := self._receive(now)) is not None:
                return message, self.address
        except (ssl.SSLWantReadError, BlockingIOError):
            self._writing = False
        except ssl.SSLWantWriteError:
            self._writing = True
        except ssl.SSLError:
            self._give_up(now, _EXPLANATIONS["tls" if self._state == _SHAKING else "cut"])
        except OSError as error:
            self._give_up(now, error.strerror or str(error))
        if self._socket is not None and now - self._heard > (_SILENT if self._state == _STREAMING else _PATIENCE):
            self._give_up(now, _EXPLANATIONS["silent"])
        return None

    def is_lost(self, address: Address) -> bool:
        """Return whether there is no connection at the moment. See `Link.is_lost`."""
        return self._socket is None

    def waits(self) -> tuple[list[socket.socket], list[socket.socket]]:
        """See `Link.waits`."""
        if self._socket is None:
            return [], []
        return ([], [self._socket]) if self._state == _CONNECTING or self._writing else ([self._socket], [])

    def close(self) -> None:
        """Close the connection."""
        self._closed = True
        if self._socket is not None:
            self._socket.close()

    def _receive(self, now: float) -> bytes | None:
        if self._socket is None:
            self._connect(now)
        if self._state == _CONNECTING:
            self._connected()
        if self._state == _SHAKING:
            self._shake_hands(now)
        if self._state == _GREETED and (answer := self._take(ANSWER.size)) is not None:
            self._heard = now
            self._check(answer, now)
        for _ in range(_MAX_EMPTY if self._state == _STREAMING else 0):
            message = self._message()
            if message is None:
                return None
            self._heard = now
            if message:
                return message
        if self._state == _STREAMING:
            raise OSError(_EXPLANATIONS["faceless"])
        return None

    def _connect(self, now: float) -> None:
        self._again = now + _AGAIN
        self._state, self._heard = _CONNECTING, now
        self._data.clear()
        self._socket, self.address = call(self.pairing.host, self.pairing.port)

    def _connected(self) -> None:
        """Continue once the connection is established; BlockingIOError until then."""
        assert self._socket is not None
        if not has_answered(self._socket):
            raise BlockingIOError
        self._socket = self._context.wrap_socket(self._socket, do_handshake_on_connect=False)
        self._state = _SHAKING

    def _shake_hands(self, now: float) -> None:
        assert isinstance(self._socket, ssl.SSLSocket)
        self._socket.do_handshake()
        certificate = self._socket.getpeercert(binary_form=True)
        if certificate is None or not self.pairing.is_of(certificate):
            self._refuse(now, _EXPLANATIONS["certificate"])
        self._socket.send(GREETING.pack(MAGIC, VERSION, self.pairing.token))
        self._state = _GREETED

    def _check(self, answer: bytes, now: float) -> None:
        magic, version, status = ANSWER.unpack(answer)
        if magic != MAGIC or version != VERSION:
            raise OSError(_EXPLANATIONS["other"])
        if status != ACCEPTED:
            self._refuse(now, _EXPLANATIONS["token"])
        self._state, self.message = _STREAMING, ""

    def _message(self) -> bytes | None:
        """Return the next message; None if it is not complete."""
        head = self._peek(LENGTH.size)
        if head is None:
            return None
        (length,) = LENGTH.unpack(head)
        if length > MAX_MESSAGE:
            raise OSError(_EXPLANATIONS["faceless"])
        whole = self._take(LENGTH.size + length)
        return None if whole is None else whole[LENGTH.size :]

    def _peek(self, count: int) -> bytes | None:
        if len(self._data) < count:
            assert self._socket is not None
            portion = self._socket.recv(_PORTION)
            if not portion:
                raise OSError(_EXPLANATIONS["ended"])
            self._data += portion
        return bytes(self._data[:count]) if len(self._data) >= count else None

    def _take(self, count: int) -> bytes | None:
        data = self._peek(count)
        if data is not None:
            del self._data[:count]
        return data

    def _give_up(self, now: float, reason: str) -> None:
        """Close the connection and report why; the next attempt follows after a pause."""
        self.message = Message(
            "No data from {address}: {reason}. Facemime keeps trying.", address=self.pairing.address, reason=reason
        )
        self._again = now + _AGAIN
        if self._socket is not None:
            with suppress(OSError):
                self._socket.close()
            self._socket = None

    def _refuse(self, now: float, reason: str) -> None:
        self._give_up(now, reason)
        raise SourceError(
            "{address} is not the paired computer: {reason}. Paste its pairing line again.",
            address=self.pairing.address,
            reason=reason,
        )

"""NATS' text protocol as far as a relay needs it: one sender publishes, and viewers subscribe.

See https://docs.nats.io/reference/reference-protocols/nats-protocol.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

MAX_PAYLOAD = 32768
"""Largest size in bytes of a message, which holds the frames of more than fifty heads."""
_MAX_LINE = 8192
"""Largest size in bytes of a line; the greeting of a server takes about one kilobyte."""
_END = b"\r\n"
PING, PONG = b"PING\r\n", b"PONG\r\n"


class NatsError(Exception):
    """What arrived is not NATS' protocol, or the server has refused something."""


@dataclass(frozen=True)
class Operation:
    """One operation of the protocol.

    Attributes
    ----------
    verb : str
        Its name in capitals, such as MSG.
    arguments : str
        The rest of its line.
    payload : bytes
        The message, for MSG.
    """

    verb: str
    arguments: str = ""
    payload: bytes = b""


class NatsReader:
    """Splits what arrives, in portions of any size, into operations."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> list[Operation]:
        """Return the operations that are complete with more data; NatsError if they are something else."""
        self._data += data
        found, start = [], 0
        while (end := self._data.find(_END, start)) >= 0:
            verb, _, arguments = self._data[start:end].decode("latin-1").partition(" ")
            after, payload = end + len(_END), b""
            if verb.upper() == "MSG":
                size = _size(arguments)
                if len(self._data) < after + size + len(_END):
                    break
                payload, after = bytes(self._data[after : after + size]), after + size + len(_END)
            found.append(Operation(verb.upper(), arguments.strip(), payload))
            start = after
        del self._data[:start]
        if end < 0 and len(self._data) > _MAX_LINE:
            raise NatsError("it does not speak NATS' protocol")
        return found


def connecting(user: str, password: str) -> bytes:
    """Return the first operations of a client: its credentials, and a request to confirm them."""
    options = {
        "verbose": False,
        "pedantic": False,
        "user": user,
        "pass": password,
        "name": "facemime",
        "lang": "python",
    }
    return b"CONNECT " + json.dumps(options | {"version": "1", "protocol": 1, "echo": False}).encode() + _END + PING


def publishing(subject: str, payload: bytes) -> bytes:
    """Return the operation that publishes a message.

    Parameters
    ----------
    subject : str
        Subject of the message.
    """
    return f"PUB {subject} {len(payload)}\r\n".encode() + payload + _END


def subscribing(subject: str) -> bytes:
    """Return the operation that subscribes to a subject."""
    return f"SUB {subject} 1\r\n".encode()


def _size(arguments: str) -> int:
    """Return the number of bytes of a message from its line: subject, subscription, perhaps a reply, and size."""
    size = arguments.split()[-1:]
    if not size or not size[0].isdecimal() or len(size[0]) > 9 or int(size[0]) > MAX_PAYLOAD:
        raise NatsError("a message has an impossible size")
    return int(size[0])

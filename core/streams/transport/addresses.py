"""Addresses of computers, and pairing of two computers across networks.

The sender has a self-made certificate. The line contains its fingerprint, by which the receiver recognises the
sender, and a token, by which the sender recognises the receiver.
"""

from __future__ import annotations

import errno
import hashlib
import hmac
import ipaddress
import re
import socket
import struct
import sys
from dataclasses import dataclass

from ...errors import Message, OutputError, SourceError

LOOPBACK = "127.0.0.1"
EVERYWHERE = "0.0.0.0"
"""All addresses of this computer."""
PORT = 21576
TOKEN_BYTES = 16
VERSION = 1
ACCEPTED, REFUSED = 0, 1


_ALL = {EVERYWHERE, "::"}
_UNPRIVILEGED = 1024
"""First port that systems let every program listen on."""


def is_loopback(host: str) -> bool:
    """Return whether an address is of this computer alone. Names other than `localhost` count as other computers."""
    if host.strip().lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip()).is_loopback
    except ValueError:
        return False


def parse_address(text: str, port: int = 0) -> tuple[str, int]:
    """Parse `HOST`, `HOST:PORT`, `:PORT` or `[IPV6]:PORT`; by default the host is this computer, and the port `port`.

    Raises SourceError if the text is none of these.
    """
    host, colon, number = text.strip().rpartition(":")
    if not colon or (":" in host and not host.startswith("[")):
        host, number = text.strip(), str(port)
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK
    if not number.isdecimal() or not 0 <= int(number[:6]) <= 65535 or any(c.isspace() or c in "/@" for c in host):
        raise SourceError(
            "{text!r} is not an address. Use HOST:PORT, as in 192.168.1.7:{port}.", text=text, port=port or 21573
        )
    return host, int(number)


def resolve(host: str, port: int) -> tuple[int, tuple[str, int]]:
    """Find the family of a host, such as `socket.AF_INET`, and its numeric address with the port.

    Raises SourceError if the host cannot be found.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise SourceError(
            "The computer {host!r} was not found on the network. Check the address.", host=host
        ) from error
    return family, (str(address[0]), int(address[1]))


def bracketed(host: str) -> str:
    """Return a host as written before a port, which puts an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def reachable(host: str) -> str:
    """Return the address at which others reach a server that listens at `host` on this computer."""
    return _way_out() if host in _ALL else host


def listening(host: str, port: int, waiting: int) -> socket.socket:
    """Return a socket, which does not block, that listens on an address of this computer, or on any free port for 0.

    `waiting` connections may wait to be accepted. Raises SourceError if the address cannot be listened on.
    """
    family, address = resolve(host, port)
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setblocking(False)
        bind(listener, address)
        listener.listen(waiting)
    except OSError as error:
        listener.close()
        raise cannot_listen(host, port, error) from error
    return listener


def bind(opened: socket.socket, address: tuple[str, int]) -> None:
    """Bind a socket to an address, which no other program can then share; raises OSError if one has it already."""
    if sys.platform == "win32":  # where SO_REUSEADDR would let another program take the port over
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
    elif opened.type == socket.SOCK_STREAM:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port is free as soon as its program has ended
    opened.bind(address)


def cannot_listen(host: str, port: int, error: OSError) -> SourceError:
    """Return the error to raise for an address that cannot be listened on, by its cause."""
    if error.errno == errno.EADDRNOTAVAIL:
        return SourceError(
            "{host} is not an address of this computer. Enter one that it has, or {everywhere} for all of them.",
            host=host,
            everywhere=EVERYWHERE,
        )
    if error.errno in (errno.EACCES, errno.EPERM) and port < _UNPRIVILEGED:
        return SourceError(
            "This computer does not let programs listen on port {port}. Choose one of {unprivileged} or above.",
            port=port,
            unprivileged=_UNPRIVILEGED,
        )
    return SourceError(
        "Cannot listen on {host}:{port} ({reason}). Close the program that uses the port, or choose another port.",
        host=host,
        port=port,
        reason=error.strerror or error,
    )


def nobody_receives(host: str, port: int) -> str:
    """Return the message for a port that nothing listens on."""
    return Message(
        "No program receives at {host}:{port}. Start it there, or check the address and the port.",
        host=bracketed(host),
        port=port,
    )


def cannot_send(host: str, port: int, error: OSError) -> OutputError:
    """Return the error for an address that cannot be sent to."""
    return OutputError(
        "Cannot send to {host}:{port} ({reason}). Check the address and the program that receives there.",
        host=bracketed(host),
        port=port,
        reason=error.strerror or error,
    )


def _way_out() -> str:
    """Return this computer's address in the network that leads outside; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address that is reserved for documentation (RFC 5737)
        except OSError:
            return LOOPBACK
        return str(probe.getsockname()[0])


GREETING = struct.Struct(f">4sB{TOKEN_BYTES}s")
"""First message, from the receiver."""
ANSWER = struct.Struct(">4sBB")
"""The sender's answer, which is followed by messages."""
LENGTH = struct.Struct(">H")
"""Prefix of each message, its length; 0 only shows that the sender is connected."""
MAX_MESSAGE = 2048
"""Largest size of a message in bytes."""
MAGIC = b"FMTL"
_LINE = re.compile(r"facemime://([0-9a-f]{32})@([^\s@/]{1,260})/([0-9a-f]{64})", re.IGNORECASE)


@dataclass(frozen=True)
class Pairing:
    """A sender's address, and the secrets that authenticate both sides.

    Attributes
    ----------
    fingerprint : bytes
        SHA-256 of the sender's certificate in DER.
    token : bytes
        Secret that the receiver shows.
    """

    host: str
    port: int
    fingerprint: bytes
    token: bytes

    @property
    def line(self) -> str:
        """The pairing line."""
        return f"facemime://{self.token.hex()}@{self.address}/{self.fingerprint.hex()}"

    @property
    def address(self) -> str:
        """Host and port."""
        return f"{bracketed(self.host)}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether the sender is on this computer."""
        return is_loopback(self.host)

    def is_of(self, certificate: bytes) -> bool:
        """Return whether a certificate, in DER, is the sender's."""
        return hmac.compare_digest(fingerprint_of(certificate), self.fingerprint)


def fingerprint_of(certificate: bytes) -> bytes:
    """Return the fingerprint, 32 bytes, of a certificate in DER."""
    return hashlib.sha256(certificate).digest()


def parse_pairing(text: str) -> Pairing:
    """Parse a pairing line; SourceError if the text is not one, or only part of one."""
    found = _LINE.fullmatch(text.strip())
    if found is None:
        raise SourceError(
            "This is not a complete pairing line. Paste the whole line of the sending computer, starting with facemime://."
        )
    host, port = parse_address(found[2], PORT)
    return Pairing(host, port, bytes.fromhex(found[3]), bytes.fromhex(found[1]))

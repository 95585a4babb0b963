"""Pairing of two computers across networks: one line says where the sender is, and proves both sides to each other.

The sender has a certificate of its own, which nobody else has signed. The line holds its fingerprint, so the receiver
knows the sender, and a token, so the sender knows the receiver.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
from dataclasses import dataclass

from ..errors import SourceError
from .addresses import bracketed, is_loopback, parse_address

PORT = 21576
TOKEN_BYTES, FINGERPRINT_BYTES = 16, 32
VERSION = 1
ACCEPTED, REFUSED = 0, 1
GREETING = struct.Struct(f">4sB{TOKEN_BYTES}s")
"""What the receiver says first."""
ANSWER = struct.Struct(">4sBB")
"""What the sender answers; messages follow."""
LENGTH = struct.Struct(">H")
"""Before each message, its length; 0 says only that the sender is there."""
MAX_MESSAGE = 2048
"""Bytes of a message at most."""
MAGIC = b"FMTL"
_LINE = re.compile(r"facemime://([0-9a-f]{32})@([^\s@/]{1,260})/([0-9a-f]{64})", re.IGNORECASE)


@dataclass(frozen=True)
class Pairing:
    """A sender, and the proof of both sides.

    Attributes
    ----------
    host : str
    port : int
    fingerprint : bytes
        SHA-256 of the sender's certificate in DER.
    token : bytes
        The secret that the receiver shows.
    """

    host: str
    port: int
    fingerprint: bytes
    token: bytes

    @property
    def line(self) -> str:
        """The line to be pasted."""
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
        """Whether a certificate, in DER, is the sender's."""
        return hmac.compare_digest(fingerprint_of(certificate), self.fingerprint)


def fingerprint_of(certificate: bytes) -> bytes:
    """(32 bytes) fingerprint of a certificate in DER."""
    return hashlib.sha256(certificate).digest()


def parse_pairing(text: str) -> Pairing:
    """Parse a pairing line; raises SourceError if the text is not one, or only part of one."""
    found = _LINE.fullmatch(text.strip())
    if found is None:
        raise SourceError(
            "This is not a whole pairing line. Paste the line that facemime send --serve shows, from facemime:// on."
        )
    host, port = parse_address(found[2], PORT)
    return Pairing(host, port, bytes.fromhex(found[3]), bytes.fromhex(found[1]))

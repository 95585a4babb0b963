"""Pairing of two computers across networks, by one line that states where the sender is and authenticates both sides.

The sender has a self-made certificate. The line contains its fingerprint, by which the receiver recognises the sender,
and a token, by which the sender recognises the receiver.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
from dataclasses import dataclass

from ...errors import SourceError
from .addresses import bracketed, is_loopback, parse_address

PORT = 21576
TOKEN_BYTES = 16
FINGERPRINT_BYTES = 32
"""Size of a digest of SHA-256."""
VERSION = 1
ACCEPTED, REFUSED = 0, 1
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
    """A sender, and the secrets that authenticate both sides.

    Attributes
    ----------
    host : str
        Name or address of the sender.
    port : int
        Port of the sender.
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

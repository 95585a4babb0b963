"""A shared key for Facemime's own stream, which proves the sender and prevents replays, but hides nothing.

The key never crosses the network. The sender begins with a random session and nonce, and the receiver answers with its
own nonce, both signed with the key. Packets are then signed with a key derived from both nonces, so that a recording of
one session is useless in another. Signatures are HMAC-SHA256, truncated to 128 bits (RFC 2104).
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import ssl
from pathlib import Path

from ...errors import DataError, OutputError, SourceError
from ...files.reading import read_bytes
from ...files.writing import write_secret

TAG_BYTES = 16
"""Size of a signature, which is the first half of an HMAC-SHA256."""
NONCE_BYTES = 16
SESSION_BYTES = 8
"""Size of the name of a session."""
_MIN_KEY = 16
"""Smallest number of characters in a key."""
_MAX_KEY = 4096
"""Largest size of a key's file in bytes."""
_WINDOW = 64
"""Number of packets by which one may be late and still be distinguished from a replay."""


def read_key(path: Path) -> bytes:
    """Read a shared key from a file of at least 16 characters, as written by `write_key`.

    Raises
    ------
    SourceError
        If there is no such file, or it is too short or too long.
    """
    try:
        text = read_bytes(Path(path), _MAX_KEY).strip()
    except FileNotFoundError as error:
        raise SourceError("There is no key {path}. Make one: facemime receive --new-key {path}", path=path) from error
    except (OSError, ValueError) as error:
        raise SourceError(
            "The key {path} cannot be read ({error}). Choose a file of one line.", path=path, error=error
        ) from error
    if len(text) < _MIN_KEY:
        raise SourceError(
            "The key {path} has fewer than {min_key} characters. Make a longer one.", path=path, min_key=_MIN_KEY
        )
    return hashlib.sha256(b"facemime stream key\n" + text).digest()


def write_key(path: Path) -> None:
    """Write a new random key to a new file that only its owner can read; OutputError if it cannot be written."""
    try:
        write_secret(path, secrets.token_hex(32).encode() + b"\n")
    except FileExistsError as error:
        raise OutputError(
            "{path} already exists, and keys are never replaced. Choose another name.", path=path
        ) from error
    except OSError as error:
        raise OutputError(
            "The key {path} cannot be written ({reason}). Choose another location.", path=path, reason=error.strerror
        ) from error


def server_context(certificate: Path, key: Path | None) -> ssl.SSLContext:
    """Return the TLS context of a server with a certificate.

    Parameters
    ----------
    certificate, key : Path
        PEM files; without `key`, the file of the certificate contains it.

    Raises
    ------
    OSError
        If a file cannot be read, or they do not belong together.
    ValueError
        If the key has a password, which would be prompted for in a terminal.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key, password=_no_password)
    return context


def _no_password() -> str:
    raise DataError("the key has a password")


def sign(key: bytes, *parts: bytes) -> bytes:
    """Return the signature, 16 bytes, of the concatenated `parts`."""
    return hmac.new(key, b"".join(parts), hashlib.sha256).digest()[:TAG_BYTES]


def is_signed(key: bytes, tag: bytes, *parts: bytes) -> bool:
    """Check a signature in constant time.

    Parameters
    ----------
    key : bytes
        Key of the signature.

    Returns
    -------
    bool
        Whether `tag` is the signature of the concatenated parts.
    """
    return hmac.compare_digest(sign(key, *parts), tag)


def session_key(key: bytes, session: bytes, sent: bytes, answered: bytes) -> bytes:
    """Derive the key of a session.

    Parameters
    ----------
    session : bytes
        Session of the sender, `SESSION_BYTES` long.
    sent, answered : bytes
        Nonces of the sender and of the receiver.

    Returns
    -------
    bytes
        The key of the session.
    """
    return hmac.new(key, b"facemime session" + session + sent + answered, hashlib.sha256).digest()


class ReplayWindow:
    """Remembers received sequence numbers; each is accepted once (RFC 4303, section 3.4.3)."""

    def __init__(self) -> None:
        self._highest, self._seen = -1, 0

    def accept(self, sequence: int) -> bool:
        """Return whether a number is new, and not too old to be checked; it is then remembered."""
        ahead = sequence - self._highest
        if ahead > 0:
            self._seen = ((self._seen << ahead) | 1) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 1
            self._highest = sequence
            return True
        if -ahead >= _WINDOW or self._seen >> -ahead & 1:
            return False
        self._seen |= 1 << -ahead
        return True

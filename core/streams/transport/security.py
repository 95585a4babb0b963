"""How computers trust each other: a shared key for Facemime's own stream, or the certificate of a sender over TLS.

The key never crosses the network. The sender begins with a random session and nonce, and the receiver answers with
its own nonce, both signed with the key. Packets are then signed with a key derived from both nonces, so that a
recording of one session is useless in another. Signatures are HMAC-SHA256, truncated to 128 bits (RFC 2104).
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from ...errors import DataError, OutputError, SourceError
from ...files.owner_only import write_secret
from ...files.reading import read_bytes
from .addresses import TOKEN_BYTES, Pairing, fingerprint_of, parse_address, reachable

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
_CERTIFICATE = "certificate.pem"
_KEY = "key.pem"
_TOKEN = "token"
_YEARS = 10


def read_key(path: Path) -> bytes:
    """Read a shared key from a file of at least 16 characters, as written by `write_key`.

    Raises SourceError if there is no such file, or it is too short or too long.
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
    """Return the TLS context of a server from PEM files; without `key`, the file of the certificate contains it.

    Raises OSError if a file cannot be read, or they do not belong together, and ValueError if the key has a password,
    which would be prompted for in a terminal.
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
    """Return whether `tag` is the signature of the concatenated parts, in constant time."""
    return hmac.compare_digest(sign(key, *parts), tag)


def session_key(key: bytes, session: bytes, sent: bytes, answered: bytes) -> bytes:
    """Derive a session's key from its `SESSION_BYTES` and the nonces of the sender and of the receiver."""
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


_MOST = 1 << 16
_COMMON_NAME = "2.5.4.3"
"""Object identifier of RFC 5280."""
_ECDSA_WITH_SHA256 = "1.2.840.10045.4.3.2"
"""Object identifier of RFC 5758."""
_UTF8, _UTC_TIME, _TIME = 0x0C, 0x17, 0x18
"""Tags of DER: UTF8String, UTCTime and GeneralizedTime."""


@dataclass(frozen=True)
class TlsIdentity:
    """What this computer proves itself by.

    Attributes
    ----------
    context : ssl.SSLContext
        For TLS 1.3, with the certificate.
    fingerprint : bytes
        SHA-256 of the certificate.
    token : bytes
        What receivers have to show.
    """

    context: ssl.SSLContext
    fingerprint: bytes
    token: bytes

    def pairing(self, host: str, port: int, public: str = "") -> Pairing:
        """Return the pairing by which others reach a sender that listens on an address of this computer.

        `public` is the address by which other networks reach it, HOST[:PORT]; "" for its own. Raises SourceError if it
        is none.
        """
        reached = parse_address(public, port) if public else (reachable(host), port)
        return Pairing(*reached, self.fingerprint, self.token)


def load_identity(folder: Path) -> TlsIdentity:
    """Load the identity stored in a folder; create one if the folder has none.

    Raises SourceError if the files cannot be used, and OutputError if they cannot be written.
    """
    if not os.path.lexists(folder / _CERTIFICATE):
        _write_identity(folder)
    try:
        context = server_context(folder / _CERTIFICATE, folder / _KEY)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        certificate = ssl.PEM_cert_to_DER_cert(read_bytes(folder / _CERTIFICATE, _MOST).decode("ascii"))
        token = bytes.fromhex(read_bytes(folder / _TOKEN, _MOST).decode("ascii").strip())
    except (OSError, ValueError) as error:
        raise SourceError(
            "The certificate in {folder} cannot be used ({error}). Delete the folder, and pair again.",
            folder=folder,
            error=error,
        ) from error
    if len(token) != TOKEN_BYTES:
        raise SourceError(
            "The token in {folder} is too short or too long. Delete the folder, and pair again.", folder=folder
        )
    return TlsIdentity(context, fingerprint_of(certificate), token)


def renew_identity(folder: Path) -> None:
    """Replace the identity in a folder, so that its pairing lines are no longer valid; may raise OutputError."""
    _write_identity(folder)


def _write_identity(folder: Path) -> None:
    certificate, key = _make_certificate()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for name, content in (
            (_KEY, key),
            (_TOKEN, secrets.token_hex(TOKEN_BYTES).encode() + b"\n"),
            (_CERTIFICATE, certificate),  # last, as it says that the others are there
        ):
            write_secret(folder / name, content, replace=True)
    except OSError as error:
        raise OutputError(
            "The certificate cannot be written to {folder} ({reason}). Make the folder writable.",
            folder=folder,
            reason=error.strerror,
        ) from error


def _make_certificate() -> tuple[bytes, bytes]:
    """Make a certificate (RFC 5280, version 3) and its key, PEM."""
    # Only now, as it takes a moment; Python's ssl can use certificates, but not make them.
    from Cryptodome.Hash import SHA256
    from Cryptodome.PublicKey import ECC
    from Cryptodome.Signature import DSS
    from Cryptodome.Util.asn1 import DerBitString, DerInteger, DerObject, DerObjectId, DerSequence, DerSetOf

    key = ECC.generate(curve="p256")
    algorithm = DerSequence([DerObjectId(_ECDSA_WITH_SHA256)])
    common_name = DerSequence([DerObjectId(_COMMON_NAME), DerObject(_UTF8, b"Facemime")])
    name = DerSequence([DerSetOf({common_name.encode()})])
    now = datetime.now(UTC)
    body = DerSequence(
        [
            DerInteger(2, explicit=0),  # version 3, which TLS 1.3 requires
            DerInteger(secrets.randbits(64) | 1 << 64),
            algorithm,
            name,
            DerSequence([DerObject(*der_time(now + span)) for span in (-timedelta(days=1), _YEARS * timedelta(365))]),
            name,
            DerSequence().decode(key.public_key().export_key(format="DER")),
        ]
    )
    signature = DSS.new(key, "fips-186-3", encoding="der").sign(SHA256.new(body.encode()))
    certificate = DerSequence([body, algorithm, DerBitString(signature)]).encode()
    return ssl.DER_cert_to_PEM_cert(certificate).encode(), key.export_key(format="PEM").encode()


def der_time(time: datetime) -> tuple[int, bytes]:
    """Return the tag and the content of a time in DER; years from 2050 on have four digits (RFC 5280, 4.1.2.5)."""
    return (
        (_UTC_TIME, f"{time:%y%m%d%H%M%SZ}".encode()) if time.year < 2050 else (_TIME, f"{time:%Y%m%d%H%M%SZ}".encode())
    )

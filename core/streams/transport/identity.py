"""The identity of this computer as a sender over TLS: a certificate that it signs itself, and a token."""

from __future__ import annotations

import os
import secrets
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from ...errors import OutputError, SourceError
from ...files.reading import read_bytes
from ...files.writing import write_secret
from .addresses import parse_address, reachable
from .pairing import TOKEN_BYTES, Pairing, fingerprint_of
from .security import server_context

_CERTIFICATE = "certificate.pem"
_KEY = "key.pem"
_TOKEN = "token"
_YEARS = 10
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
        """Return the pairing by which others reach a sender on this computer.

        Parameters
        ----------
        host : str
            Address of this computer on which the sender listens.
        public : str
            Address by which other networks reach this computer, HOST[:PORT]; "" for its own.

        Raises
        ------
        SourceError
            If `public` is no address.
        """
        reached = parse_address(public, port) if public else (reachable(host), port)
        return Pairing(*reached, self.fingerprint, self.token)


def load_identity(folder: Path) -> TlsIdentity:
    """Load the identity stored in a folder; create one if the folder has none.

    Raises
    ------
    SourceError
        If the files cannot be used.
    OutputError
        If they cannot be written.
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
    """Replace the identity stored in a folder, so that its pairing lines are no longer valid.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
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

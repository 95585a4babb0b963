"""The identity of this computer for `facemime send --serve`: a certificate that nobody else signed, and a token."""

from __future__ import annotations

import os
import secrets
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from ..core.errors import OutputError, SourceError
from ..core.files import write_secret
from ..core.reading import read_bytes
from ..core.streams.pairing import TOKEN_BYTES, fingerprint_of
from ..core.streams.security import server_context

_CERTIFICATE, _KEY, _TOKEN = "certificate.pem", "key.pem", "token"
_YEARS = 10
_MOST = 1 << 16


@dataclass(frozen=True)
class Identity:
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


def load_identity(folder: Path) -> Identity:
    """Load the identity stored in a folder; create one if the folder has none.

    Raises
    ------
    SourceError
        If the files cannot be used, or if there are none yet and the package `cryptography` is not installed.
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
            f"The certificate in {folder} cannot be used ({error}). Choose another folder, and pair again."
        ) from error
    if len(token) != TOKEN_BYTES:
        raise SourceError(f"The token in {folder} is too short or too long. Choose another folder, and pair again.")
    return Identity(context, fingerprint_of(certificate), token)


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
            f"The certificate cannot be written to {folder} ({error.strerror}). Choose another folder."
        ) from error


def _make_certificate() -> tuple[bytes, bytes]:
    """Make a certificate and its key, PEM."""
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError as error:
        raise SourceError(
            "The package cryptography is missing, which makes the certificate. Install it: pip install cryptography"
        ) from error
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "Facemime")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=365 * _YEARS))
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return certificate.public_bytes(serialization.Encoding.PEM), private

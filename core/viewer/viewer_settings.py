"""Address of the viewer, access to it, and its QR code."""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError, SourceError
from ..files.owner_only import write_secret
from ..files.reading import read_bytes
from ..streams.transport.addresses import LOOPBACK, bracketed, is_loopback, reachable
from ..streams.transport.security import server_context

PORT = 21574
MAX_VIEWERS = 16
"""Largest number of pages that may watch at a time."""
_QUIET = 4
"""Width of the margin in modules that ISO/IEC 18004 requires."""


_HOST = re.compile(r"(?:\[[0-9a-fA-F:.]{2,45}\]|[0-9A-Za-z._-]{1,253})(?::[0-9]{1,5})?")
"""A host as browsers write it: the policy of the page repeats it, so it must have nothing else."""
_MIN_TOKEN = 16
"""Smallest number of characters in a token."""
_MAX_TOKEN = 128
"""Largest size of a token's file in bytes."""


@dataclass(frozen=True)
class ViewerSettings:
    """Address of the viewer, and access to it.

    Attributes
    ----------
    host : str
        Address of this computer; only this computer can open a loopback address.
    port : int
        Port; 0 for any free one.
    token : str
        Secret in the address of the page; "" for a new one.
    certificate, key : Path or None
        PEM files of a certificate and its private key, for HTTPS.
    """

    host: str = LOOPBACK
    port: int = PORT
    token: str = ""
    certificate: Path | None = None
    key: Path | None = None

    @property
    def is_local(self) -> bool:
        """Whether only this computer can open the page."""
        return is_loopback(self.host)

    @property
    def scheme(self) -> str:
        """The scheme of the address of the page."""
        return "http" if self.certificate is None else "https"

    def context(self) -> ssl.SSLContext | None:
        """Load the certificate, if there is one; SourceError if it cannot be used."""
        if self.certificate is None:
            if self.key is not None:
                raise SourceError("A private key was given without its certificate. Give the certificate, too.")
            return None
        try:
            return server_context(self.certificate, self.key)
        except FileNotFoundError as error:
            raise SourceError(
                "There is no certificate {certificate}, or no key {key}. Check the paths.",
                certificate=self.certificate,
                key=self.key,
            ) from error
        except (OSError, ValueError) as error:
            raise SourceError(
                "The certificate {certificate} and its key cannot be used ({error}). "
                "Choose the PEM files that belong together; the key must have no password.",
                certificate=self.certificate,
                error=error,
            ) from error

    def allows(self, host: str) -> bool:
        """Return whether a request may name this host, with or without a port, which protects against DNS rebinding.

        Allowed are names of this computer and addresses, but not names that another site has pointed here.
        """
        if _HOST.fullmatch(host) is None:
            return False
        name = _without_port(host).lower().rstrip(".")
        own = socket.gethostname().lower()
        if name in {"localhost", own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not self.is_local

    def shown_host(self) -> str:
        """Address to enter in a browser.

        For a computer that listens on all its networks, it is the address that leads outside.
        """
        return bracketed(reachable(self.host))


def new_token() -> str:
    """Return a random token of 128 bits."""
    return secrets.token_urlsafe(16)


def kept_token(path: Path) -> str:
    """Read a token from a file, which is created if it does not exist, so that an address stays valid.

    Raises SourceError if the file cannot be read, or does not contain a token, and OutputError if it cannot be written.
    """
    try:
        text = read_bytes(path, _MAX_TOKEN).decode("ascii").strip()
    except FileNotFoundError:
        return _written_token(path)
    except (OSError, ValueError) as error:
        raise SourceError(
            "The token {path} cannot be read ({error}). Choose another file.", path=path, error=error
        ) from error
    if len(text) < _MIN_TOKEN or not text.replace("-", "").replace("_", "").isalnum():
        raise SourceError(
            "{path} has no token of at least {min_token} letters and digits. Choose another file.",
            path=path,
            min_token=_MIN_TOKEN,
        )
    return text


def same_token(given: str, token: str) -> bool:
    """Compare the token of a request in constant time."""
    return hmac.compare_digest(given.encode(), token.encode())


def _written_token(path: Path) -> str:
    token = new_token()
    try:
        write_secret(path, token.encode() + b"\n")
    except OSError as error:
        raise OutputError(
            "The token {path} cannot be written ({reason}). Choose another location.", path=path, reason=error.strerror
        ) from error
    return token


def _without_port(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.rpartition(":")[0] if host.count(":") == 1 else host


def qr_code(text: str) -> NDArray[np.bool_]:
    """Return the modules of the QR code of a text, (N, N), true where dark, with the margin."""
    dark = cv2.QRCodeEncoder.create().encode(text) < 128
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    inner = dark[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return np.asarray(np.pad(inner, _QUIET), dtype=np.bool_)


def as_text(code: NDArray[np.bool_]) -> str:
    """Format a QR code as lines of half blocks, for a terminal with light text on a dark background."""
    padded = np.pad(code, ((0, len(code) % 2), (0, 0)))
    pairs = zip(padded[::2], padded[1::2], strict=True)
    return "\n".join("".join("█▀▄ "[2 * a + b] for a, b in zip(*pair, strict=True)) for pair in pairs)

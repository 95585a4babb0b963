"""Sending to paired computers in other networks: the identity of this computer, and the line that pairs another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..core.streams.transport.addresses import EVERYWHERE
from ..core.streams.transport.identity import load_identity
from ..core.streams.transport.pairing import PORT
from .storage import private_folder
from .stream_properties import FacemimeOutput

if TYPE_CHECKING:
    from ..core.streams.transport.tls_server import TlsSender


def pairing_folder() -> Path:
    """Return the folder of this computer's certificate and token."""
    return private_folder("pairing")


def listening_host(output: FacemimeOutput) -> str:
    """Return the address on which paired computers are awaited."""
    return output.listen.strip() or EVERYWHERE


def pairing_line(output: FacemimeOutput) -> str:
    """Return the line to paste on another computer.

    Raises
    ------
    SourceError
        If the public address is not an address, or the stored certificate cannot be used.
    OutputError
        If the certificate cannot be written.
    """
    pairing = load_identity(pairing_folder()).pairing(listening_host(output), output.port or PORT, output.public)
    return pairing.line


def open_paired_sender(output: FacemimeOutput) -> TlsSender:
    """Return the sender to paired computers.

    Raises
    ------
    SourceError
        If the address cannot be listened on, or the stored certificate cannot be used.
    OutputError
        If the certificate cannot be written.
    """
    from ..core.streams.transport.tls_server import TlsSender  # only now, as its libraries take a moment

    identity = load_identity(pairing_folder())
    return TlsSender(listening_host(output), output.port or PORT, identity.context, identity.token)

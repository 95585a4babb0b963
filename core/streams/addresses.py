"""Addresses of computers: what users enter, and which of them are this computer's."""

from __future__ import annotations

import ipaddress
import socket

from ..errors import OutputError, SourceError

LOOPBACK, EVERYWHERE = "127.0.0.1", "0.0.0.0"
_ALL = {EVERYWHERE, "::"}


def is_loopback(host: str) -> bool:
    """Whether an address is of this computer alone. Names other than `localhost` count as others."""
    if host.strip().lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip()).is_loopback
    except ValueError:
        return False


def parse_address(text: str, port: int = 0) -> tuple[str, int]:
    """Parse `HOST`, `HOST:PORT`, `:PORT` or `[IPV6]:PORT`.

    Parameters
    ----------
    text : str
    port : int
        Used if `text` states none.

    Returns
    -------
    host : str
        Of this computer if `text` states none.
    port : int

    Raises
    ------
    SourceError
        If it is neither.
    """
    host, colon, number = text.strip().rpartition(":")
    if not colon or (":" in host and not host.startswith("[")):
        host, number = text.strip(), str(port)
    host = host.removeprefix("[").removesuffix("]") or LOOPBACK
    if not number.isdecimal() or not 0 <= int(number[:6]) <= 65535 or any(c.isspace() or c in "/@" for c in host):
        raise SourceError(f"{text!r} is not an address. Use HOST:PORT, as in 192.168.1.7:{port or 21573}.")
    return host, int(number)


def resolve(host: str, port: int) -> tuple[int, tuple[str, int]]:
    """Find the family and the numeric address of a host.

    Parameters
    ----------
    host : str
    port : int

    Returns
    -------
    family : int
    address : (str, int)

    Raises
    ------
    SourceError
        If the host is not known.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise SourceError(f"There is no computer {host!r} in the network. Check the address.") from error
    return family, (str(address[0]), int(address[1]))


def bracketed(host: str) -> str:
    """Return a host as it is written before a port: an IPv6 address is in brackets."""
    return f"[{host}]" if ":" in host else host


def reachable(host: str) -> str:
    """Return the address by which others reach what listens at `host` of this computer."""
    return _way_out() if host in _ALL else host


def cannot_listen(host: str, port: int, error: OSError) -> SourceError:
    """Return the error for an address that cannot be listened on."""
    return SourceError(
        f"Cannot listen on {host}:{port} ({error.strerror or error}). "
        "Close the program that uses the port, or choose another port."
    )


def cannot_send(host: str, port: int, error: OSError) -> OutputError:
    """Return the error for an address that does not take what is sent to it."""
    return OutputError(
        f"Cannot send to {bracketed(host)}:{port} ({error.strerror or error}). "
        "Check the address and the program that receives there."
    )


def _way_out() -> str:
    """Return the address of this computer in the network that leads outside; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address that is reserved for documentation (RFC 5737)
        except OSError:
            return LOOPBACK
        return str(probe.getsockname()[0])

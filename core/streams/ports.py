"""Which addresses are of one sender: some programs open another port for each packet, others share a computer."""

from __future__ import annotations

from dataclasses import dataclass, field

from .casting import SILENT, Address

_HOPS = 6
"""Number of ports in a row that come and fall silent from which they are one sender's. More senders than that hardly
ever begin on one computer at once; the frames of the first ports are lost."""
_OVERLAP = 0.05
"""Seconds for which packets of a port may still come after those of the next one, as networks reorder them. A sender
that keeps its port is heard for longer even at 15 frames per second."""
_WATCHED = 16
"""Number of the newest ports of a computer that are watched, the number of senders that are played."""
_MAX_HOSTS = 16
"""Largest number of computers that are watched."""


@dataclass
class _Port:
    since: float
    back: float | None = None


@dataclass
class _Host:
    """The newest ports of a computer, the first one of their row, and those that are in use all the time."""

    heard: float
    newest: dict[int, _Port] = field(default_factory=dict)
    first: int = 0
    kept: dict[int, float] = field(default_factory=dict)


class Ports:
    """Watches the ports of each computer."""

    def __init__(self) -> None:
        self._hosts: dict[str, _Host] = {}

    def sender_of(self, address: Address, now: float) -> Address:
        """Return the address that stands for the sender of a packet: the first of a row of ports, or `address`."""
        name, port = address
        host = self._hosts.get(name)
        if host is None or port in host.kept or now - host.heard > SILENT:
            return address
        return (name, host.first) if len(host.newest.keys() | {port}) >= _HOPS else address

    def note(self, address: Address, now: float) -> list[Address]:
        """Note an accepted packet, and return the addresses that turn out not to be senders of their own."""
        name, port = address
        host = self._host(name, now)
        host.kept = {other: heard for other, heard in host.kept.items() if now - heard <= SILENT}
        if port in host.kept:
            host.kept[port] = now
            return []
        if now - host.heard > SILENT:
            host.newest.clear()
        host.heard = now
        if port in host.newest:
            _again(host, port, now)
            return []
        host.newest[port] = _Port(now)
        if len(host.newest) == 1:
            host.first = port
        if len(host.newest) < _HOPS:
            return []
        if len(host.newest) > _WATCHED:
            del host.newest[next(iter(host.newest))]
        return [(name, other) for other in host.newest if other != host.first]

    def _host(self, name: str, now: float) -> _Host:
        if name not in self._hosts and len(self._hosts) >= _MAX_HOSTS:
            del self._hosts[min(self._hosts, key=lambda known: self._hosts[known].heard)]
        return self._hosts.setdefault(name, _Host(now))


def _again(host: _Host, port: int, now: float) -> None:
    """Keep a port that is heard twice after the next one came; once may be a port that is used again."""
    known = host.newest[port]
    after = [other.since for other in host.newest.values() if other.since > known.since]
    if not after or now - min(after) <= _OVERLAP:
        return
    known.back = now if known.back is None else known.back
    if now - known.back <= _OVERLAP:
        return
    del host.newest[port]
    host.kept[port] = now
    if port == host.first:
        host.first = next(iter(host.newest))

"""Packets of every protocol to fuzz: what a decoder does not refuse has to be a possible face."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

from facemime.core.base.errors import SourceError
from facemime.core.streams.frames import PacketError
from lab.bench.packets import INTACT, is_possible, packets, phone_json

from .mutators import mutated_bytes, mutated_json


def mutated_packet(name: str, rng: Random) -> bytes:
    """A damaged packet: changed, cut, joined with another, of another protocol, or noise."""
    data = rng.choice(packets(name))
    kind = rng.random()
    if kind < 0.05:
        return rng.randbytes(rng.choice((0, 1, 8, 100, 1500, 20_000)))
    if kind < 0.1:
        return rng.choice(packets(rng.choice(tuple(INTACT))))
    if kind < 0.2:
        return data + rng.choice(packets(name))[: rng.randrange(2000)]
    if name == "vtubestudio" and kind < 0.7:
        return mutated_json(rng, phone_json())
    return mutated_bytes(rng, data)


def read_packet(name: str, data: bytes) -> None:
    """Decode a packet as a receiver does, and then intact ones; SourceError if the first is refused."""
    decoder = INTACT[name][0]()
    try:
        frames = decoder.decode(data)
    except PacketError as error:
        raise SourceError(f"refused: {error}") from None
    for packet in packets(name):
        with suppress(PacketError):  # the first may have told of another mesh, or of other names
            frames += decoder.decode(packet)
    assert all(map(is_possible, frames))


def reader(name: str) -> Callable[[Path], None]:
    """Read a packet from a file."""
    return lambda path: read_packet(name, path.read_bytes())

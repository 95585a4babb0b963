"""Network namespaces are joined by a wire that delays and loses what crosses it."""

from __future__ import annotations

import socket
import time

import pytest

from lab.bench.link import Link
from lab.bench.namespaces import ADDRESSES, Wire, may_join

pytestmark = pytest.mark.skipif(not may_join(), reason="network namespaces need root on Linux")
PORT = 9000


def ends(wire: Wire) -> tuple[socket.socket, socket.socket]:
    """A socket in each room; the second receives."""
    sockets = []
    for end in (0, 1):
        with wire.inside(end):
            sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    sockets[1].bind((ADDRESSES[1], PORT))
    sockets[1].settimeout(1.0)
    return sockets[0], sockets[1]


def crossed(sender: socket.socket, receiver: socket.socket, count: int) -> set[bytes]:
    """Send packets, and return those that arrive within a second of the one before."""
    for number in range(count):
        sender.sendto(str(number).encode(), (ADDRESSES[1], PORT))
    arrived = set()
    try:
        while True:
            arrived.add(receiver.recv(100))
    except TimeoutError:
        return arrived


def test_packets_take_at_least_the_delay_and_are_lost_only_as_asked():
    with Wire(Link(delay=0.05, jitter=0.0)) as wire:
        sender, receiver = ends(wire)
        with sender, receiver:
            began = time.perf_counter()
            sender.sendto(b"first", (ADDRESSES[1], PORT))
            assert receiver.recv(100) == b"first" and time.perf_counter() - began >= 0.05
            assert len(crossed(sender, receiver, 100)) == 100
            wire.cut = True
            assert not crossed(sender, receiver, 10)
    with Wire(Link(delay=0.001, jitter=0.0, loss=0.5)) as wire:
        sender, receiver = ends(wire)
        with sender, receiver:
            assert 20 < len(crossed(sender, receiver, 100)) < 80


def test_a_thread_is_back_in_its_own_network_afterwards():
    with Wire(Link()) as wire, socket.create_server(("127.0.0.1", 0)) as listener:
        with wire.inside(0), pytest.raises(OSError):
            socket.create_connection(listener.getsockname(), timeout=1.0)
        socket.create_connection(listener.getsockname(), timeout=60.0).close()

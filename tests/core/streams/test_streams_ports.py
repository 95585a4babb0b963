"""Senders that open another port for each packet are one sender each, and several on one computer remain several."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from contextlib import closing
from itertools import count

import numpy as np
import pytest

from facemime.core.streams.ports import Ports
from facemime.core.streams.protocols import osc
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from tests.helpers.links import free_port
from tests.helpers.thorough import first_of

HOST = "10.0.0.1"


class Wire:
    """Hands packets to a source at the times at which they arrive, as a link that reads a socket does."""

    largest, message, address = 1 << 14, "", ("127.0.0.1", 0)

    def __init__(self) -> None:
        self.packets: list[tuple[float, int, bytes, tuple[str, int]]] = []
        self._order = count()

    def send(self, now: float, data: bytes, address: tuple[str, int]) -> None:
        heapq.heappush(self.packets, (now, next(self._order), data, address))

    def open(self) -> None: ...

    def close(self) -> None: ...

    def waits(self):
        return [], []

    def receive(self, now: float):
        return heapq.heappop(self.packets)[2:] if self.packets and self.packets[0][0] <= now else None


def frame(value: float) -> list[bytes]:
    """The messages of a frame of VMC, each as a datagram."""
    return [osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", value), osc.encode_message("/VMC/Ext/Blend/Apply")]


def new_ports(first: int = 40_000) -> Iterator[int]:
    """Ports at random, as a system chooses them, of which some come again."""
    rng = np.random.default_rng(first)
    while True:
        yield int(rng.integers(first, first + 500))


def played(wire: Wire, seconds: float, heads: int = 1) -> list:
    """Return the frames that a source shows in simulated time."""
    now, frames = 0.0, []
    settings = StreamSettings("vmc", port=free_port(), senders=("",) * heads)
    with closing(StreamSource(settings, lambda: now)) as source:
        source._link = wire
        while now < seconds:
            now += 0.004
            if (shown := source.read(0.0)) is not None and not shown.filled:
                frames.append((shown, source.senders, dict(source.driven)))
    return frames


@pytest.mark.parametrize("rate", [5.0, 15.0, 30.0, 60.0])
@pytest.mark.parametrize("each", ["frame", "message"])
@pytest.mark.parametrize("heads", [1, 2])
def test_a_sender_that_opens_a_port_for_each_frame_or_message_is_one_sender(rate, each, heads):
    wire, ports, total = Wire(), new_ports(), int(6.0 * rate)
    for number in range(total):
        port = next(ports)
        for data in frame(number / total):
            wire.send(1.0 + number / rate, data, (HOST, port if each == "frame" else next(ports)))
    frames = played(wire, 8.0, heads)
    values = np.array([shown.result.coefficients[24] for shown, *_ in frames])
    assert len(frames) >= total - 8 and (np.diff(values[3:]) > 0.0).all()
    assert frames[-1][1] == (HOST,) and frames[-1][0].heads in (None, tuple(range(heads)))
    assert len({shown.performer for shown, *_ in frames[-total // 2 :]}) == 1


@pytest.mark.parametrize("rate", first_of([15.0, 30.0, 60.0]))
@pytest.mark.parametrize("senders", [2, 3, 7])
def test_senders_on_one_computer_that_keep_their_ports_remain_as_many(rate, senders):
    wire = Wire()
    for number in range(int(4.0 * rate)):
        for sender in range(senders):
            for data in frame((1.0 + sender) / 10.0):
                wire.send(1.0 + (number + sender / senders) / rate, data, (HOST, 50_000 + sender))
    frames = played(wire, 5.0, senders)
    late = frames[len(frames) // 2 :]
    assert len(late[-1][1]) == senders
    shown = {(shown.performer, round(float(shown.result.coefficients[24]), 3)) for shown, *_ in late}
    assert len(shown) == senders == len({value for _, value in shown})


@pytest.mark.parametrize("first", ["keeps", "changes"])
def test_a_sender_that_keeps_its_port_and_one_that_changes_it_are_two(first):
    wire, ports = Wire(), new_ports()
    for number in range(180):
        begin = {"keeps": 0.0, "changes": 0.0, first: -1.0}
        for kind, value in (("keeps", 0.2), ("changes", 0.8)):
            address = (HOST, 39_000 if kind == "keeps" else next(ports))
            for data in frame(value):
                wire.send(2.0 + begin[kind] + number / 30.0 + (0.013 if kind == "keeps" else 0.0), data, address)
    frames = played(wire, 7.0, 2)
    late = [(shown.performer, round(float(shown.result.coefficients[24]), 3)) for shown, *_ in frames[-200:]]
    assert sorted({value for _, value in late}) == [0.2, 0.8] and len(set(late)) == 2
    assert min(sum(value == each for _, value in late) for each in (0.2, 0.8)) > 50


def test_a_restarted_sender_and_one_on_another_computer_are_senders_of_their_own():
    ports, now = Ports(), 0.0
    for start in range(20):
        for _ in range(30):
            now += 1.0 / 30.0
            assert ports.sender_of((HOST, 50_000 + start), now) == (HOST, 50_000 + start)
            assert ports.sender_of(("10.0.0.2", 50_000), now) == ("10.0.0.2", 50_000)
            assert not ports.note((HOST, 50_000 + start), now) and not ports.note(("10.0.0.2", 50_000), now)
        now += 3.0


def test_packets_that_a_network_reorders_do_not_part_a_sender_that_changes_its_port():
    ports, wire, rng = new_ports(), Wire(), np.random.default_rng(2)
    for number in range(180):
        port = next(ports)
        for data in frame(number / 180):
            wire.send(1.0 + number / 30.0 + rng.uniform(0.0, 0.04), data, (HOST, port))
    frames = played(wire, 8.0)
    assert len(frames) > 165 and frames[-1][1] == (HOST,)


def test_a_flood_from_forged_addresses_is_forgotten():
    ports, rng = Ports(), np.random.default_rng(0)
    for number in range(20_000):
        address = (f"10.0.0.{rng.integers(200)}", int(rng.integers(1024, 65_536)))
        ports.sender_of(address, number / 1e4)
        ports.note(address, number / 1e4)
    assert len(ports._hosts) <= 16 and all(len(host.newest) <= 16 for host in ports._hosts.values())

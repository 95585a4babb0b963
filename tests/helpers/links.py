"""A real network for tests, and senders on it."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path

from pytest import MonkeyPatch

from facemime.core.puppet.outputs import Output
from facemime.core.puppet.sources import LiveFrame
from facemime.core.streams.sender import StreamSender
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import PROTOCOLS, SendSettings
from facemime.core.takes.file import TakeWriter, load_take
from facemime.core.takes.measured import coefficient_face
from facemime.core.takes.neutral import Neutral
from facemime.core.takes.take import Take, describe
from tests.helpers.clocks import PATIENCE
from tests.helpers.takes import coefficient_take


def free_port() -> int:
    """Return a port of this computer that is free for both connections and datagrams."""
    while True:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_STREAM) as connections,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams,
        ):
            connections.bind(("127.0.0.1", 0))
            port = int(connections.getsockname()[1])
            try:
                datagrams.bind(("127.0.0.1", port))
            except OSError:  # taken by another program's datagrams
                continue
            return port


class Phone(threading.Thread):
    """A phone on a port of this computer, at which the sources of a protocol ask it from now on.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
        Restores the protocol at the end.
    protocol : str
        Name of the protocol.
    *ports : str
        Fields of the protocol that become the phone's port.
    """

    def __init__(self, monkeypatch: MonkeyPatch, protocol: str, *ports: str) -> None:
        super().__init__(daemon=True)
        self._ended = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        moved = dict.fromkeys(ports, self._socket.getsockname()[1])
        monkeypatch.setitem(PROTOCOLS, protocol, replace(PROTOCOLS[protocol], **moved))

    def close(self) -> None:
        """End the phone."""
        self._ended.set()
        self.join()
        self._socket.close()


@contextmanager
def all_the_time(send: Callable[[float], None], pause: float = 1.0 / 60.0) -> Iterator[None]:
    """Call `send` with the seconds since the start in a thread, with pauses in seconds, within the context."""
    over, began = threading.Event(), time.monotonic()

    def run() -> None:
        while not over.wait(pause):
            send(time.monotonic() - began)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def performing(sender: Output, take: Take, neutral: Neutral | None = None) -> Iterator[None]:
    """Send the frames of a take, again and again, within the context."""
    frames = cycle(range(len(take)))
    with all_the_time(lambda seconds: sender.send(seconds, take.result(next(frames)), neutral)):
        yield


@contextmanager
def sending_phone(port: int) -> Iterator[Take]:
    """A phone that keeps sending a second of coefficients as Live Link Face; yields the sent frames."""
    take, sender = coefficient_take(60), StreamSender(SendSettings("livelink", port=port, subject="Phone"))
    with closing(sender), performing(sender, take, coefficient_face().neutral):
        yield take


def sender_to(source: StreamSource, **settings) -> StreamSender:
    return StreamSender(SendSettings(source.settings.protocol, "127.0.0.1", source.address[1], **settings))


def collected(source: StreamSource, count: int, feed=lambda: None) -> list[LiveFrame]:
    """Return real frames until there are `count`, with `feed` called between reads."""
    frames: list[LiveFrame] = []
    end = time.monotonic() + PATIENCE
    while len(frames) < count:
        assert time.monotonic() < end, source.counts
        feed()
        frame = source.read(0.01)
        if frame is not None and not frame.filled:
            frames.append(frame)
    return frames


def streamed(source: StreamSource, take: Take, send) -> list[LiveFrame]:
    """Return what `source` plays when `send` is called with every frame of a take, in real time."""
    began, sent = time.monotonic(), iter(range(len(take)))
    waiting = next(sent)

    def feed() -> None:
        nonlocal waiting
        while waiting is not None and time.monotonic() - began >= take.times[waiting]:
            send(waiting)
            waiting = next(sent, None)

    return collected(source, len(take), feed)


def recorded(frames: list[LiveFrame], path: Path) -> Take:
    """Return the take that a recording of these frames gives."""
    info = describe("stream", 60.0, (1280, 720), "", "media")
    if frames[-1].neutral is not None:
        info |= {"measured": True, "calibration": frames[-1].neutral.to_dict()}
    with TakeWriter(path, info) as writer:
        for frame in frames:
            writer.append(frame.time, frame.result)
    return load_take(path)

"""A real network, for tests, and who sends on it."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import cycle

from facemime.core.streams.sender import SendSettings, StreamSender
from facemime.core.takes.from_coefficients import coefficient_face
from facemime.core.takes.take import Take
from takes import coefficient_take


def free_port() -> int:
    """A port of this computer that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def all_the_time(send: Callable[[float], None], pause: float = 1.0 / 60.0) -> Iterator[None]:
    """Calls `send` with the seconds since the start in a thread, with pauses of seconds."""
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
def sending_phone(port: int) -> Iterator[Take]:
    """A phone that sends a second of coefficients again and again, as Live Link Face; yields what it sends."""
    take, neutral = coefficient_take(60), coefficient_face().neutral
    frames = cycle(range(len(take)))
    sender = StreamSender(SendSettings("livelink", port=port, subject="Phone"))
    with closing(sender), all_the_time(lambda seconds: sender.send(seconds, take.result(next(frames)), neutral)):
        yield take

"""Messages from the server to the page, little-endian (viewer.md), and NATS' text protocol as far as a relay needs it:
one sender publishes, and viewers subscribe.

See https://docs.nats.io/reference/reference-protocols/nats-protocol.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..drive.driver import HeadFrame
from ..numeric.arrays import FloatArray
from .model import ViewerModel

FRAME, CLOCK = 1, 2
"""Kinds of messages."""
MAX_PAYLOAD = 32768
"""Largest size in bytes of a message, which holds the frames of more than fifty heads."""
_MAX_LINE = 8192
"""Largest size in bytes of a line; the greeting of a server takes about one kilobyte."""
_END = b"\r\n"
PING, PONG = b"PING\r\n", b"PONG\r\n"


CLOCK_REQUEST = struct.Struct("<d")
"""The only message that a page sends: its own time."""
_FRAME_HEADER = struct.Struct("<BBHId")
_CLOCK = struct.Struct("<B7xdd")
_STEP = 2.0**-14
"""Step of displacements, in outer-eye distances."""
_AMOUNT_STEP = 2.0**-13
"""Step of amounts."""


def encode_frame(
    scene: int,
    number: int,
    taken: float,
    models: Sequence[ViewerModel],
    frames: Sequence[HeadFrame],
    follow: tuple[bool, bool],
) -> bytes:
    """Encode a frame of all heads, with the number of their list modulo 65,536, and its own modulo 2^32.

    `taken` is `time.perf_counter()` when the frame arrived; `frames` is empty if there is no face; `follow` is whether
    heads follow the performer's rotation and translation.
    """
    parts = [_FRAME_HEADER.pack(FRAME, len(frames), scene & 0xFFFF, number & 0xFFFFFFFF, taken)]
    for model, frame in zip(models, frames, strict=False):
        moved = frame.displacements / model.unit if model.landmarks else np.empty(0)
        amounts = frame.keys
        if not len(amounts):
            amounts = np.concatenate([frame.actions[: model.amounts - len(frame.taught)], frame.taught])
        body = _pose(frame, follow) + _shorts(moved, _STEP) + _shorts(amounts, _AMOUNT_STEP)
        parts += [body, b"\0" * (-len(body) % 4)]
    return b"".join(parts)


def encode_clock(sent: float, now: float) -> bytes:
    """Encode the answer to a page that asked for the time: its own, and that of the server in seconds."""
    return _CLOCK.pack(CLOCK, sent, now)


def _pose(frame: HeadFrame, follow: tuple[bool, bool]) -> bytes:
    """Encode 16 float32: rotation vectors of head, jaw, right and left eye; translation; the tongue."""
    turned = frame.rotation if follow[0] else np.eye(3)
    moved = frame.translation if follow[1] else np.zeros(3)
    turns = [_vector(turn) for turn in (turned, frame.jaw, *frame.gaze)]
    return np.concatenate([*turns, moved, [frame.tongue]]).astype("<f4").tobytes()


def _vector(rotation: FloatArray) -> FloatArray:
    return np.array(cv2.Rodrigues(np.asarray(rotation, dtype=np.float64))[0], dtype=np.float64).ravel()


def _shorts(values: FloatArray, step: float) -> bytes:
    steps = np.clip(np.rint(np.ravel(values) / step), -32767, 32767)
    return bytes(steps.astype("<i2").tobytes())


class NatsError(Exception):
    """What arrived is not NATS' protocol, or the server has refused something."""


@dataclass(frozen=True)
class Operation:
    """One operation of the protocol.

    Attributes
    ----------
    verb : str
        Its name in capitals, such as MSG.
    arguments : str
        The rest of its line.
    payload : bytes
        The message, for MSG.
    """

    verb: str
    arguments: str = ""
    payload: bytes = b""


class NatsReader:
    """Splits what arrives, in portions of any size, into operations."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> list[Operation]:
        """Return the operations that are complete with more data; NatsError if they are something else."""
        self._data += data
        found, start = [], 0
        while (end := self._data.find(_END, start)) >= 0:
            verb, _, arguments = self._data[start:end].decode("latin-1").partition(" ")
            after, payload = end + len(_END), b""
            if verb.upper() == "MSG":
                size = _size(arguments)
                if len(self._data) < after + size + len(_END):
                    break
                payload, after = bytes(self._data[after : after + size]), after + size + len(_END)
            found.append(Operation(verb.upper(), arguments.strip(), payload))
            start = after
        del self._data[:start]
        if end < 0 and len(self._data) > _MAX_LINE:
            raise NatsError("it does not speak NATS' protocol")
        return found


def connecting(user: str, password: str) -> bytes:
    """Return the first operations of a client: its credentials, and a request to confirm them."""
    options = {
        "verbose": False,
        "pedantic": False,
        "user": user,
        "pass": password,
        "name": "facemime",
        "lang": "python",
    }
    return b"CONNECT " + json.dumps(options | {"version": "1", "protocol": 1, "echo": False}).encode() + _END + PING


def publishing(subject: str, payload: bytes) -> bytes:
    """Return the operation that publishes a message on a subject."""
    return f"PUB {subject} {len(payload)}\r\n".encode() + payload + _END


def subscribing(subject: str) -> bytes:
    """Return the operation that subscribes to a subject."""
    return f"SUB {subject} 1\r\n".encode()


def _size(arguments: str) -> int:
    """Return the number of bytes of a message from its line: subject, subscription, perhaps a reply, and size."""
    size = arguments.split()[-1:]
    if not size or not size[0].isdecimal() or len(size[0]) > 9 or int(size[0]) > MAX_PAYLOAD:
        raise NatsError("a message has an impossible size")
    return int(size[0])

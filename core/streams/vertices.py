"""The moved vertices of heads over TCP, for engines that deform nothing themselves (streams.md).

The receiver listens, and the sender tries to connect until it succeeds. A thread sends the newest frame whenever the
last one has been sent.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..drive.driver import HeadDriver, HeadFrame
from ..heads.appearance import Appearance
from ..heads.rig import HeadRig
from ..live.key_driver import KeyDriver
from ..numeric.arrays import FloatArray
from .links import LENGTH
from .transport.addresses import cannot_send, resolve
from .transport.background import Connecting

PORT = 21575
VERTICES = "vertices"
"""Name of the protocol."""
VERSION = 1
MESH, FRAME, FACE = 1, 2, 3
"""Kinds of messages."""
MESH_HEADER = struct.Struct("<BBHIIH")
"""Kind, version, number of the head, numbers of vertices and triangles, and size of the name in bytes."""
FRAME_HEADER = struct.Struct("<BBHId")
"""Kind, version, number of the head, number of vertices, and time in seconds."""
FACE_HEADER = struct.Struct("<BBHIIII")
"""Kind, version, number of the head, and first vertex and number of vertices of the right and of the left eyeball."""
MAX_NAME = 1000
"""Largest size of a head's name in bytes."""
TO_RECEIVER = np.array([1.0, -1.0, -1.0])
"""From the head frame to x right, y up, z towards the viewer."""
_AGAIN = 0.5
"""Seconds between attempts to connect."""
_PATIENCE = 3.0
"""Seconds after which a receiver that does not read is disconnected."""


def encode_mesh(number: int, appearance: Appearance, rest: NDArray[np.float32]) -> bytes:
    """Encode what is sent once per head: its name, its vertices at rest, and its triangles.

    Parameters
    ----------
    number : int
        Number of the head.
    appearance : Appearance
        Appearance of the head.
    rest : (A, 3) float32
        Vertices of the rig at rest, in the head frame.
    """
    patches = [patch.triangles()[0] for patch in appearance.all_patches(len(rest))]
    corners = np.concatenate([np.empty(0, dtype=np.int64), *patches]).astype("<u4")
    points = _points(rest, *(part.vertices for part in appearance.parts))
    name = appearance.name.encode()[:MAX_NAME]
    header = MESH_HEADER.pack(MESH, VERSION, number, len(points), len(corners) // 3, len(name))
    return _with_length(header + name + points.tobytes() + corners.tobytes())


def encode_face(number: int, appearance: Appearance, rig: HeadRig) -> bytes:
    """Encode which vertices are landmarks and eyeballs, for receivers that drive a face by them.

    Parameters
    ----------
    number : int
        Number of the head.
    appearance : Appearance
        Appearance of the head.
    """
    first, eyes = len(rig.all_vertices), {"eye_right": (0, 0), "eye_left": (0, 0)}
    for part in appearance.parts:
        if part.follows in eyes:
            eyes[part.follows] = first, len(part.vertices)
        first += len(part.vertices)
    header = FACE_HEADER.pack(FACE, VERSION, number, *eyes["eye_right"], *eyes["eye_left"])
    return _with_length(header + np.asarray(rig.landmarks).astype("<u4").tobytes())


def encode_frame(number: int, time: float, appearance: Appearance, frame: HeadFrame) -> bytes:
    """Encode a frame of a head.

    Parameters
    ----------
    number : int
        Number of the head.
    time : float
        Time in seconds; only differences matter.
    appearance : Appearance
        Appearance of the head.
    """
    parts = [part.posed(frame.jaw, frame.gaze, frame.tongue) for part in appearance.parts]
    points = _points(frame.vertices, *parts)
    turn = (TO_RECEIVER[:, None] * frame.rotation * TO_RECEIVER).astype("<f4")
    moved = (TO_RECEIVER * frame.translation).astype("<f4")
    header = FRAME_HEADER.pack(FRAME, VERSION, number, len(points), time)
    return _with_length(header + turn.tobytes() + moved.tobytes() + points.tobytes())


class VertexSender(Connecting):
    """Sends the moved vertices of all heads of a session.

    Parameters
    ----------
    host : str
        Name or address of the receiver.
    port : int
        Port; 0 for the usual one.
    appearances : sequence of Appearance
        Appearance of each head, in the order of the worker's heads.

    Raises
    ------
    SourceError
        If the host cannot be found.
    """

    def __init__(self, host: str, port: int, appearances: Sequence[Appearance]) -> None:
        super().__init__("facemime-vertices", _AGAIN)
        self.appearances = tuple(appearances)
        self._family, self._address = resolve(host, port or PORT)
        self._heads: list[HeadDriver] = []
        self._newest: tuple[float, Sequence[HeadFrame]] | None = None
        self._thread.start()

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Send a frame. See `Display.show`."""
        if not frames:
            return
        heads = [driver.head if isinstance(driver, KeyDriver) else driver for driver in drivers]
        with self._news:
            known = self._heads
            if len(heads) != len(known) or any(h.rest is not k.rest for h, k in zip(heads, known, strict=True)):
                self._heads = heads
            self._newest = taken, frames
            self._news.notify()

    def _connect(self) -> None:
        try:
            with socket.socket(self._family, socket.SOCK_STREAM) as connection:
                connection.settimeout(_PATIENCE)
                connection.connect(self._address)
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.message = ""
                self._feed(connection)
        except OSError as error:
            self.message = str(cannot_send(*self._address, error))

    def _feed(self, connection: socket.socket) -> None:
        """Send meshes whenever they have changed, and frames, until the connection or the sender ends."""
        known: list[HeadDriver] = []
        while True:
            with self._news:
                self._news.wait_for(lambda: self._over or self._newest is not None)
                if self._over:
                    return
                assert self._newest is not None
                (taken, frames), self._newest = self._newest, None
                heads = self._heads
            if heads is not known:
                for number, (appearance, head) in enumerate(zip(self.appearances, heads, strict=False)):
                    connection.sendall(encode_mesh(number, appearance, head.rest))
                    connection.sendall(encode_face(number, appearance, head.rig))
                known = heads
            for number, (appearance, frame) in enumerate(zip(self.appearances, frames, strict=False)):
                connection.sendall(encode_frame(number, taken, appearance, frame))
                self.sent += 1


def _points(*parts: NDArray[np.float32]) -> FloatArray:
    return np.asarray(np.concatenate(parts) * TO_RECEIVER.astype(np.float32), dtype="<f4")


def _with_length(message: bytes) -> bytes:
    return LENGTH.pack(len(message)) + message

"""The moved vertices of heads over TCP: sent to engines that deform nothing themselves, or received as faces
(streams.md).

The receiver listens, and the sender tries to connect until it succeeds. A thread sends the newest frame whenever the
last one has been sent.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..drive.driver import HeadDriver, HeadFrame
from ..errors import HeadError
from ..face.landmarks import N_LANDMARKS
from ..heads.appearance import Appearance
from ..heads.rig import HeadRig
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..puppet.outputs import KeyDriver
from ..takes.measured import FacePoints, PointTracker
from ..takes.neutral import Neutral
from .links import LENGTH
from .protocols.frames import MAX_SUBJECT, PacketError, StreamFrame, finite
from .transport.addresses import cannot_send, resolve
from .transport.background import Connecting

PORT = 21575
VERTICES = "vertices"
"""Name of the protocol."""
VERSION = 1
MESH, FRAME, FACE = 1, 2, 3
"""Kinds of messages."""
_MAX_HEADS = 16
_MAX_COORDINATE = 1e6
"""Largest coordinate, in any unit."""
_ROUND = 1e-3
"""Largest deviation of the product of a rotation with its transpose from the identity."""
_POSE = 12
"""Numbers of a pose: a rotation by rows, and a translation."""


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
    """Encode what is sent once per head: its name, its vertices (A, 3) at rest in the head frame, and its triangles."""
    patches = [patch.triangles()[0] for patch in appearance.all_patches(len(rest))]
    corners = np.concatenate([np.empty(0, dtype=np.int64), *patches]).astype("<u4")
    points = _points(rest, *(part.vertices for part in appearance.parts))
    name = appearance.name.encode()[:MAX_NAME]
    header = MESH_HEADER.pack(MESH, VERSION, number, len(points), len(corners) // 3, len(name))
    return _with_length(header + name + points.tobytes() + corners.tobytes())


def encode_face(number: int, appearance: Appearance, rig: HeadRig) -> bytes:
    """Encode which vertices are landmarks and eyeballs, for receivers that drive a face by them."""
    first, eyes = len(rig.all_vertices), {"eye_right": (0, 0), "eye_left": (0, 0)}
    for part in appearance.parts:
        if part.follows in eyes:
            eyes[part.follows] = first, len(part.vertices)
        first += len(part.vertices)
    header = FACE_HEADER.pack(FACE, VERSION, number, *eyes["eye_right"], *eyes["eye_left"])
    return _with_length(header + np.asarray(rig.landmarks).astype("<u4").tobytes())


def encode_frame(number: int, time: float, appearance: Appearance, frame: HeadFrame) -> bytes:
    """Encode a frame of a numbered head, with its time in seconds, of which only differences matter."""
    parts = [part.posed(frame.jaw, frame.gaze, frame.tongue) for part in appearance.parts]
    points = _points(frame.vertices, *parts)
    turn = (TO_RECEIVER[:, None] * frame.rotation * TO_RECEIVER).astype("<f4")
    moved = (TO_RECEIVER * frame.translation).astype("<f4")
    header = FRAME_HEADER.pack(FRAME, VERSION, number, len(points), time)
    return _with_length(header + turn.tobytes() + moved.tobytes() + points.tobytes())


class VertexSender(Connecting):
    """Sends the moved vertices of all heads of a session, in the order of the worker's heads.

    Port 0 is the usual one. Raises SourceError if the host cannot be found.
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


@dataclass
class _Head:
    """A head of the sender: its name, its vertices at rest, and its face as far as it is known."""

    name: str
    rest: FloatArray
    landmarks: IntArray | None = None
    eyes: tuple[slice, slice] = (slice(0), slice(0))
    tracker: PointTracker | None = None
    neutral: Neutral | None = None

    def points(self, vertices: FloatArray) -> FacePoints:
        """Return the places on the face for given vertices."""
        return FacePoints(vertices[self.landmarks], np.empty((0, 3)), (vertices[self.eyes[0]], vertices[self.eyes[1]]))


class VertexDecoder:
    """Decodes the messages of a sender of moved vertices. See `Decoder`."""

    def __init__(self) -> None:
        self._heads: dict[int, _Head] = {}

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a message without its length. Only messages of moved vertices contain a frame."""
        if len(data) < 4 or data[1] != VERSION:
            raise PacketError("not Facemime's, or of a different version")
        try:
            if data[0] == MESH:
                self._mesh(data)
            elif data[0] == FACE:
                self._face(data)
            elif data[0] == FRAME:
                return [self._frame(data)]
            else:
                raise PacketError("not a message")
        except (struct.error, UnicodeDecodeError) as error:
            raise PacketError("a message is truncated") from error
        return []

    def _mesh(self, data: bytes) -> None:
        _, _, number, count, triangles, length = MESH_HEADER.unpack_from(data)
        first = MESH_HEADER.size + length
        if length > MAX_NAME or len(data) != first + 12 * (count + triangles):
            raise PacketError("a mesh has another size")
        if number not in self._heads and len(self._heads) >= _MAX_HEADS:
            raise PacketError("too many heads")
        name = data[MESH_HEADER.size : first].decode()[:MAX_SUBJECT]
        self._heads[number] = _Head(name, _within(np.frombuffer(data, "<f4", 3 * count, first).reshape(-1, 3)))

    def _face(self, data: bytes) -> None:
        _, _, number, *eyes = FACE_HEADER.unpack_from(data)
        head = self._head(number)
        if len(data) != FACE_HEADER.size + 4 * N_LANDMARKS:
            raise PacketError("a face has another size")
        landmarks = np.frombuffer(data, "<u4", N_LANDMARKS, FACE_HEADER.size).astype(np.int64)
        right, left = (slice(first, first + count) for first, count in (eyes[:2], eyes[2:]))
        if max(landmarks.max(), right.stop - 1, left.stop - 1) >= len(head.rest):
            raise PacketError("a landmark or an eye is no vertex")
        head.landmarks, head.eyes = landmarks, (right, left)
        try:
            head.tracker = PointTracker(head.points(head.rest), np.zeros(3), np.empty(0))
        except HeadError as error:
            raise PacketError("a face has no size") from error
        head.neutral = head.tracker.at_rest()

    def _frame(self, data: bytes) -> StreamFrame:
        _, _, number, count, time = FRAME_HEADER.unpack_from(data)
        head = self._head(number)
        if count != len(head.rest) or len(data) != FRAME_HEADER.size + 4 * _POSE + 12 * count:
            raise PacketError("a frame has another size than its mesh")
        if head.tracker is None:
            raise PacketError("the landmarks of a mesh are not known")
        rotation, moved = _pose(data)
        # Only landmarks and eyes are read, as a mesh may be large.
        points = head.points(np.frombuffer(data, "<f4", 3 * count, FRAME_HEADER.size + 4 * _POSE).reshape(-1, 3))
        placed = FacePoints(
            _within(points.landmarks) @ rotation.T + moved,
            points.anchors,
            (_within(points.eyes[0]) @ rotation.T + moved, _within(points.eyes[1]) @ rotation.T + moved),
        )
        face = head.tracker.result(placed, rotation, moved)
        return StreamFrame(face, head.name, finite(time), neutral=head.neutral)

    def _head(self, number: int) -> _Head:
        if number not in self._heads:
            raise PacketError("there is no mesh of that number")
        return self._heads[number]


def _within(points: FloatArray) -> FloatArray:
    """Convert points of a message to the head frame; PacketError if they are impossible."""
    if not (np.abs(points) <= _MAX_COORDINATE).all():
        raise PacketError("a vertex is impossible")
    return np.asarray(points * TO_RECEIVER, dtype=np.float64)


def _pose(data: bytes) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3, 3) and translation (3,) of a frame, in the head frame."""
    stored = np.frombuffer(data, "<f4", _POSE, FRAME_HEADER.size)
    if not np.isfinite(stored).all():
        raise PacketError("a number is not finite")
    numbers = stored.astype(np.float64)
    turn = TO_RECEIVER[:, None] * numbers[:9].reshape(3, 3) * TO_RECEIVER
    if not (np.abs(turn @ turn.T - np.eye(3)) <= _ROUND).all() or linalg.det(turn) < 0.0:
        raise PacketError("the rotation is not valid")
    return turn, _within(numbers[None, 9:])[0]

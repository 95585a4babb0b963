"""Incoming moved vertices: the landmarks among them form a face, which drives any head (streams.md)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from ..errors import HeadError
from ..face.landmarks import N_LANDMARKS
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from ..takes.from_animation import FacePoints, PointTracker
from ..takes.neutral import Neutral
from .protocols.frames import MAX_SUBJECT, PacketError, StreamFrame, finite
from .vertices import FACE, FACE_HEADER, FRAME, FRAME_HEADER, MAX_NAME, MESH, MESH_HEADER, TO_RECEIVER, VERSION

_MAX_HEADS = 16
_MAX_COORDINATE = 1e6
"""Largest coordinate, in any unit."""
_ROUND = 1e-3
"""Largest deviation of the product of a rotation with its transpose from the identity."""
_POSE = 12
"""Numbers of a pose: a rotation by rows, and a translation."""


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
        self._heads[number] = _Head(name, _points(data, first, count))

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


def _points(data: bytes, first: int, count: int) -> FloatArray:
    return _within(np.frombuffer(data, "<f4", 3 * count, first).reshape(-1, 3))


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

"""Receive the moved vertices of Facemime's heads: `python receive_vertices.py [PORT] [HOST]`. Needs only numpy.

In your own program, iterate over `receive(connection)`: a `Mesh` for each head, then `Frame`s that move it.

SPDX-License-Identifier: GPL-3.0-or-later
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

PORT = 21575
MOST_BYTES = 256_000_000


@dataclass
class Mesh:
    """A head: its number, name, vertices at rest (V, 3), and triangles (T, 3), anticlockwise from outside."""

    head: int
    name: str
    rest: np.ndarray
    triangles: np.ndarray


@dataclass
class Frame:
    """A frame: the head's number, seconds, vertices (V, 3), and the pose (rotation (3, 3), translation (3,))."""

    head: int
    time: float
    vertices: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray


def receive(connection: socket.socket) -> Iterator[Mesh | Frame]:
    """Yield what a sender sends until it ends; ValueError if it is something else."""
    with connection.makefile("rb") as stream:
        while len(start := stream.read(4)) == 4:
            (length,) = struct.unpack("<I", start)
            if length > MOST_BYTES or len(data := stream.read(length)) < length:
                raise ValueError("a message is too long or cut")
            if (message := decode(data)) is not None:
                yield message


def decode(data: bytes) -> Mesh | Frame | None:
    """Decode a message without its length; None for kinds that are not needed here."""
    kind, version, head = struct.unpack_from("<BBH", data)
    if version != 1:
        raise ValueError("not Facemime's, or of another version")
    if kind not in (1, 2):
        return None
    if kind == 1:
        vertices, triangles, length = struct.unpack_from("<IIH", data, 4)
        start = 14 + length
        rest = np.frombuffer(data, "<f4", 3 * vertices, start).reshape(-1, 3)
        corners = np.frombuffer(data, "<u4", 3 * triangles, start + rest.nbytes).reshape(-1, 3)
        return Mesh(head, data[14:start].decode(), rest, corners)
    vertices, time = struct.unpack_from("<Id", data, 4)
    pose = np.frombuffer(data, "<f4", 12, 16)
    moved = np.frombuffer(data, "<f4", 3 * vertices, 64).reshape(-1, 3)
    return Frame(head, time, moved, pose[:9].reshape(3, 3), pose[9:])


def main() -> None:
    """Print what comes from one sender."""
    port = int(sys.argv[1]) if len(sys.argv) > 1 else PORT
    host = sys.argv[2] if len(sys.argv) > 2 else "127.0.0.1"
    rests: dict[int, np.ndarray] = {}
    with socket.create_server((host, port)) as listener:
        connection, address = listener.accept()
        with connection:
            for message in receive(connection):
                if isinstance(message, Mesh):
                    rests[message.head] = message.rest
                    print(f"{message.name}: {len(message.rest)} vertices from {address[0]}", flush=True)
                else:
                    moved = np.linalg.norm(message.vertices - rests[message.head], axis=1).max()
                    print(f"head {message.head}, {message.time:.3f} s: moved by up to {moved:.4f}", flush=True)


if __name__ == "__main__":
    main()

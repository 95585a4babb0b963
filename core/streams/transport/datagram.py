"""Facemime's own stream: one self-contained datagram per frame (streams.md).

A frame of landmarks takes 482 bytes and a signature: 122 to 126 kbit/s at 30 frames per second, including all headers.
It does not depend on the tracker's model. All numbers are big-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...face.actions import N_ACTIONS
from ...face.apertures import eye_apertures, mouth_aperture
from ...face.coefficient_names import N_COEFFICIENTS
from ...face.landmarks import N_LANDMARKS
from ...numeric.arrays import FloatArray
from ...takes.from_coefficients import coefficient_face
from ...tracking.result import TrackResult, project_shape
from ..protocols.frames import PacketError, StreamFrame
from .security import NONCE_BYTES, SESSION_BYTES, TAG_BYTES

PORT = 21573
VERSION = 1
LOST, LANDMARKS, COEFFICIENTS, HELLO, WELCOME = 0, 1, 2, 16, 17
"""Kinds of packets: no face, a face, a face as coefficients, and the two of the handshake."""
HEADER = struct.Struct(f">4sBBH{SESSION_BYTES}sQd")
_MAGIC = b"FMIM"
_SIGNED = 1
_STEP = 2.0**-13
"""Step of landmarks, in outer-eye distances, and of angles of the eyes, in radians."""
_UNKNOWN = -(2**15)
_POSE = struct.Struct(">6f")
_BODIES = {
    LOST: 0,
    LANDMARKS: _POSE.size + 2 * (3 * N_LANDMARKS + 3 + 3 + 1) + N_ACTIONS + 1,
    COEFFICIENTS: _POSE.size + 2 * N_COEFFICIENTS,
    HELLO: NONCE_BYTES,
    WELCOME: 2 * NONCE_BYTES,
}
_MAX_TIME = 1e12
"""Largest time of a packet in seconds."""
_MAX_PIXEL = 1e6
"""Largest coordinate of a face in pixels."""
_MAX_SCALE = 1e5
"""Largest scale of a face, in pixels per outer-eye distance."""
_MAX_ANGLE = 7.0
"""Largest angle of a head in radians."""
_ACTION_STEP = 1.0 / 128.0
_UNKNOWN_ACTION = 255


@dataclass(frozen=True)
class Packet:
    """A packet whose content has not been parsed.

    Attributes
    ----------
    kind : int
        `LOST` to `WELCOME`.
    session : bytes
        Session of the sender, 8 random bytes per start.
    sequence : int
        Number of the packet in the session.
    time : float
        Time of the media in seconds.
    body : bytes
        The content.
    signed : bytes
        The part that is signed: all but the signature.
    tag : bytes
        The signature; empty in unsigned packets.
    """

    kind: int
    session: bytes
    sequence: int
    time: float
    body: bytes
    signed: bytes = b""
    tag: bytes = b""


def pack(packet: Packet, *, signed: bool) -> bytes:
    """Serialise a packet without its signature."""
    fields = (packet.kind, int(signed), packet.session, packet.sequence, packet.time)
    return HEADER.pack(_MAGIC, VERSION, *fields) + packet.body


def unpack(data: bytes) -> Packet:
    """Parse a packet; PacketError if it is not one of this version."""
    if len(data) < HEADER.size:
        raise PacketError("not Facemime's")
    magic, version, kind, flags, session, sequence, time = HEADER.unpack_from(data)
    if magic != _MAGIC or version != VERSION or flags & ~_SIGNED or kind not in _BODIES:
        raise PacketError("not Facemime's, or of a different version")
    end = HEADER.size + _BODIES[kind]
    if len(data) != end + (TAG_BYTES if flags else 0) or not 0.0 <= time <= _MAX_TIME:
        raise PacketError("a packet is truncated")
    return Packet(kind, session, sequence, time, data[HEADER.size : end], data[:end], data[end:])


def encode_face(result: TrackResult) -> tuple[int, bytes]:
    """Encode a tracking result as the kind of its packet and the body."""
    if not result.found:
        return LOST, b""
    pose = _POSE.pack(*result.pose)
    if np.isfinite(result.coefficients).all():
        steps = np.rint(np.clip(result.coefficients, 0.0, 1.0) * 65535.0)
        return COEFFICIENTS, pose + steps.astype(">u2").tobytes()
    openings = [*eye_apertures(result.shape), mouth_aperture(result.shape)]
    numbers = [*result.shape.ravel(), *openings, *result.gaze, result.vergence, float(np.clip(result.confidence, 0, 1))]
    actions = np.rint(np.clip(result.actions, 0.0, 1.98) / _ACTION_STEP)
    return LANDMARKS, b"".join(
        (
            pose,
            _shorts(np.array(numbers)),
            np.nan_to_num(actions, nan=_UNKNOWN_ACTION).astype(np.uint8).tobytes(),
            b"\0",
        )
    )


def decode_face(packet: Packet) -> StreamFrame:
    """Decode a packet of a face; PacketError if a number in it is impossible, or the packet is of another kind.

    The result has no shape parameters, and its landmarks are projected.
    """
    frame = StreamFrame(None, packet.session.hex(), packet.time, packet.sequence)
    if packet.kind == LOST:
        return frame
    if packet.kind not in (LANDMARKS, COEFFICIENTS):
        raise PacketError("not a face")
    pose = np.array(_POSE.unpack_from(packet.body))
    bounds = (_MAX_SCALE, *[_MAX_ANGLE] * 3, *[_MAX_PIXEL] * 2)
    if not (np.abs(pose) <= bounds).all() or not pose[0] > 0.0:
        raise PacketError("a pose is impossible")
    rest = packet.body[_POSE.size :]
    if packet.kind == COEFFICIENTS:
        return replace(frame, face=coefficient_face().posed(np.frombuffer(rest, ">u2") / 65535.0, pose))
    return replace(frame, face=_landmarks(rest, pose))


def _landmarks(body: bytes, pose: FloatArray) -> TrackResult:
    count = 3 * N_LANDMARKS + 3 + 3 + 1
    steps = np.frombuffer(body, ">i2", count).astype(np.float64)
    values = np.where(steps == _UNKNOWN, np.nan, steps * _STEP)
    shape, _, gaze, vergence, confidence = np.split(values, np.cumsum([3 * N_LANDMARKS, 3, 2, 1]))
    if not np.isfinite(shape).all() or not 0.0 <= confidence[0] <= 1.0:
        raise PacketError("a landmark is missing")
    shape = shape.reshape(-1, 3)
    actions: NDArray[np.float64] = np.frombuffer(body, np.uint8, N_ACTIONS, 2 * count).astype(np.float64)
    return TrackResult(
        found=True,
        landmarks=project_shape(shape, pose),
        pose=pose,
        shape_params=np.empty(0),
        shape=shape,
        confidence=float(confidence[0]),
        gaze=gaze,
        vergence=float(vergence[0]),
        actions=np.where(actions == _UNKNOWN_ACTION, np.nan, actions * _ACTION_STEP),
    )


def _shorts(values: FloatArray) -> bytes:
    """Encode numbers as 16-bit multiples of the step, with -32768 for unknown ones."""
    steps = np.clip(np.rint(values / _STEP), _UNKNOWN + 1, -_UNKNOWN - 1)
    return np.where(np.isfinite(values), steps, _UNKNOWN).astype(">i2").tobytes()

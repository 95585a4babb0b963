"""Facemime's own stream (streams.md): one self-contained datagram per frame, and the sessions in which they are
accepted.

A frame of landmarks takes 482 bytes and a signature: 122 to 126 kbit/s at 30 frames per second, including all
headers. It does not depend on the tracker's model. All numbers are big-endian.
"""

from __future__ import annotations

import secrets
import struct
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ...face.landmarks import N_LANDMARKS, eye_apertures, mouth_aperture
from ...face.names import N_ACTIONS, N_COEFFICIENTS
from ...numeric.arrays import FloatArray
from ...takes.measured import coefficient_face
from ...tracking.result import TrackResult, project_shape
from ..protocols.frames import PacketError, StreamFrame
from .security import NONCE_BYTES, SESSION_BYTES, TAG_BYTES, ReplayWindow, is_signed, session_key, sign

PORT = 21573
VERSION = 1
LOST, LANDMARKS, COEFFICIENTS, HELLO, WELCOME = 0, 1, 2, 16, 17
"""Kinds of packets: no face, a face, a face as coefficients, and the two of the handshake."""
_MAX_SESSIONS = 16
"""Largest number of sessions."""
_SILENT = 3.0
"""Seconds without a packet after which a session may be replaced."""
_MAX_ANSWERS = 20.0
"""Largest number of answers to handshakes per second."""


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
    shares = np.array([*result.actions, result.teeth])
    shares = np.rint(np.clip(shares, 0.0, 1.98) / _ACTION_STEP)
    return LANDMARKS, b"".join(
        (
            pose,
            _shorts(np.array(numbers)),
            np.nan_to_num(shares, nan=_UNKNOWN_ACTION).astype(np.uint8).tobytes(),
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
    shares: NDArray[np.float64] = np.frombuffer(body, np.uint8, N_ACTIONS + 1, 2 * count).astype(np.float64)
    shares = np.where(shares == _UNKNOWN_ACTION, np.nan, shares * _ACTION_STEP)
    return TrackResult(
        found=True,
        landmarks=project_shape(shape, pose),
        pose=pose,
        shape_params=np.empty(0),
        shape=shape,
        confidence=float(confidence[0]),
        gaze=gaze,
        vergence=float(vergence[0]),
        actions=shares[:N_ACTIONS],
        teeth=float(np.minimum(shares[N_ACTIONS], 1.0)),
    )


def _shorts(values: FloatArray) -> bytes:
    """Encode numbers as 16-bit multiples of the step, with -32768 for unknown ones."""
    steps = np.clip(np.rint(values / _STEP), _UNKNOWN + 1, -_UNKNOWN - 1)
    return np.where(np.isfinite(values), steps, _UNKNOWN).astype(">i2").tobytes()


class Refusal(Enum):
    """Why a well-formed packet is not accepted."""

    NO_KEY_HERE = "it is signed, but there is no key"
    NO_KEY_THERE = "it is not signed"
    OTHER_KEY = "it is signed with another key"
    NO_SESSION = "it is of no session"
    REPLAYED = "it came before"
    NOT_THE_PHONE = "it is not the phone's"
    TOO_MANY = "there are too many senders"


class RefusedError(PacketError):
    """A packet is well formed, but not accepted."""

    def __init__(self, reason: Refusal) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass
class _Session:
    key: bytes | None
    heard: float
    window: ReplayWindow = field(default_factory=ReplayWindow)
    pending: bytes | None = None
    proved: bool = False


class OwnReceiver:
    """Accepts packets of Facemime's own stream, signed with the shared key, or unsigned without one."""

    def __init__(self, key: bytes | None) -> None:
        self._key = key
        self._sessions: dict[bytes, _Session] = {}
        self._answers, self._answered = _MAX_ANSWERS, 0.0

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Receive a datagram. See `Receiver.receive`; also RefusedError if it is not signed, or came before."""
        packet = unpack(data)
        if packet.kind == HELLO:
            return [], self._welcome(packet, now)
        if packet.kind == WELCOME:
            raise PacketError("an answer")
        session = self._session(packet, now)
        frame = decode_face(packet)
        if not session.window.accept(packet.sequence):
            raise RefusedError(Refusal.REPLAYED)
        session.heard, session.proved = now, True
        return [frame], []

    def _session(self, packet: Packet, now: float) -> _Session:
        """Return the session of a packet that is correctly signed."""
        session = self._sessions.get(packet.session)
        if self._key is None:
            if packet.tag:
                raise RefusedError(Refusal.NO_KEY_HERE)
            return session or self._add(packet.session, _Session(None, now))
        if session is None or not packet.tag:
            raise RefusedError(Refusal.NO_SESSION if packet.tag else Refusal.NO_KEY_THERE)
        # A handshake that may have been replayed changes nothing until a packet proves that it was not.
        for key in (session.key, session.pending):
            if key is not None and is_signed(key, packet.tag, packet.signed):
                if key is not session.key:
                    session.key, session.pending, session.window = key, None, ReplayWindow()
                return session
        raise RefusedError(Refusal.OTHER_KEY)

    def _welcome(self, packet: Packet, now: float) -> list[bytes]:
        if self._key is None:
            raise RefusedError(Refusal.NO_KEY_HERE)
        if not is_signed(self._key, packet.tag, packet.signed):
            raise RefusedError(Refusal.OTHER_KEY)
        session = self._sessions.get(packet.session)
        if session is not None and session.key is not None and now - session.heard < _SILENT:
            return []
        if not self._may_answer(now):
            return []
        answered = secrets.token_bytes(NONCE_BYTES)
        if session is None:
            session = self._add(packet.session, _Session(None, now))
        session.pending = session_key(self._key, packet.session, packet.body, answered)
        welcome = Packet(WELCOME, packet.session, packet.sequence, 0.0, packet.body + answered)
        content = pack(welcome, signed=True)
        return [content + sign(self._key, content)]

    def _may_answer(self, now: float) -> bool:
        self._answers = min(_MAX_ANSWERS, self._answers + _MAX_ANSWERS * max(now - self._answered, 0.0))
        self._answered = now
        if self._answers < 1.0:
            return False
        self._answers -= 1.0
        return True

    def _add(self, name: bytes, session: _Session) -> _Session:
        if len(self._sessions) >= _MAX_SESSIONS:
            # Sessions without any packet after the handshake, which may have been replayed, are replaced first.
            oldest = min(self._sessions, key=lambda n: (self._sessions[n].proved, self._sessions[n].heard))
            known = self._sessions[oldest]
            if known.proved and session.heard - known.heard < _SILENT:
                raise RefusedError(Refusal.TOO_MANY)
            del self._sessions[oldest]
        self._sessions[name] = session
        return session


class OwnSender:
    """Numbers and signs the packets of Facemime's own stream; without a key there is no signature or handshake."""

    def __init__(self, key: bytes | None) -> None:
        self._key = key
        self._session = secrets.token_bytes(SESSION_BYTES)
        self._sequence = 0
        self._nonce = b""
        self._signing: bytes | None = None

    @property
    def ready(self) -> bool:
        """Whether packets can be sent: immediately without a key, otherwise after the handshake."""
        return self._key is None or self._signing is not None

    def hello(self) -> bytes:
        """Return a handshake, or a check that the receiver still knows the session; b"" without a key."""
        if self._key is None:
            return b""
        self._nonce = secrets.token_bytes(NONCE_BYTES)
        content = pack(Packet(HELLO, self._session, 0, 0.0, self._nonce), signed=True)
        return content + sign(self._key, content)

    def answer(self, data: bytes) -> None:
        """Process the receiver's answer; PacketError if it does not answer the last handshake."""
        packet = unpack(data)
        sent, answered = packet.body[:NONCE_BYTES], packet.body[NONCE_BYTES:]
        expected = packet.kind == WELCOME and packet.session == self._session and sent == self._nonce
        if self._key is None or not expected or not is_signed(self._key, packet.tag, packet.signed):
            raise RefusedError(Refusal.OTHER_KEY)
        self._signing = session_key(self._key, self._session, sent, answered)

    def packet(self, kind: int, body: bytes, time: float) -> bytes:
        """Make a datagram from a kind and a body of `encode_face`; the media time is in seconds, at least 0."""
        self._sequence += 1
        content = pack(Packet(kind, self._session, self._sequence, time, body), signed=self._key is not None)
        return content if self._signing is None else content + sign(self._signing, content)

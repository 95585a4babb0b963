"""Sessions of Facemime's own stream: the handshake on both sides, and which packets the receiver accepts."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from enum import Enum

from ..protocols.frames import PacketError, StreamFrame
from . import datagram
from .datagram import HELLO, WELCOME, Packet
from .security import NONCE_BYTES, SESSION_BYTES, ReplayWindow, is_signed, session_key, sign

_MAX_SESSIONS = 16
"""Largest number of sessions."""
_SILENT = 3.0
"""Seconds without a packet after which a session may be replaced."""
_MAX_ANSWERS = 20.0
"""Largest number of answers to handshakes per second."""


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
    """Accepts packets of Facemime's own stream.

    Parameters
    ----------
    key : bytes or None
        The shared key; None for unsigned packets.
    """

    def __init__(self, key: bytes | None) -> None:
        self._key = key
        self._sessions: dict[bytes, _Session] = {}
        self._answers, self._answered = _MAX_ANSWERS, 0.0

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Receive a datagram. See `Receiver.receive`; also RefusedError if it is not signed, or came before."""
        packet = datagram.unpack(data)
        if packet.kind == HELLO:
            return [], self._welcome(packet, now)
        if packet.kind == WELCOME:
            raise PacketError("an answer")
        session = self._session(packet, now)
        frame = datagram.decode_face(packet)
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
        content = datagram.pack(welcome, signed=True)
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
    """Numbers and signs the packets of Facemime's own stream.

    Parameters
    ----------
    key : bytes or None
        The shared key; None for unsigned packets without a handshake.
    """

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
        content = datagram.pack(Packet(HELLO, self._session, 0, 0.0, self._nonce), signed=True)
        return content + sign(self._key, content)

    def answer(self, data: bytes) -> None:
        """Process the receiver's answer; PacketError if it does not answer the last handshake."""
        packet = datagram.unpack(data)
        sent, answered = packet.body[:NONCE_BYTES], packet.body[NONCE_BYTES:]
        expected = packet.kind == WELCOME and packet.session == self._session and sent == self._nonce
        if self._key is None or not expected or not is_signed(self._key, packet.tag, packet.signed):
            raise RefusedError(Refusal.OTHER_KEY)
        self._signing = session_key(self._key, self._session, sent, answered)

    def packet(self, kind: int, body: bytes, time: float) -> bytes:
        """Make a datagram.

        Parameters
        ----------
        kind : int
            Kind of the packet, from `datagram.encode_face`.
        body : bytes
            Content, from `datagram.encode_face`.
        time : float
            Time of the media in seconds, at least 0.
        """
        self._sequence += 1
        content = datagram.pack(Packet(kind, self._session, self._sequence, time, body), signed=self._key is not None)
        return content if self._signing is None else content + sign(self._signing, content)

"""Face Motion version 3, the binary protocol of iFacialMocap and Facemotion3d (streams.md).

The receiver sends HELLO. The phone answers with SCHEMA, which names the values, and sends a FRAME for each moment once
SCHEMA_ACK has confirmed the schema. A phone whose user enters the address of this computer starts with SCHEMA. PING
tells a phone that the receiver still listens. Over TCP, the same messages are sent whole and without SCHEMA_ACK.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from math import ceil
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import messages
from ...face.names import column_of
from ...files.reading import parse_json
from .frames import FaceValues, PacketError, StreamFrame, no_coefficients
from .ifacialmocap import phone_face

MAGIC = b"FMV3"
PHONE_PORT = 49983
"""Port on which both apps listen for datagrams."""
TCP_PORT = 49984
"""Port on which both apps listen for connections, and a receiver for those started by hand."""
HELLO, SCHEMA, SCHEMA_ACK, FRAME, GET_SCHEMA, PING, PONG, STOP, ERROR = range(1, 10)
REVISION = 5
HEADER = Struct("<4sBBHQIIIIHHI")
"""Magic, kind, flags, size of the header, session, schema, sequence, token, length of the payload, index of the part,
number of parts, and length of this part's payload."""
HELLO_PAYLOAD = Struct("<HHI")
"""Largest number of frames per second, largest datagram, revision."""
START = Struct("<QHHII")
"""Start of a schema: nonce of HELLO, frames per second, largest datagram, lease in milliseconds, revision."""
POSE = Struct("<12f")
"""Rotation and position of the head, and rotation of the right and the left eye, in degrees and metres."""
SCHEMA_DATAGRAM = 576
_TRACKED = 1
"""Flag of a frame that shows a face."""
_FLAGS = 3
"""All flags that a frame may have."""
_RATES = (1, 60)
"""Smallest and largest number of frames per second."""
_DATAGRAMS = (SCHEMA_DATAGRAM, 1200)
"""Smallest and largest limit on the size of a datagram in bytes."""
_LEASES = (5_000, 60_000)
"""Shortest and longest lease in milliseconds."""
_MAX_SCHEMA = 262_144
"""Largest size of a schema in bytes."""
_MAX_NAMES = 4096
"""Largest number of names in a schema."""
_MAX_NAME = 255
"""Largest number of characters in a name."""
_MAX_PARTS = 512
"""Largest number of parts of a message."""
_MAX_ERROR = 512
"""Largest size of an error in bytes."""
MAX_MESSAGE = HEADER.size + _MAX_SCHEMA
"""Largest size of a message in bytes."""
_ENCODINGS: dict[str, np.dtype[Any]] = {"i16": np.dtype("<i2"), "i32": np.dtype("<i4")}
STATED = {
    "schema_version": 1,
    "blend_unit": "percent",
    "pose_layout": "head_rxyz_pxyz_rightEye_rxyz_leftEye_rxyz",
    "rotation_unit": "degree",
    "position_unit": "meter",
}
_PING = 3.0
"""Seconds between two pings."""
_REPAIR = 3.0
"""Seconds without a frame after which the schema is requested and another session may begin."""
_AGAIN = 1.0
"""Seconds between two such requests."""
_REPAIRED = 6.5
"""Seconds without a frame after which these requests end."""
_OVER = 12.0
"""Seconds without a frame after which the session has ended."""
REFUSALS = messages(
    {
        "BUSY": "The phone is sending to another program. Stop that first.",
        "NOT_ALLOWED": "The app is not allowed to send: its trial has ended, or it was not purchased.",
        "PC_CONNECTION_DISABLED": "The app refuses connections from computers. Allow them in its settings.",
        "V3_NOT_AVAILABLE": "The app is not on its tracking screen. Open it on the phone.",
        "APP_INACTIVE": "The app is not on its tracking screen. Open it on the phone.",
        "CAMERA_UNAVAILABLE": "The app cannot use the camera of the phone.",
        "": "The app on the phone refuses to send.",
    }
)
"""Messages for the words by which an app refuses; the last one is for all other words."""


@dataclass(frozen=True)
class _Part:
    """A datagram, which contains a whole message or a part of one."""

    kind: int
    flags: int
    session: int
    schema: int
    sequence: int
    total: int
    part: int
    parts: int
    payload: bytes


@dataclass
class _Parts:
    """The parts of a message that have arrived."""

    like: tuple[int, ...] = ()
    payloads: dict[int, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class _Schema:
    """Layout of the frames of a session: for each value, the column of its coefficient, or -1."""

    number: int
    payload: bytes
    columns: NDArray[np.intp]
    encoding: np.dtype[Any]
    largest: int


class FaceMotionReceiver:
    """The receiver's side of the protocol: parses the phone's packets and makes those for the phone.

    `connected` is whether the phone is connected over TCP; `message` says why it refuses to send, otherwise "".
    """

    def __init__(self, *, connected: bool = False) -> None:
        self.message = ""
        self._connected = connected
        self._nonce = _number()
        self._session = 0
        self._schema: _Schema | None = None
        self._sequence: int | None = None
        self._parts = {SCHEMA: _Parts(), FRAME: _Parts()}
        self._moving = self._pinged = self._repaired = self._acknowledged = -np.inf
        self._pings = 0

    def hello(self) -> bytes:
        """Return the packet that asks the phone to send; it is the same one until the phone does."""
        payload = HELLO_PAYLOAD.pack(_RATES[1], _DATAGRAMS[1], REVISION)
        return message(HELLO, self._nonce, payload)[0]

    def active(self, now: float) -> bool:
        """Return whether the phone sends, or did so a moment before `now`, in seconds on any clock."""
        return self._schema is not None and now - self._moving < _OVER

    def due(self, now: float) -> list[bytes]:
        """Return the packets that the phone needs now, in seconds on any clock, in order to continue sending."""
        if self._schema is None or not self.active(now):
            return []
        packets = []
        if now - self._pinged >= _PING:
            self._pinged, self._pings = now, self._pings + 1
            packets += message(PING, self._session, sequence=self._pings)
        if _REPAIR <= now - self._moving < _REPAIRED and now - self._repaired >= _AGAIN:
            self._repaired = now
            packets += self._acknowledgement(self._schema.number)
            packets += message(GET_SCHEMA, self._session)
        return packets

    def end(self) -> None:
        """Forget the session, as its connection has ended."""
        self._schema = None

    def stop(self) -> list[bytes]:
        """Return the packet that ends the session, if there is one."""
        return message(STOP, self._session) if self._schema is not None else []

    def receive(self, data: bytes, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        """Receive a packet from the phone. See `Receiver.receive`."""
        part = _read(data)
        if part.kind == SCHEMA:
            return [], self._take_schema(part, now)
        if part.kind == ERROR and part.session == self._nonce and not self.active(now):
            self.message = REFUSALS.get(part.payload.decode("ascii", "replace"), REFUSALS[""])
            return [], []
        if part.session != self._session or self._schema is None:
            raise PacketError("of no session")
        if part.kind == FRAME:
            return self._take_frame(self._schema, part, now)
        if part.kind == ERROR:
            self._schema = None
        return [], []

    def _take_schema(self, part: _Part, now: float) -> list[bytes]:
        if part.session != self._session and self._schema is not None and now - self._moving < _REPAIR:
            raise PacketError("of another session")
        if (payload := self._whole(part, SCHEMA_DATAGRAM)) is None:
            return []
        known = self._schema if part.session == self._session else None
        if known is not None and known.number == part.schema:
            if known.payload != payload:
                raise PacketError("a schema changes")
            if now - self._acknowledged < _AGAIN:
                return []
        else:
            schema = _read_schema(part.schema, payload, self._nonce if known is None else None)
            if known is None:
                self._session, self._sequence, self._nonce = part.session, None, _number()
                self._pinged = now
            self._schema, self._moving, self.message = schema, now, ""
        self._acknowledged = now
        return self._acknowledgement(part.schema)

    def _take_frame(self, schema: _Schema, part: _Part, now: float) -> tuple[list[StreamFrame], list[bytes]]:
        if part.schema != schema.number:
            if part.schema < schema.number or now - self._repaired < _AGAIN:
                return [], []
            self._repaired = now
            return [], message(GET_SCHEMA, self._session)
        if (payload := self._whole(part, schema.largest)) is None:
            return [], []
        ahead = 1 if self._sequence is None else (part.sequence - self._sequence) % 2**32
        if not 0 < ahead < 2**31:
            return [], []
        face = _read_frame(schema, payload)
        self._sequence, self._moving = part.sequence, now
        return [StreamFrame(face if part.flags & _TRACKED else None, sequence=part.sequence)], []

    def _whole(self, part: _Part, largest: int) -> bytes | None:
        """Return the payload once all its parts have come; of incomplete messages the newest is kept."""
        capacity = max(part.total, 1) if self._connected else largest - HEADER.size
        begin = part.part * capacity
        if part.parts != max(1, ceil(part.total / capacity)) or len(part.payload) != min(capacity, part.total - begin):
            raise PacketError("a message is divided wrongly")
        if part.parts == 1:
            return part.payload
        like = (part.session, part.schema, part.sequence, part.total, part.flags)
        if self._parts[part.kind].like != like:
            self._parts[part.kind] = _Parts(like)
        payloads = self._parts[part.kind].payloads
        payloads[part.part] = part.payload
        if len(payloads) < part.parts:
            return None
        self._parts[part.kind] = _Parts()
        return b"".join(payloads[number] for number in range(part.parts))

    def _acknowledgement(self, schema: int) -> list[bytes]:
        return [] if self._connected else message(SCHEMA_ACK, self._session, schema=schema)


def length_of(data: bytes) -> int | None:
    """Return the number of bytes of a whole message over TCP from its header; None if more of the header is needed.

    Raises ConnectionError if it is no such message.
    """
    if len(data) < HEADER.size:
        return None
    magic, _, _, size, *_, length = HEADER.unpack(data)
    if magic != MAGIC or size != HEADER.size or length > _MAX_SCHEMA:
        raise ConnectionError("not a message of the phone")
    return int(size + length)


def message(
    kind: int,
    session: int,
    payload: bytes = b"",
    *,
    schema: int = 0,
    sequence: int = 0,
    flags: int = 0,
    largest: int = _DATAGRAMS[1],
) -> list[bytes]:
    """Encode a message of a kind from HELLO to ERROR as datagrams of at most `largest` bytes.

    `session` is its number; in HELLO and its refusal, the nonce.
    """
    capacity = largest - HEADER.size
    pieces = [payload[begin : begin + capacity] for begin in range(0, max(len(payload), 1), capacity)]
    stated = (MAGIC, kind, flags, HEADER.size, session, schema, sequence, 0, len(payload))
    return [HEADER.pack(*stated, number, len(pieces), len(piece)) + piece for number, piece in enumerate(pieces)]


def _number() -> int:
    return secrets.randbits(64) or 1


def _read(data: bytes) -> _Part:
    """Parse the header of a packet from the phone."""
    if len(data) < HEADER.size:
        raise PacketError("too short")
    magic, kind, flags, size, session, schema, sequence, token, total, part, parts, length = HEADER.unpack_from(data)
    payload = data[HEADER.size :]
    if magic != MAGIC or size != HEADER.size or kind not in (SCHEMA, FRAME, PONG, ERROR) or session == 0:
        raise PacketError("not a packet of the phone")
    if len(payload) != length or length > total or not part < parts <= _MAX_PARTS:
        raise PacketError("a wrong length")
    if kind == FRAME:
        possible = flags <= _FLAGS and schema > 0
    elif kind == SCHEMA:
        possible = not (flags or token or sequence) and schema > 0 and START.size < total <= _MAX_SCHEMA
    else:
        possible = not (flags or token or schema) and parts == 1 and total <= (_MAX_ERROR if kind == ERROR else 0)
    if not possible:
        raise PacketError("a wrong header")
    return _Part(kind, flags, session, schema, sequence, total, part, parts, payload)


def _read_schema(number: int, payload: bytes, nonce: int | None) -> _Schema:
    """Parse a schema; that of a new session has to answer `nonce`, or no request at all."""
    answered, rate, largest, lease, revision = START.unpack_from(payload)
    for value, (low, high) in ((rate, _RATES), (largest, _DATAGRAMS), (lease, _LEASES)):
        if not low <= value <= high:
            raise PacketError("a session is impossible")
    if revision != REVISION or (nonce is not None and answered not in (0, nonce)):
        raise PacketError("an answer to somebody else, or of another revision")
    try:
        stated = parse_json(payload[START.size :])
    except ValueError as error:
        raise PacketError("a schema is not JSON") from error
    if not isinstance(stated, dict) or any(stated.get(key) != value for key, value in STATED.items()):
        raise PacketError("a schema of another kind")
    names, encoding = stated.get("blend_names"), str(stated.get("blend_encoding"))
    if not isinstance(names, list) or len(names) > _MAX_NAMES or encoding not in _ENCODINGS:
        raise PacketError("a schema without names")
    if not all(isinstance(name, str) and 0 < len(name) <= _MAX_NAME for name in names) or len(set(names)) < len(names):
        raise PacketError("a schema with wrong names")
    columns = np.array([-1 if (column := column_of(name)) is None else column for name in names], dtype=np.intp)
    return _Schema(number, payload, columns, _ENCODINGS[encoding], largest)


def _read_frame(schema: _Schema, payload: bytes) -> FaceValues:
    length = len(schema.columns) * schema.encoding.itemsize
    if len(payload) != length + POSE.size:
        raise PacketError("a frame of another schema")
    values = np.frombuffer(payload, schema.encoding, len(schema.columns))
    coefficients, known = no_coefficients(), schema.columns >= 0
    coefficients[schema.columns[known]] = 0.01 * values[known]
    return phone_face(coefficients, POSE.unpack_from(payload, length)[:6])

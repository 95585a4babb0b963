"""Packets of Face Motion 3, written from its specification, and a check of what they play."""

from __future__ import annotations

import json
import struct

import numpy as np

from facemime.core.face.names import COEFFICIENTS
from facemime.core.streams.source import StreamSource
from tests.helpers.links import collected

# Written from the specification, revision 5: offsets and types of the header are its table in section 3.2.
HEADER = "<4sBBHQIIIIHHI"
NONCE, SESSION = 0x8877665544332211, 0x0102030405060708
HELLO_HEX = "464d56330100280011223344556677880000000000000000000000000800000000000100080000003c00b00405000000"
ACK_HEX = "464d5633030028000807060504030201010000000000000000000000000000000000010000000000"
STATED = {
    "schema_version": 1,
    "app": "iFacialMocap",
    "profile": "ifacialmocap-stream",
    "blend_names": [*COEFFICIENTS, "独自の笑顔"],
    "blend_encoding": "i16",
    "blend_unit": "percent",
    "pose_layout": "head_rxyz_pxyz_rightEye_rxyz_leftEye_rxyz",
    "rotation_unit": "degree",
    "position_unit": "meter",
    "something_new": [1, 2],
}
POSE = (-21.5, -6.0, -6.6, -0.03, -0.1, -0.66, 6.0, 2.4, 0.25, 6.0, -1.6, -0.17)


VALUES = [*range(0, 52), 100]


def datagrams(kind, payload=b"", *, session=SESSION, schema=0, sequence=0, flags=0, largest=1200) -> list[bytes]:
    room = largest - 40
    pieces = [payload[at : at + room] for at in range(0, max(len(payload), 1), room)]
    fixed = (b"FMV3", kind, flags, 40, session, schema, sequence, 0, len(payload))
    return [struct.pack(HEADER, *fixed, i, len(pieces), len(p)) + p for i, p in enumerate(pieces)]


def schema(nonce, number=1, *, session=SESSION, start=(60, 1200, 10_000, 5), **stated) -> list[bytes]:
    return datagrams(2, schema_payload(nonce, start, **stated), session=session, schema=number, largest=576)


def schema_payload(nonce, start=(60, 1200, 10_000, 5), **stated) -> bytes:
    return struct.pack("<QHHII", nonce, *start) + json.dumps(STATED | stated, ensure_ascii=False).encode()


def frame(values, sequence, number=1, *, flags=1, encoding="h", pose=POSE, session=SESSION) -> bytes:
    payload = struct.pack(f"<{len(values)}{encoding}12f", *values, *pose)
    return datagrams(4, payload, session=session, schema=number, sequence=sequence, flags=flags)[0]


def changed(data: bytes, at: int, value: int) -> bytes:
    return data[:at] + bytes([value]) + data[at + 1 :]


GOOD = frame(VALUES, 5)


def played_as_sent(source: StreamSource, phone) -> bool:
    frames = collected(source, 20)
    at = int(np.abs(phone.values - frames[0].result.coefficients).max(axis=1).argmin())
    wanted = [phone.values[(at + number) % len(phone.values)] for number in range(20)]
    return bool(np.allclose([f.result.coefficients for f in frames], wanted, atol=0.0051))

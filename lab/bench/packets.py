"""Valid and damaged packets of every protocol, for the fuzzers of tests and of `lab.bench.remote`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from facemime.core.drive.driver import HeadDriver
from facemime.core.face.names import COEFFICIENTS, N_COEFFICIENTS
from facemime.core.heads.appearance import Appearance, built_in_appearance
from facemime.core.heads.rig import built_in_head
from facemime.core.streams.links import LENGTH
from facemime.core.streams.protocols import live_link, openseeface, osc, vmc
from facemime.core.streams.protocols.face_cap import FaceCapDecoder
from facemime.core.streams.protocols.face_motion import (
    FRAME,
    POSE,
    REVISION,
    SCHEMA,
    SCHEMA_DATAGRAM,
    START,
    STATED,
    FaceMotionReceiver,
    message,
)
from facemime.core.streams.protocols.frames import Decoder, FaceValues, StreamFrame
from facemime.core.streams.protocols.ifacialmocap import IFacialMocapDecoder
from facemime.core.streams.protocols.live_link import LiveLinkDecoder
from facemime.core.streams.protocols.openseeface import OpenSeeFaceDecoder
from facemime.core.streams.protocols.vmc import VmcDecoder
from facemime.core.streams.protocols.vrcfacetracking import VrcFaceTrackingDecoder
from facemime.core.streams.protocols.vtube_studio import VTubeStudioDecoder
from facemime.core.streams.transport.datagram import OwnReceiver, OwnSender, encode_face
from facemime.core.streams.vertices import VertexDecoder, encode_frame, encode_mesh
from facemime.core.streams.vertices import encode_face as encode_points
from facemime.core.takes.measured import coefficient_face
from facemime.core.tracking.result import TrackResult

_FACE = FaceValues(np.linspace(0.0, 1.0, N_COEFFICIENTS), np.array([0.1, -0.2, 0.05]))
_STATED = coefficient_face().result(_FACE.coefficients, _FACE.rotation)
_TRACKED = replace(_STATED, coefficients=np.full(N_COEFFICIENTS, np.nan))
_KEY = b"k" * 32


class _Own:
    """A receiver of Facemime's own packets, as a decoder."""

    def __init__(self) -> None:
        self._receiver = OwnReceiver(None)

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram."""
        return self._receiver.receive(data, 0.0)[0]


class _Signed:
    """The same with a key that no packet of the fuzzer is signed with, so nothing may be accepted."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram."""
        frames, _ = OwnReceiver(_KEY).receive(data, 0.0)
        assert not frames
        return []


class _Motion:
    """A receiver of Face Motion 3 to which a phone sends, as a decoder."""

    def __init__(self) -> None:
        self._receiver = FaceMotionReceiver()
        for packet in _motion()[:-1]:
            self._receiver.receive(packet, 0.0)

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram."""
        return self._receiver.receive(data, 0.0)[0]


@cache
def _motion() -> list[bytes]:
    stated = STATED | {"blend_names": list(COEFFICIENTS), "blend_encoding": "i16"}
    schema = START.pack(0, 60, 1200, 10_000, REVISION) + json.dumps(stated).encode()
    values = np.round(100.0 * _FACE.coefficients).astype("<i2").tobytes()
    return [
        *message(SCHEMA, 7, schema, schema=1, largest=SCHEMA_DATAGRAM),
        *message(FRAME, 7, values + POSE.pack(*range(6), *[0.0] * 6), schema=1, sequence=1, flags=1),
    ]


def _own() -> list[bytes]:
    results = (_TRACKED, _STATED, TrackResult.nothing(0))
    return [OwnSender(None).packet(*encode_face(result), 1.5) for result in results]


def _signed() -> list[bytes]:
    sender, receiver = OwnSender(_KEY), OwnReceiver(_KEY)
    hello = sender.hello()
    sender.answer(*receiver.receive(hello, 0.0)[1])
    return [hello, sender.packet(*encode_face(_TRACKED), 1.5)]


def _phone_text() -> list[bytes]:
    values = "|".join(f"{name}-{round(100 * v)}" for name, v in zip(COEFFICIENTS, _FACE.coefficients, strict=True))
    first = f"{values}|=head#-21.5,-6.0,-6.6,-0.03,-0.1,-0.66|rightEye#6.0,2.4,0.25|leftEye#6.0,-1.6,-0.17|"
    return [first.encode(), first.replace("-", "&", 52).encode()]


def phone_json() -> dict:
    vector = {"x": 1.0, "y": -2.0, "z": 3.0}
    entries = [{"k": name, "v": float(v)} for name, v in zip(COEFFICIENTS, _FACE.coefficients, strict=True)]
    return {
        "Timestamp": 1_700_000_000_123,
        "FaceFound": True,
        "Rotation": vector,
        "Position": vector,
        "BlendShapes": entries,
    }


def _face_cap() -> list[bytes]:
    messages = [osc.encode_message("/HT", 0.0, 0.0, -0.5), osc.encode_message("/HR", 10.0, 20.0, 5.0)]
    messages += [osc.encode_message("/W", number, 0.5) for number in range(52)]
    return [*osc.encode_bundles(messages, 9000), messages[-1]]


def _headset() -> list[bytes]:
    numbers = [("JawOpen", 0.5), ("SmileFrownLeft", -0.5), ("EyeLeftX", 0.2), ("EyeY", -0.3), ("EyeLidRight", 0.75)]
    bits = [("MouthX1", True), ("MouthX2", False), ("MouthXNegative", True)]
    messages = [osc.encode_message(f"/avatar/parameters/FT/v2/{name}", value) for name, value in (*numbers, *bits)]
    messages.append(osc.encode_message("/tracking/eye/LeftRightPitchYaw", 10.0, 5.0, 10.0, 3.0))
    return [*osc.encode_bundles(messages, 4096), messages[0], messages[-2]]


@cache
def _head() -> tuple[HeadDriver, Appearance]:
    return HeadDriver(built_in_head(lashes=True), coefficient_face().neutral), built_in_appearance()


class _Vertices(VertexDecoder):
    """A receiver that knows the built-in head."""

    def __init__(self) -> None:
        super().__init__()
        for packet in _vertices()[:2]:
            self.decode(packet)


@cache
def _vertices() -> list[bytes]:
    driver, looks = _head()
    messages = [encode_mesh(0, looks, driver.rest), encode_points(0, looks, driver.rig)]
    messages.append(encode_frame(0, 1.5, looks, driver.frame(_TRACKED)))
    return [message[LENGTH.size :] for message in messages]


INTACT: dict[str, tuple[Callable[[], Decoder], Callable[[], list[bytes]]]] = {
    "own": (_Own, _own),
    "own_signed": (_Signed, _signed),
    "livelink": (LiveLinkDecoder, lambda: [live_link.encode(_FACE, 12.5, subject="iPhone", device="d" * 36)]),
    "vmc": (VmcDecoder, lambda: list(vmc.encode(_FACE, 1.5))),
    "openseeface": (OpenSeeFaceDecoder, lambda: [openseeface.encode(_TRACKED, 1.5, (640, 480))]),
    "ifacialmocap": (IFacialMocapDecoder, _phone_text),
    "face_motion": (_Motion, _motion),
    "vtubestudio": (VTubeStudioDecoder, lambda: [json.dumps(phone_json()).encode()]),
    "vrcfacetracking": (VrcFaceTrackingDecoder, _headset),
    "facecap": (FaceCapDecoder, _face_cap),
    "vertices": (_Vertices, _vertices),
}
"""A decoder and valid packets for each protocol."""


@cache
def packets(name: str) -> tuple[bytes, ...]:
    """Return valid packets of a protocol."""
    return tuple(INTACT[name][1]())


def is_possible(frame: StreamFrame) -> bool:
    """Whether a frame that a decoder has accepted is one that a face can have."""
    face = frame.face
    if isinstance(face, FaceValues):
        if not ((face.coefficients >= 0.0) & (face.coefficients <= 1.0)).all():
            return False
        if face.eyes is not None and not (np.abs(face.eyes) <= np.pi).all():
            return False
        face = coefficient_face().result(face.coefficients, face.rotation, face.position, face.eyes)
    if face is not None:
        numbers = (face.shape, face.pose, face.landmarks)
        if not all(np.isfinite(values).all() for values in numbers) or not face.pose[0] > 0.0:
            return False
        if not 0.0 <= face.confidence <= 1.0:
            return False
    return frame.time is None or bool(np.isfinite(frame.time))

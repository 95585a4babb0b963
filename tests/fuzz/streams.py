"""Packets of every protocol to fuzz: what a decoder does not refuse has to be a possible face."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

import numpy as np

from facemime.core.coefficient_names import COEFFICIENTS
from facemime.core.errors import SourceError
from facemime.core.streams import live_link, openseeface, osc, vmc
from facemime.core.streams.datagram import encode_face
from facemime.core.streams.face_cap import FaceCapDecoder
from facemime.core.streams.frames import Decoder, FaceValues, PacketError, StreamFrame
from facemime.core.streams.ifacialmocap import IFacialMocapDecoder
from facemime.core.streams.live_link import LiveLinkDecoder
from facemime.core.streams.openseeface import OpenSeeFaceDecoder
from facemime.core.streams.sessions import OwnReceiver, OwnSender
from facemime.core.streams.vmc import VmcDecoder
from facemime.core.streams.vtube_studio import VTubeStudioDecoder
from facemime.core.takes.from_coefficients import coefficient_face
from facemime.core.tracking.result import TrackResult
from takes import coefficient_take, performance

from .mutators import mutated_bytes, mutated_json

_FACE = FaceValues(coefficient_take(20).coefficients[15].astype(float), np.array([0.1, -0.2, 0.05]))
_KEY = b"k" * 32


class _Own:
    """A receiver of Facemime's own packets, as a decoder."""

    def __init__(self) -> None:
        self._receiver = OwnReceiver(None)

    def decode(self, data: bytes) -> list[StreamFrame]:
        return self._receiver.receive(data, 0.0)[0]


class _Signed:
    """The same with a key, which no packet of the fuzzer has: nothing may get through."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        frames, _ = OwnReceiver(_KEY).receive(data, 0.0)
        assert not frames
        return []


def _own() -> list[bytes]:
    results = (performance().result(0), coefficient_take(20).result(15), TrackResult.nothing(0))
    return [OwnSender(None).packet(*encode_face(result), 1.5) for result in results]


def _signed() -> list[bytes]:
    sender, receiver = OwnSender(_KEY), OwnReceiver(_KEY)
    hello = sender.hello()
    sender.answer(receiver.receive(hello, 0.0)[1])
    return [hello, sender.packet(*encode_face(performance().result(0)), 1.5)]


def _phone_text() -> list[bytes]:
    values = "|".join(f"{name}-{round(100 * v)}" for name, v in zip(COEFFICIENTS, _FACE.coefficients, strict=True))
    first = f"{values}|=head#-21.5,-6.0,-6.6,-0.03,-0.1,-0.66|rightEye#6.0,2.4,0.25|leftEye#6.0,-1.6,-0.17|"
    return [first.encode(), first.replace("-", "&", 52).encode()]


def _phone_json() -> dict:
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


INTACT: dict[str, tuple[Callable[[], Decoder], Callable[[], list[bytes]]]] = {
    "own": (_Own, _own),
    "own_signed": (_Signed, _signed),
    "livelink": (LiveLinkDecoder, lambda: [live_link.encode(_FACE, 12.5, subject="iPhone", device="d" * 36)]),
    "vmc": (VmcDecoder, lambda: list(vmc.encode(_FACE, 1.5))),
    "openseeface": (OpenSeeFaceDecoder, lambda: [openseeface.encode(performance().result(0), 1.5)]),
    "ifacialmocap": (IFacialMocapDecoder, _phone_text),
    "vtubestudio": (VTubeStudioDecoder, lambda: [json.dumps(_phone_json()).encode()]),
    "facecap": (FaceCapDecoder, _face_cap),
}
"""For each protocol, a decoder and sound packets."""


@cache
def packets(name: str) -> tuple[bytes, ...]:
    """Sound packets of a protocol."""
    return tuple(INTACT[name][1]())


def mutated_packet(name: str, rng: Random) -> bytes:
    """A damaged packet: changed, cut, joined with another, of another protocol, or noise."""
    data = rng.choice(packets(name))
    kind = rng.random()
    if kind < 0.05:
        return rng.randbytes(rng.choice((0, 1, 8, 100, 1500, 20_000)))
    if kind < 0.1:
        return rng.choice(packets(rng.choice(tuple(INTACT))))
    if kind < 0.2:
        return data + rng.choice(packets(name))[: rng.randrange(2000)]
    if name == "vtubestudio" and kind < 0.7:
        return mutated_json(rng, _phone_json())
    return mutated_bytes(rng, data)


def read_packet(name: str, data: bytes) -> None:
    """Decode a packet as a receiver does; SourceError if it is refused."""
    try:
        frames = INTACT[name][0]().decode(data)
    except PacketError as error:
        raise SourceError(f"refused: {error}") from None
    for frame in frames:
        face = frame.face
        if isinstance(face, FaceValues):
            assert ((face.coefficients >= 0.0) & (face.coefficients <= 1.0)).all()
            face = coefficient_face().result(face.coefficients, face.rotation, face.position)
        if face is not None:
            assert np.isfinite(face.shape).all() and np.isfinite(face.pose).all() and face.pose[0] > 0.0
            assert np.isfinite(face.landmarks).all() and 0.0 <= face.confidence <= 1.0
        assert frame.time is None or np.isfinite(frame.time)


def reader(name: str) -> Callable[[Path], None]:
    """Read a packet from a file."""
    return lambda path: read_packet(name, path.read_bytes())

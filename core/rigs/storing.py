"""A map of a rig as bytes, which are stored with its head."""

from __future__ import annotations

import io
import json
from dataclasses import asdict

import numpy as np

from ..errors import SourceError
from ..face.landmarks import N_LANDMARKS
from ..files.archives import read_archive
from ..numeric.arrays import FloatArray
from .rig_map import LOCATION, PROPERTY, ROTATION, SCALE, RigChannel, RigMap

_FORM = "facemime controls 1"
_KINDS = (LOCATION, ROTATION, SCALE, PROPERTY)
_MOST = 1 << 26
"""Largest vertex index."""


def to_bytes(rig_map: RigMap, print_of_rig: str) -> bytes:
    """Return a map as bytes, with the fingerprint of the rig."""
    stream = io.BytesIO()
    # Twice the precision with which a step was measured.
    largest = np.abs(rig_map.effects).max(axis=(1, 2), initial=0.0)
    small = np.round(rig_map.effects / np.maximum(largest, 1e-30)[:, None, None] * 32767.0).astype(np.int16)
    np.savez_compressed(
        stream,
        format=np.array(_FORM),
        rig=np.array(print_of_rig),
        channels=np.array(json.dumps([asdict(channel) for channel in rig_map.channels])),
        sample=rig_map.sample.astype(np.int32),
        channel=rig_map.channel.astype(np.int32),
        scale=rig_map.scale,
        effects=small,
        largest=largest,
        lower=rig_map.lower,
        upper=rig_map.upper,
        doubt=rig_map.doubt,
        unit=np.array([rig_map.unit]),
    )
    return stream.getvalue()


def from_bytes(data: bytes) -> tuple[RigMap, str]:
    """Return a map and the fingerprint of its rig; raises SourceError if the bytes are damaged."""
    try:
        archive = read_archive(data)
        if archive.text("format") != _FORM:
            raise ValueError("its version is different")
        channels = tuple(_channel(fields) for fields in json.loads(archive.text("channels")))
        sample = archive.integers("sample", (None,), 0, _MOST)
        channel = archive.integers("channel", (None,), 0, max(len(channels) - 1, 0))
        if len(sample) < N_LANDMARKS or not len(channel):
            raise ValueError("it is empty")
        count = len(channel)

        def numbers(name: str) -> FloatArray:
            return archive.floats(name, (count,))

        effects = archive.floats("effects", (count, len(sample), 3)) * numbers("largest")[:, None, None] / 32767.0
        lower, upper = numbers("lower"), numbers("upper")
        (unit,) = archive.floats("unit", (1,)).tolist()
        if unit <= 0.0 or (lower > 0.0).any() or (upper < 0.0).any() or (lower >= upper).any():
            raise ValueError("its bounds are wrong")
        found = RigMap(
            channels, sample, channel, numbers("scale"), effects, lower, upper, numbers("doubt"), float(unit)
        )
        return found, archive.text("rig")
    except (ValueError, TypeError, KeyError) as error:
        raise SourceError(
            "The stored controls are damaged ({error}). Learn the controls again.", error=error
        ) from error


def _channel(fields: dict[str, object]) -> RigChannel:
    """Read a channel; raises ValueError or TypeError if it is invalid."""
    channel = RigChannel(**fields)  # type: ignore[arg-type]  # checked below
    texts = (channel.owner, channel.bone, channel.kind, channel.name)
    numbers = (channel.low, channel.high, channel.rest, channel.unit)
    if channel.kind not in _KINDS or not all(isinstance(text, str) for text in texts) or channel.index not in range(3):
        raise ValueError("a channel is unknown")
    if not all(isinstance(number, (int, float)) for number in numbers) or not channel.low <= 0.0 <= channel.high:
        raise ValueError("the range of a channel is wrong")
    return channel

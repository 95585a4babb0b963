"""A map of a rig as bytes, which are stored with its head."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..errors import SourceError
from ..face.landmarks import N_LANDMARKS
from ..files.archives import read_archive
from ..numeric.arrays import FloatArray
from .rig_map import LOCATION, PROPERTY, ROTATION, SCALE, RigChannel, RigMap

_FORM = "facemime controls 2"
_EARLIER = "facemime controls 1"
_KINDS = (LOCATION, ROTATION, SCALE, PROPERTY)
_MOST = 1 << 26
"""Largest vertex index."""

RigPart = tuple[str, int, str]
"""Part of a rig whose change makes a map stale: its kind, the number of its object, and its name if it has one."""


@dataclass(frozen=True)
class StoredControls:
    """A map as it is stored.

    Attributes
    ----------
    found : RigMap
        Its channels have labels as the names of their objects.
    rig : mapping of RigPart to str
        Fingerprint of each part of the rig.
    owners : tuple of str
        Labels of the objects of the rig, in the order in which the character uses them.
    earlier : str
        Fingerprint of the entire rig in files of earlier versions, which have neither `rig` nor `owners`; "" in others.
    """

    found: RigMap
    rig: Mapping[RigPart, str]
    owners: tuple[str, ...]
    earlier: str = ""


def to_bytes(rig_map: RigMap, rig: Mapping[RigPart, str], owners: Sequence[str]) -> bytes:
    """Return a map as bytes, whose channels have labels of `owners`; parameters are as for `StoredControls`."""
    channels = [replace(channel, owner=channel.label or channel.owner, label="") for channel in rig_map.channels]
    stream = io.BytesIO()
    # Twice the precision with which a step was measured.
    largest = np.abs(rig_map.effects).max(axis=(1, 2), initial=0.0)
    small = np.round(rig_map.effects / np.maximum(largest, 1e-30)[:, None, None] * 32767.0).astype(np.int16)
    np.savez_compressed(
        stream,
        format=np.array(_FORM),
        rig=np.array(json.dumps([[*part, print_of_part] for part, print_of_part in rig.items()])),
        owners=np.array(json.dumps(list(owners))),
        channels=np.array(json.dumps([asdict(channel) for channel in channels])),
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


def from_bytes(data: bytes) -> StoredControls:
    """Return a map as it was stored, also by earlier versions; raises SourceError if the bytes are damaged."""
    try:
        archive = read_archive(data)
        if (form := archive.text("format")) not in (_FORM, _EARLIER):
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
        if form == _EARLIER:
            return StoredControls(found, {}, (), archive.text("rig"))
        return StoredControls(found, _rig(json.loads(archive.text("rig"))), _labels(json.loads(archive.text("owners"))))
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


def _rig(rows: object) -> dict[RigPart, str]:
    """Read the fingerprints of the parts of a rig; raises ValueError if they are invalid."""
    if not isinstance(rows, list):
        raise ValueError("the rig is wrong")
    found: dict[RigPart, str] = {}
    for row in rows:
        if not isinstance(row, list) or [type(value) for value in row] != [str, int, str, str]:
            raise ValueError("a part of the rig is wrong")
        kind, number, name, print_of_part = row
        found[kind, number, name] = print_of_part
    return found


def _labels(names: object) -> tuple[str, ...]:
    """Read the labels of the objects of a rig; raises ValueError if they are invalid."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("the objects of the rig are wrong")
    return tuple(names)

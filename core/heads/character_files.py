"""What a file with a character says: the frame rate of its animation, and the expressions of a VRM avatar.

Files are read within bounds; a damaged one has no rate, and the program that imports it reports the damage.
"""

from __future__ import annotations

import base64
import binascii
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..files.reading import as_integer, as_list, as_number, as_object, as_text, parse_json, read_bytes
from ..numeric.arrays import FloatArray

_MAX = 10_000
"""Largest number of expressions, and of binds of one."""
_PERCENT = 100.0
"""Weight of a bind of VRM 0 that shows a morph target fully."""
_VRM0 = {"blink_l": "Blink_L", "blink_r": "Blink_R", "lookup": "LookUp", "lookdown": "LookDown"}


MAX_GLTF = 1 << 30
"""Largest size of a glTF file in bytes."""
_BLENDERS = (24 * 1.001, 30 * 1.001, 60 * 1.001)
"""Rates at which Blender's glTF add-on writes what is animated at 23.976, 29.97 and 59.94 frames per second."""
_RATES = (24.0, 24 / 1.001, 25.0, 30.0, 30 / 1.001, 48.0, 50.0, 60.0, 60 / 1.001, 90.0, 100.0, 120.0, *_BLENDERS)
"""Rates of animations, the most likely first where several fit."""
_OFF = 0.02
"""Largest distance of a keyframe from a frame, in frames."""
_LOWEST = 1.0
"""Lowest rate that an animation can have, in frames per second."""
_HIGHEST = 240.0
"""Highest rate that an animation can have, in frames per second."""
_MAX_SAMPLERS = 100_000
"""Largest number of curves that are read."""
_MAX_KEYS = 1_000_000
"""Largest number of keyframes that are read, in all curves."""
_DATA_URI = re.compile(r"data:[^,]{0,100};base64,")
_OGAWA = b"Ogawa\xff"
_MAX_SAMPLINGS = 1 << 20
"""Largest size of Alembic's table of time samplings in bytes."""
_HEAD = 1 << 16
"""Number of bytes in which a USD file states its rate."""
_TIME_CODES = re.compile(rb"^\s*timeCodesPerSecond\s*=\s*([0-9.]{1,20})", re.MULTILINE)


def rate_of_file(path: Path) -> float | None:
    """Return the frames per second at which the animation in a .glb, .gltf, .vrm, .abc or .usda file was made.

    It is None if the file states no rate, has no animation, or is of another kind.
    """
    read = {".glb": _rate_of_gltf, ".gltf": _rate_of_gltf, ".vrm": _rate_of_gltf, ".abc": _rate_of_alembic}
    with suppress(OSError, ValueError, struct.error, IndexError):
        rate = read.get(path.suffix.lower(), _rate_of_usd)(path)
        if rate is not None and _LOWEST <= rate <= _HIGHEST:
            return rate
    return None


def gltf_of(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a .glb, .vrm or .gltf file, and its binary chunk, b"" without one.

    Raises ValueError if the file is damaged or too large, and OSError if it cannot be read.
    """
    data = read_bytes(path, MAX_GLTF)
    if not data.startswith(b"glTF"):
        return as_object(parse_json(data), "the file"), b""
    if len(data) < 20:
        raise DataError("it is truncated")
    (length,) = struct.unpack_from("<I", data, 12)
    content = as_object(parse_json(data[20 : 20 + length]), "the file")
    return content, data[28 + length :]


def rate_of_times(times: FloatArray) -> float | None:
    """Return the rate on whose frames the times of keyframes lie, (N,), in seconds; the densest one if none fits."""
    times = np.unique(times[np.isfinite(times)])
    if len(times) < 2:
        return None
    for rate in _RATES:
        if np.abs(times * rate - np.round(times * rate)).max() < _OFF:
            return rate
    steps = np.diff(times)
    densest = 1.0 / float(steps[steps > 1.0 / _HIGHEST].min(initial=1.0))
    return float(min((rate for rate in _RATES if rate >= densest - _OFF), default=_RATES[-1]))


def duration_of_gltf(path: Path) -> float | None:
    """Return the time of the last keyframe in a .glb, .gltf or .vrm file, in seconds; None if it cannot be read."""
    with suppress(OSError, ValueError, struct.error, IndexError):
        times = _times_of_gltf(path)
        return float(times[np.isfinite(times)].max(initial=0.0))
    return None


def _rate_of_gltf(path: Path) -> float | None:
    return rate_of_times(_times_of_gltf(path))


def _times_of_gltf(path: Path) -> FloatArray:
    """Return the times of all keyframes, (N,), in seconds."""
    content, binary = gltf_of(path)
    return np.concatenate([np.empty(0), *_gltf_times(content, binary, path.parent)])


def _gltf_times(content: dict[str, Any], binary: bytes, folder: Path) -> Iterator[FloatArray]:
    """Yield the times of the keyframes of each curve, those that curves share once."""
    animations = as_list(content.get("animations", []), "animations", _MAX_SAMPLERS)
    samplers = [
        sampler
        for animation in animations
        for sampler in as_list(as_object(animation, "an animation").get("samplers", []), "samplers", _MAX_SAMPLERS)
    ]
    left = _MAX_KEYS
    for index in {
        as_integer(as_object(sampler, "a sampler").get("input"), "input", 0, 1 << 31) for sampler in samplers
    }:
        accessor = as_object(_at(content, "accessors", index), "an accessor")
        count = as_integer(accessor.get("count"), "count", 0, left)
        left -= count
        view = as_object(_at(content, "bufferViews", accessor.get("bufferView")), "a view")
        start = sum(as_integer(of.get("byteOffset", 0), "byteOffset", 0, MAX_GLTF) for of in (view, accessor))
        data = _buffer(as_object(_at(content, "buffers", view.get("buffer")), "a buffer"), binary, folder)
        yield np.frombuffer(data[start : start + 4 * count], "<f4").astype(np.float64)


def _at(content: dict[str, Any], name: str, index: Any) -> Any:
    items = as_list(content.get(name), name, 1 << 24)
    return items[as_integer(index, name, 0, len(items) - 1)]


def _buffer(buffer: dict[str, Any], binary: bytes, folder: Path) -> bytes:
    uri = buffer.get("uri")
    if not isinstance(uri, str):
        return binary
    if found := _DATA_URI.match(uri):
        try:
            return base64.b64decode(uri[found.end() :], validate=True)
        except binascii.Error as error:
            raise DataError("a buffer is damaged") from error
    if Path(uri).name != uri:
        raise DataError("a buffer is in another folder")
    return read_bytes(folder / uri, MAX_GLTF)


def _rate_of_alembic(path: Path) -> float | None:
    """Highest rate of the uniform time samplings of an archive in Ogawa's format."""
    with open(path, "rb") as stream:
        if not stream.read(8).startswith(_OGAWA):
            return None
        (root,) = struct.unpack("<Q", stream.read(8))
        stream.seek(root + 8 + 8 * 4)  # the fifth child of the root: after its number, and four others
        (where,) = struct.unpack("<Q", stream.read(8))
        stream.seek(where & ~(1 << 63))
        (size,) = struct.unpack("<Q", stream.read(8))
        table = stream.read(min(size, _MAX_SAMPLINGS))
    rates, at = [], 0
    while at + 16 <= len(table):
        _, cycle, count = struct.unpack_from("<IdI", table, at)
        at += 16 + 8 * count
        # A cycle of a second is the default, for what does not move.
        if cycle > 0.0 and count and (count, cycle) != (1, 1.0):
            rates.append(count / cycle)
    return max((rate for rate in rates if rate <= _HIGHEST), default=None)


def _rate_of_usd(path: Path) -> float | None:
    with open(path, "rb") as stream:
        found = _TIME_CODES.search(stream.read(_HEAD))
    return float(found[1]) if found and found[1] != b"." else None


_VRM0 |= {"lookleft": "LookLeft", "lookright": "LookRight"}
"""Names of presets of VRM 0 whose case is not that of a title."""


@dataclass(frozen=True)
class MorphBind:
    """A morph target (`target`) of a mesh (`mesh`), both by index, and its weight in an expression, usually 0 to 1."""

    mesh: int
    target: int
    weight: float


def expressions_of(gltf: Mapping[str, Any]) -> dict[str, list[MorphBind]]:
    """Return the morph targets of each expression of a VRM avatar, from the JSON of its file; nothing for other files.

    Presets have the names of Facemime's key mappings. Raises ValueError if the file is damaged.
    """
    extensions = as_object(gltf.get("extensions", {}), "extensions")
    found = _of_vrm1(extensions["VRMC_vrm"], gltf) if "VRMC_vrm" in extensions else _of_vrm0(extensions.get("VRM", {}))
    return {name: binds for name, binds in found if binds}


def _of_vrm1(extension: Any, gltf: Mapping[str, Any]) -> Iterator[tuple[str, list[MorphBind]]]:
    groups = as_object(as_object(extension, "VRMC_vrm").get("expressions", {}), "expressions")
    nodes = as_list(gltf.get("nodes", []), "nodes", 1 << 20)
    for group in ("preset", "custom"):
        for name, expression in as_object(groups.get(group, {}), group).items():
            binds = []
            for bind in as_list(as_object(expression, name).get("morphTargetBinds", []), name, _MAX):
                node = nodes[as_integer(as_object(bind, name).get("node"), "node", 0, len(nodes) - 1)]
                binds.append(_bind(as_object(node, "a node").get("mesh"), bind, 1.0))
            yield name, binds


def _of_vrm0(extension: Any) -> Iterator[tuple[str, list[MorphBind]]]:
    master = as_object(as_object(extension, "VRM").get("blendShapeMaster", {}), "blendShapeMaster")
    for item in as_list(master.get("blendShapeGroups", []), "blendShapeGroups", _MAX):
        group = as_object(item, "a group")
        preset = as_text(group.get("presetName", "unknown"), "presetName")
        own = as_text(group.get("name", ""), "name")
        name = own if preset.lower() == "unknown" else _VRM0.get(preset.lower(), preset.title())
        binds = as_list(group.get("binds", []), "binds", _MAX)
        yield name, [_bind(as_object(bind, name).get("mesh"), bind, _PERCENT) for bind in binds]


def _bind(mesh: Any, bind: Mapping[str, Any], full: float) -> MorphBind:
    weight = as_number(bind.get("weight", full), "weight", -_MAX, _MAX) / full
    return MorphBind(as_integer(mesh, "mesh", 0, 1 << 20), as_integer(bind.get("index"), "index", 0, 1 << 20), weight)

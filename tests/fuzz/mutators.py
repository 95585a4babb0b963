"""Mutators of files: of bytes, of values in JSON, of arrays, and of the archives that contain them.

All draw from a `random.Random`, so that a case's number makes the same case again.
"""

from __future__ import annotations

import copy
import io
import json
import math
import struct
import zipfile
from random import Random
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray]

_NUMBERS = (0, 1, 2, 7, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 50_000_000, 1_000_000_000)
_HUGE = 10**400
_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 66, 68, 10**6, -(10**9), 2**31, 2**63, 2**64, _HUGE, -_HUGE),
    *(math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-320, 0.5, -0.0),
    *("", "x", "NaN", "1", "0x10", "\0", "\ud800", "é" * 40, "long" * 20_000, "../../etc", "<script>alert(1)</script>"),
    *([], {}, [[]], [0], [math.nan], [None] * 66, {"x": 1}, [[1, 2], [3]], list(range(500))),
)


def mutated_bytes(rng: Random, data: bytes, most: int = 4) -> bytes:
    """Change up to `most` bits, bytes or integers, remove, repeat or move pieces, or truncate."""
    out = bytearray(data)
    for _ in range(rng.randint(1, most)):
        if not out:
            return bytes(rng.randrange(256) for _ in range(rng.randrange(64)))
        at = rng.randrange(len(out)) if rng.random() < 0.6 else rng.randrange(min(len(out), 96))
        kind = rng.randrange(8)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        elif kind == 2:
            out[at : at + 4] = struct.pack(rng.choice("<>") + "I", rng.choice(_NUMBERS) % 2**32)
        elif kind == 3:
            out[at : at + 4] = struct.pack("<f", rng.choice((math.nan, math.inf, -math.inf, 3e38, 1e-40, -1.0)))
        elif kind == 4:
            del out[at : at + rng.choice((1, 2, 4, 40, 400))]
        elif kind == 5:
            out[at:at] = bytes(rng.randrange(256) for _ in range(rng.choice((1, 2, 4, 40))))
        elif kind == 6:
            other = rng.randrange(len(out))
            out[at:at] = out[other : other + rng.choice((4, 64, 1024))]
        else:
            del out[at if rng.random() < 0.3 else rng.randrange(max(len(out) * 3 // 4, 1), len(out) + 1) :]
    return bytes(out)


def mutated_json(rng: Random, data: Any) -> bytes:
    """The JSON of `data` with some values replaced and, sometimes, bytes changed."""
    changed = copy.deepcopy(data)
    for _ in range(rng.randint(1, 3)):
        changed = _with_change(rng, changed)
    text = json.dumps(changed, ensure_ascii=rng.random() < 0.5).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        text = b"[" * 100_000 if rng.random() < 0.1 else mutated_bytes(rng, text)
    return text


def _with_change(rng: Random, data: Any) -> Any:
    places = list(_places(data, ()))
    # Depth first by level, so that a long list of numbers does not take every change.
    depth = rng.choice(sorted({len(place) for place in places}))
    place = rng.choice([place for place in places if len(place) == depth])
    if not place:
        return copy.deepcopy(rng.choice(_VALUES))
    owner = data
    for key in place[:-1]:
        owner = owner[key]
    kind = rng.randrange(6)
    if kind == 0:
        del owner[place[-1]]
    elif kind == 1 and isinstance(owner, list):
        owner.insert(place[-1], copy.deepcopy(owner[place[-1]]))
    elif kind == 2 and isinstance(owner, dict):
        owner[rng.choice(("", "extra", "format", "error", "x" * 1000))] = owner.pop(place[-1])
    else:
        owner[place[-1]] = copy.deepcopy(rng.choice(_VALUES))
    return data


def _places(data: Any, at: tuple[Any, ...]) -> Any:
    yield at
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from _places(value, (*at, key))


def mutated_arrays(rng: Random, arrays: Arrays) -> Arrays:
    """Change values, types, shapes or names of some arrays, or remove them."""
    out = dict(arrays)
    for _ in range(rng.randint(1, 2)):
        name = rng.choice(list(out))
        kind = rng.randrange(8)
        if kind == 0:
            del out[name]
        elif kind == 1:
            out[rng.choice(("extra", "../up", "", "x" * 300, rng.choice(list(out))))] = out.pop(name)
        elif kind == 2:
            out[name] = _other_type(rng, out[name])
        elif kind == 3:
            out[name] = _other_shape(rng, out[name])
        else:
            out[name] = _other_values(rng, out[name])
        if not out:
            break
    return out


def _other_type(rng: Random, array: np.ndarray) -> np.ndarray:
    kind = rng.choice(("f2", "f4", "f8", "i1", "u8", "?", "c16", "U5", "S3", "M8[s]", "V4"))
    with np.errstate(all="ignore"):
        try:
            return array.astype(kind)
        except (ValueError, TypeError):
            return np.zeros(array.shape, kind)


def _other_shape(rng: Random, array: np.ndarray) -> np.ndarray:
    ways = (
        lambda: array.reshape(-1),
        lambda: array[None],
        lambda: array[..., None],
        lambda: np.atleast_1d(array)[:0],
        lambda: array[:-1] if array.ndim else np.repeat(array, 2),
        lambda: np.concatenate([array, array]) if array.ndim else np.repeat(array, 66),
        lambda: array.T,
        lambda: np.array(array.reshape(-1)[0] if array.size else 0),
        lambda: np.zeros((0, 0), array.dtype),
        lambda: np.asfortranarray(array),
    )
    return np.asarray(rng.choice(ways)())


def _other_values(rng: Random, array: np.ndarray) -> np.ndarray:
    out = array.copy()
    if not out.size:
        return out
    if out.dtype == np.uint8 and out.ndim == 1:  # a network
        return np.frombuffer(mutated_bytes(rng, out.tobytes()), np.uint8)
    if out.dtype.kind == "U" and rng.random() < 0.3:  # invalid characters
        return np.frombuffer(b"\xff" * out.nbytes, out.dtype).reshape(out.shape)
    if out.dtype.kind == "U":
        out.reshape(-1)[rng.randrange(out.size)] = rng.choice(("", "other", "\0", out.reshape(-1)[0]))
        return out
    real = out.dtype.kind == "f"
    choices = (math.nan, math.inf, -math.inf, 6e4, -6e4, 0.0, -1.0, 1e-7) if real else (0, 1, -1, 2, 7, 100)
    value = rng.choice(choices)
    info = np.finfo(out.dtype) if real else None
    if not real and out.dtype.kind in "iu":
        limits = np.iinfo(out.dtype)
        value = rng.choice((limits.min, limits.max, max(value, int(limits.min))))
    elif info is not None and rng.random() < 0.2:
        value = float(info.max)
    chosen = slice(None) if rng.random() < 0.3 else rng.randrange(out.size)
    out.reshape(-1)[chosen] = value
    return out


def npy_bytes(array: np.ndarray) -> bytes:
    """A member of an archive."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)
    return stream.getvalue()


def archive_bytes(members: dict[str, bytes], methods: dict[str, int] | None = None) -> bytes:
    """An archive of these files; `methods` has those that are not merely stored."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            method = (methods or {}).get(name, zipfile.ZIP_STORED)
            archive.writestr(zipfile.ZipInfo(name), content, compress_type=method, compresslevel=1)
    return stream.getvalue()


_HEADERS = (
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (400000000, 3), }",
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (9223372036854775807, 9), }",
    b"{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 3), }",
    b"{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    b"{'descr': '<U900000000', 'fortran_order': False, 'shape': (), }",
    b"{'descr': [('a', '<f4'), ('b', '<i2')], 'fortran_order': True, 'shape': (6,), }",
    b"{'descr': '<f4', 'fortran_order': 1, 'shape': 6, }",
    b"{'descr': '<f4', 'shape': (6,",
    b"{" * 500,
    b"(" * 150 + b")" * 150,
    b"{'descr': 'x" + b"9" * 5000 + b"', }",
    b"'\xff\xfe \n\t  \n ",
)


def _other_header(rng: Random, content: bytes) -> bytes:
    """An .npy file whose header contradicts its content."""
    if rng.random() < 0.5:
        head = rng.choice(_HEADERS)
        return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content[128:]
    return mutated_bytes(rng, content[:128]) + content[128:]


_BOMB = npy_bytes(np.zeros(60_000_000, np.uint8))


def mutated_archive(rng: Random, arrays: Arrays) -> bytes:
    """An archive of `arrays`, damaged in its arrays, its members or as a whole."""
    level = rng.randrange(4)
    if level == 0:
        arrays = mutated_arrays(rng, arrays)
    members = {f"{name}.npy": npy_bytes(array) for name, array in arrays.items()}
    if level == 1:
        name = rng.choice(list(members))
        way = rng.randrange(5)
        if way == 0:
            members[name] = mutated_bytes(rng, members[name])
        elif way == 1:
            members[rng.choice((name.removesuffix(".npy"), "../" + name, "more.npy.npy"))] = members.pop(name)
        elif way == 2:
            members |= {f"x{i}.npy": b"" for i in range(rng.choice((5, 5000)))}
        else:
            members[name] = _other_header(rng, members[name])
    packed = rng.choice(list(members))
    methods = {packed: zipfile.ZIP_DEFLATED}
    if level == 2 and rng.random() < 0.1:  # a bomb
        return archive_bytes(members | {packed: _BOMB}, methods)
    if level == 2 and rng.random() < 0.3:
        methods = {packed: rng.choice((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))}
    elif rng.random() < 0.2:
        methods = dict.fromkeys(members, zipfile.ZIP_DEFLATED)
    data = archive_bytes(members, methods)
    return _damaged_container(rng, data) if level >= 2 else data


def _damaged_container(rng: Random, data: bytes) -> bytes:
    """Change flags, methods, sizes and offsets in the headers of an archive, or any bytes."""
    out = bytearray(data)
    heads = [(b"PK\x03\x04", (4, 6, 8, 14, 18, 22, 26, 28)), (b"PK\x01\x02", (6, 8, 10, 16, 20, 24, 28, 30, 42))]
    for _ in range(rng.randint(1, 3)):
        if rng.random() < 0.3:
            return mutated_bytes(rng, bytes(out))
        marker, places = rng.choice([*heads, (b"PK\x05\x06", (8, 10, 12, 16, 20))])
        starts = list(_all(bytes(out), marker))
        if not starts:
            continue
        at = rng.choice(starts) + rng.choice(places)
        size = rng.choice((1, 2, 4))
        value = rng.choice((*_NUMBERS, 9, 12, 14, 95, 98, 0x0001, 0x0800, 0x0041))
        out[at : at + size] = (value % 256**size).to_bytes(size, "little")
    return bytes(out)


def _all(data: bytes, marker: bytes) -> Any:
    at = data.find(marker)
    while at >= 0:
        yield at
        at = data.find(marker, at + 1)

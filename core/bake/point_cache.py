"""PC2 point caches: positions of all vertices at even times, for Blender's Mesh Cache modifier."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..files.writing import replacing
from ..numeric.arrays import FloatArray

SUFFIX = ".pc2"
_HEADER = struct.Struct("<12siiffi")


def write_point_cache(path: Path, samples: Iterable[FloatArray], vertices: int, start: float = 0.0) -> int:
    """Write samples of V vertices (V, 3), one per frame from frame `start`, as a point cache; return their number.

    An existing file is replaced only by a complete one. Raises OutputError if the file cannot be written.
    """
    count = 0
    with replacing(Path(path)) as temporary, open(temporary, "wb") as stream:
        stream.write(bytes(_HEADER.size))
        for sample in samples:
            if sample.shape != (vertices, 3):
                raise DataError(
                    "a sample has the shape {shape}, not {expected}", shape=sample.shape, expected=(vertices, 3)
                )
            stream.write(np.ascontiguousarray(sample, dtype="<f4").tobytes())
            count += 1
        stream.seek(0)
        stream.write(_HEADER.pack(b"POINTCACHE2\0", 1, vertices, start, 1.0, count))
    return count

"""A style: examples of how a head should look where its performers look in a certain way, and its file.

The file is an archive of numpy arrays, with the rest as JSON. Its offsets are those of one mesh, or of keys by name.
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, HeadError, SourceError
from ..face.landmarks import N_LANDMARKS
from ..face.names import N_ACTIONS
from ..files.archives import Archive, read_archive
from ..files.reading import as_list, as_number, as_object, as_text, parse_format, read_bytes
from ..files.writing import replacing
from ..numeric.arrays import FloatArray

SUFFIX = ".facestyle"
N_FEATURES = 3 * N_LANDMARKS + N_ACTIONS
"""Number of coordinates of an expression."""
MAX_WEIGHT = 2.0
MAX_EXAMPLES = 64
"""Largest number of examples: far more than anybody teaches, and few enough for a frame."""
_FORMAT = "facemime-style-1"
_MAX_BYTES = 256 << 20
"""Largest file, and size of its content: 64 examples of a mesh with 300,000 vertices."""
_MAX_KEYS = 1000
_MAX_VALUE = 1e3
"""Largest offset of a shape key's value, and coordinate of an expression in outer-eye distances."""
_MAX_OFFSET = 1e9
"""Largest offset of a vertex, in the unit of its mesh."""


def _no_offsets() -> NDArray[np.float32]:
    return np.empty((0, 3), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Example:
    """What was tracked in a frame, and how the head should differ from what follows from it.

    Attributes
    ----------
    name : str
    performer : str
        Name of the performer, or of the take.
    expression : (213,) float64
        As from `HeadDriver.expression`.
    offsets : (A, 3) float32
        Displacements of the vertices as in `HeadRig.all_vertices`: head frame, unit of the mesh. Those of other parts
        than the skin are added to the motion with which they follow it. Empty if a head was taught that its keys drive.
    keys : mapping of str to float
        Changes of the values of shape keys, for a head that its keys drive; empty if none was changed.
    weight : float
        Factor of the offsets, 0 to 2.
    muted : bool
        Whether the example is left out.
    thumbnail : bytes
        Picture of the head in PNG format; empty without one.
    controls : mapping of str to float
        Changes of the channels of a rig, by `RigChannel.key`, for a head that its controls drive.
    """

    name: str
    performer: str
    expression: FloatArray
    offsets: NDArray[np.float32] = field(default_factory=_no_offsets)
    keys: Mapping[str, float] = field(default_factory=dict)
    weight: float = 1.0
    muted: bool = False
    thumbnail: bytes = b""
    controls: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Style:
    """Examples in the order in which they were taught: of two with nearly the same expression, the later one counts."""

    examples: tuple[Example, ...] = ()

    def fitted_to(self, count: int, keys: Collection[str] | None = None) -> Style:
        """Return the style for a head with `count` vertices and certain shape keys; None if these are not known.

        Examples of another mesh keep only their shape keys and controls; raises HeadError if they have no controls, and
        the head none of the keys.
        """
        fitting = []
        for example in self.examples:
            if len(example.offsets) in (0, count):
                fitting.append(example)
            elif example.controls or any(keys is None or name in keys for name in example.keys):
                fitting.append(replace(example, offsets=_no_offsets()))
            else:
                raise HeadError(
                    "The example {example} was taught on a mesh with {taught} vertices, but this head has {count}. "
                    "Use it on that mesh, or remove it.",
                    example=example.name,
                    taught=len(example.offsets),
                    count=count,
                )
        return Style(tuple(fitting))


def style_bytes(style: Style) -> bytes:
    """Serialise a style as the content of its file."""
    described = [
        {
            "name": example.name,
            "performer": example.performer,
            "weight": example.weight,
            "muted": example.muted,
            "keys": dict(example.keys),
            "controls": dict(example.controls),
        }
        for example in style.examples
    ]
    arrays: dict[str, Any] = {
        "style": np.array(json.dumps({"format": _FORMAT, "examples": described}, ensure_ascii=False)),
    }
    for number, example in enumerate(style.examples):
        arrays[f"expression_{number}"] = np.asarray(example.expression, dtype=np.float64)
        arrays[f"offsets_{number}"] = np.asarray(example.offsets, dtype=np.float32)
        arrays[f"thumbnail_{number}"] = np.frombuffer(example.thumbnail, dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def style_of(data: bytes) -> Style:
    """Parse what `style_bytes` returns; raises ValueError if it is anything else."""
    archive = read_archive(data, _MAX_BYTES)
    described = as_list(parse_format(archive.text("style"), _FORMAT).get("examples"), "examples", MAX_EXAMPLES)
    return Style(tuple(_example(as_object(row, "an example"), number, archive) for number, row in enumerate(described)))


def _example(row: dict[str, Any], number: int, archive: Archive) -> Example:
    keys = _changes(row.get("keys"), "keys")
    controls = _changes(row.get("controls", {}), "controls")  # earlier versions wrote none
    if not isinstance(muted := row.get("muted"), bool):
        raise DataError("muted is not true or false")
    offsets = _within(archive.floats(f"offsets_{number}", (None, 3), np.float32), "an offset", _MAX_OFFSET)
    return Example(
        name=as_text(row.get("name"), "the name of an example"),
        performer=as_text(row.get("performer"), "the performer"),
        expression=_within(archive.floats(f"expression_{number}", (N_FEATURES,)), "an expression", _MAX_VALUE),
        offsets=np.asarray(offsets, dtype=np.float32),
        keys=keys,
        controls=controls,
        weight=as_number(row.get("weight"), "the weight", 0.0, MAX_WEIGHT),
        muted=muted,
        thumbnail=archive.data(f"thumbnail_{number}"),
    )


def _changes(found: object, what: str) -> dict[str, float]:
    """Return changes of values by name."""
    changes = as_object(found, what)
    if len(changes) > _MAX_KEYS:
        raise DataError("there are {keys} shape keys, more than {max_keys}", keys=len(changes), max_keys=_MAX_KEYS)
    return {as_text(name, what): as_number(value, what, -_MAX_VALUE, _MAX_VALUE) for name, value in changes.items()}


def _within(values: FloatArray, name: str, limit: float) -> FloatArray:
    if values.size and float(np.abs(values).max()) > limit:
        raise DataError("{name} exceeds {limit:g}", name=name, limit=limit)
    return values


def save_style(style: Style, path: Path) -> None:
    """Write a style to a file; raises OutputError if that is not possible."""
    with replacing(path) as temporary:
        temporary.write_bytes(style_bytes(style))


def load_style(path: Path) -> Style:
    """Read a style from a file; raises SourceError if it is missing, damaged, or anything else."""
    try:
        return style_of(read_bytes(path, _MAX_BYTES))
    except (OSError, ValueError) as error:
        raise SourceError(
            "{path} cannot be read ({error}). Use a file that Save Style wrote.", path=path, error=error
        ) from error

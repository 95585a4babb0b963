"""Trains the output for the tongue with real mouths as well: `python -m lab.training.tracker.tongue`.

Renders did not show the expert of the mouth's actions what mouths look like that speak: it took bared teeth, lips and
what lies between them for a tongue, in a fifth of the frames of a clip. In none of the photos and clips is the tongue
out. The convolutions stay as they are; the output gets hidden units of its own. This needs `onnx` of
`tools/requirements/training.txt`, and takes ten minutes.
"""

from __future__ import annotations

import argparse
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy loads: sums in another order give other weights

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import onnx
from onnx import numpy_helper

from facemime.core.drive.actions import _RANGES
from facemime.core.face.names import ACTIONS
from facemime.core.tracking.model_file import load_model, save_model
from facemime.core.tracking.network import Network
from facemime.core.tracking.patch_experts import ActionExperts
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker

from ..data import ROOT, add_data_option
from .acting import ActionSamples, action_samples
from .crops import draw_actions
from .heads import load_ict
from .recipes import ACTING, ACTION_PARTS, SEED
from .sources import AUTOMATIC, HAND_LABELLED, read_photos, split
from .workshop import Workshop

_TONGUE = ACTIONS.index("tongueOut")
_SKINS, _RENDERS, _DRAWN = 240, 14, 420
"""Photos whose renders show tongues, renders of each, and batches that are drawn from them."""
_BATCH = 64
_PHOTO, _FRAME = 8, 4
"""How often a photo, and a frame of a clip, is shown, each time a bit different."""
_SIDE = 640
"""Longest side of photos, in pixels, on which faces are tracked."""
_UNITS, _STEPS, _RATE, _DECAY, _DROPPED = 32, 3000, 2e-3, 1e-3, 0.3
_MIXTURE = (96, 64, 64)
"""Renders, photos and frames of clips in each step."""
_SHOWN = (0.55, 0.75)
"""Probabilities at which a tongue begins to be shown, and is shown in full. Chosen on half A of the strangers' clips
(`lab.bench.strangers`), in 0.3 % of whose frames the first is exceeded; on half B, in none."""
_FLATTENED = "/told/told.0/Flatten"
_TELLING = ("told.2.weight", "told.2.bias", "told.4.weight", "told.4.bias")
"""Names in the network of actions: what it has seen, and the weights of the layers that tell."""


@dataclass(frozen=True)
class Classifier:
    """Log odds of a tongue from the features (N, S) of the network: ``v . relu(W x + b) + c``."""

    hidden: np.ndarray
    hidden_bias: np.ndarray
    weights: np.ndarray
    bias: float


class _Seen:
    """What the network of the mouth's actions sees in crops (N, H, W)."""

    def __init__(self, experts: ActionExperts) -> None:
        self._net = cv2.dnn.readNetFromONNX(np.frombuffer(experts.network.onnx, np.uint8))
        (self._layer,) = (name for name in self._net.getLayerNames() if name.endswith(_FLATTENED))

    def __call__(self, crops: np.ndarray) -> np.ndarray:
        seen = []
        for start in range(0, len(crops), _BATCH):
            self._net.setInput(np.ascontiguousarray(crops[start : start + _BATCH, None], np.float32))
            seen.append(self._net.forward(self._layer).copy())
        return np.concatenate(seen)


def renders(workshop: Workshop) -> ActionSamples:
    """Renders of people to train on, a fifth of them with a tongue."""
    path = workshop.work / "tongue.npz"
    if not path.exists():
        head, model = load_ict(workshop.data), workshop.shape()
        photos = [photo for photo in workshop.photos() if photo.source in ACTING]
        backgrounds = split(read_photos(workshop.data, "congress"))[0]
        chosen = np.random.default_rng((SEED, 71)).permutation(len(photos))[:_SKINS]
        drawn = [
            action_samples(head, model, photos[i], int(i), backgrounds, _RENDERS, np.random.default_rng((SEED, 71, i)))
            for i in chosen.tolist()
        ]
        ActionSamples.join(drawn).save(path)
    return ActionSamples.load(path)


def mouths(images: Iterator[np.ndarray], tracker: FaceTracker, experts: ActionExperts, *, still: bool) -> np.ndarray:
    """Crops (N, H, W) of the mouths in photos, if `still`, or in the frames of a clip."""
    crops, (side,) = [], experts.sides
    tracker.reset()
    for image in images:
        result = tracker.locate(image) if still else tracker.track(image)
        if result.found:
            pose = result.pose.copy()
            pose[4:6] = result.landmarks[side].mean(axis=0)
            crops.append(experts.crops(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), [pose])[0])
    return np.array(crops)


def _photos(data: Path) -> Iterator[np.ndarray]:
    for photo in split(read_photos(data, *HAND_LABELLED, *AUTOMATIC))[0]:
        image = cv2.imread(str(photo.path))
        factor = min(1.0, _SIDE / max(image.shape[:2]))
        yield cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def _frames(path: Path) -> Iterator[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    while (read := video.read())[0]:
        yield read[1]


def varied(crops: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The crops (N, H, W) misplaced, mirrored, blurred, noisy, and of other contrast."""
    out = np.empty_like(crops)
    height, width = crops.shape[1:]
    for row, crop in enumerate(crops):
        to = cv2.getRotationMatrix2D((width / 2, height / 2), rng.normal(0, 3), np.exp(rng.normal(0, 0.05)))
        to[:, 2] += rng.normal(0, 1.2, 2)
        image = cv2.warpAffine(crop, to, (width, height), borderMode=cv2.BORDER_REPLICATE)
        if rng.random() < 0.5:
            image = np.ascontiguousarray(image[:, ::-1])
        if rng.random() < 0.4:
            image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.6))
        if rng.random() < 0.4:
            image = image + rng.normal(0, rng.uniform(0.02, 0.12) * image.std(), image.shape)
        out[row] = image * np.exp(rng.normal(0, 0.15)) + rng.normal(0, 0.1)
    return out


def train(seen: tuple[np.ndarray, np.ndarray, np.ndarray], shown: np.ndarray, rng: np.random.Generator) -> Classifier:
    """Train on what is seen in renders, whose tongues are out by `shown` (N,), in photos and in clips, without any.

    Cross-entropy, by Adam (Kingma and Ba 2015) with a rate that falls as a cosine.
    """
    mean, spread = seen[0].mean(axis=0), seen[0].std(axis=0) + 0.05
    units = rng.normal(0.0, np.sqrt(2.0 / len(mean)), (len(mean), _UNITS))
    weights = [units, np.zeros(_UNITS), rng.normal(0.0, np.sqrt(1.0 / _UNITS), _UNITS), np.array(-2.0)]
    first, second = ([np.zeros_like(w) for w in weights] for _ in range(2))
    truths = (shown, np.zeros(len(seen[1])), np.zeros(len(seen[2])))
    for step in range(1, _STEPS + 1):
        rows = [rng.integers(0, len(part), count) for part, count in zip(seen, _MIXTURE, strict=True)]
        x = (np.concatenate([part[r] for part, r in zip(seen, rows, strict=True)]) - mean) / spread
        x *= (rng.random(x.shape) > _DROPPED) / (1.0 - _DROPPED)
        truth = np.concatenate([part[r] for part, r in zip(truths, rows, strict=True)])
        raised = x @ weights[0] + weights[1]
        told = np.maximum(raised, 0.0)
        wrong = (1.0 / (1.0 + np.exp(-(told @ weights[2] + weights[3]))) - truth) / len(truth)
        back = np.outer(wrong, weights[2]) * (raised > 0.0)
        slopes = [x.T @ back + _DECAY * weights[0], back.sum(axis=0), told.T @ wrong, wrong.sum()]
        rate = _RATE * min(1.0, step / 100) * 0.5 * (1.0 + np.cos(np.pi * step / _STEPS))
        for i, slope in enumerate(slopes):
            first[i] = 0.9 * first[i] + 0.1 * slope
            second[i] = 0.999 * second[i] + 0.001 * np.square(slope)
            away = np.sqrt(second[i] / (1.0 - 0.999**step)) + 1e-8
            weights[i] = weights[i] - rate * first[i] / (1.0 - 0.9**step) / away
    hidden = weights[0] / spread[:, None]
    return Classifier(hidden.T, weights[1] - mean @ hidden, weights[2], float(weights[3]))


def calibrated(classifier: Classifier) -> Classifier:
    """Return a classifier whose probabilities are in the range of the activations that the avatar shows."""
    (low, high), (begin, full) = (np.log(np.array(p) / (1.0 - np.array(p))) for p in (_SHOWN, _RANGES["tongueOut"]))
    factor = (full - begin) / (high - low)
    return replace(classifier, weights=factor * classifier.weights, bias=begin + factor * (classifier.bias - low))


def with_output(exported: bytes, output: int, classifier: Classifier) -> bytes:
    """Return a network of actions in ONNX in which a classifier replaces the output with index `output`."""
    model = onnx.load_from_string(exported)
    saved = {one.name: one for one in model.graph.initializer}
    hidden, hidden_bias, told, told_bias = (numpy_helper.to_array(saved[name]).copy() for name in _TELLING)
    own = np.zeros((len(told), len(classifier.weights)))
    own[output], told[output], told_bias[output] = classifier.weights, 0.0, classifier.bias
    others = told.any(axis=0)  # without units that no other output uses
    grown = (
        np.concatenate([hidden[others], classifier.hidden]),
        np.concatenate([hidden_bias[others], classifier.hidden_bias]),
        np.concatenate([told[:, others], own], axis=1),
        told_bias,
    )
    for name, values in zip(_TELLING, grown, strict=True):
        saved[name].CopyFrom(numpy_helper.from_array(values.astype(np.float32), name))
    return bytes(model.SerializeToString())


def main() -> None:
    """Train, and write the model that ships with the new network."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.tracker.tongue", description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "model", help="folder of the results")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    workshop, rng = Workshop(options.data, options.work), np.random.default_rng((SEED, 72))
    model = load_model(DEFAULT_MODEL)
    number, experts = next((i, each) for i, each in enumerate(model.actions) if _TONGUE in each.actions)
    output, look = int(np.flatnonzero(experts.actions == _TONGUE)[0]), _Seen(experts)
    samples, drawn = renders(workshop), []
    for _ in range(_DRAWN):
        batch = draw_actions(samples, ACTION_PARTS["mouth"], _BATCH, rng)
        drawn.append((look(batch.pictures[:, 0]), batch.actions[:, output]))
    tracker = FaceTracker.load()
    photos = mouths(_photos(options.data), tracker, experts, still=True)
    clips = np.concatenate(
        [
            mouths(_frames(path), tracker, experts, still=False)
            for path in sorted((options.data / "videos").glob("*.mp4"))
        ]
    )
    print(f"{len(samples)} renders, {len(photos)} photos, {len(clips)} frames", flush=True)
    seen = (
        np.concatenate([each for each, _ in drawn]),
        np.concatenate([look(varied(photos, rng)) for _ in range(_PHOTO)]),
        np.concatenate([look(varied(clips, rng)) for _ in range(_FRAME)]),
    )
    classifier = calibrated(train(seen, np.concatenate([shown for _, shown in drawn]), rng))
    network = Network(with_output(experts.network.onnx, output, classifier), "actions")
    actions = tuple(replace(each, network=network) if i == number else each for i, each in enumerate(model.actions))
    print(f"{DEFAULT_MODEL}: model {save_model(replace(model, actions=actions), DEFAULT_MODEL)}")


if __name__ == "__main__":
    sys.exit(main())

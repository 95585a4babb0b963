"""Mouths among beards and with painted lips: `python -m lab.bench.mouths --data DIR`.

Re-projections of the held-out people speak, as they were photographed, with drawn moustaches and beards, and with
painted lips. All landmarks are known. No training step uses these people.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import (
    LIPS,
    LOWER_LIPS,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    MOUTH_OUTER,
    UPPER_LIPS,
    outer_eye_distance,
)
from facemime.core.tracking.model_file import load_model
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker
from lab.bench.report import Table, finish, parser
from lab.training.data import add_data_option
from lab.training.tracker.dress import beard, blend
from lab.training.tracker.heads import load_ict, sample_speech
from lab.training.tracker.samples import (
    CENTRE,
    SCALE,
    SIZE,
    Scene,
    composed,
    personal_expression,
    random_light,
    render,
    skin_photo,
)
from lab.training.tracker.sources import HAND_LABELLED, read_photos, split

_INNER = np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])
_SIZES = {80: 1.0, 32: 0.4}
"""Pixels per outer-eye distance, and the share of the render's."""
_RENDERS = 4
_REPEATED = 3
"""Times that an image is tracked, after which landmarks have settled."""


def _painted(image: np.ndarray, landmarks: np.ndarray, unit: float, rng: np.random.Generator) -> np.ndarray:
    """Paint lips dark or bright, also beyond their rims and corners."""
    mask = np.zeros_like(image)
    outline = landmarks[MOUTH_OUTER].copy()
    middle = outline.mean(axis=0)
    beyond = unit * rng.uniform(0.0, 0.04)
    outwards = outline - middle
    outline += beyond * outwards / np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-6)
    if rng.random() < 0.3:  # as clowns have it
        smile = unit * rng.uniform(0.02, 0.15) * np.array([1.0, rng.uniform(-0.6, 0.2)])
        outline[0] += smile * (-1.0, 1.0)
        outline[6] += smile
    cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 255)
    cv2.fillPoly(mask, [np.round(landmarks[_INNER]).astype(np.int32)], 0)
    soft = cv2.GaussianBlur(mask, (0, 0), unit * rng.uniform(0.003, 0.015))
    level = rng.uniform(0.0, 80.0) if rng.random() < 0.75 else rng.uniform(80.0, 230.0)
    shading = 0.3 * (image.astype(np.float32) - float(image[mask > 0].mean() if (mask > 0).any() else 0.0))
    return blend(image, soft, level + shading, rng.uniform(0.3, 0.95))


_LOOKS: Mapping[str, Callable[..., np.ndarray]] = {
    "as photographed": lambda image, *_: image,
    "moustache or beard": beard,
    "painted lips": _painted,
}


def main() -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    add_data_option(command)
    command.add_argument("--model", type=Path, default=DEFAULT_MODEL, help="the tracker's model")
    arguments = command.parse_args()
    tracker = FaceTracker(load_model(arguments.model))
    errors: dict[tuple[str, int], list[tuple[float, float, float]]] = {}
    lost = dict.fromkeys(((look, size) for look in _LOOKS for size in _SIZES), 0)
    for image, landmarks, seed in _renders(arguments.data, tracker):
        unit = outer_eye_distance(landmarks)
        for look, dressed in _LOOKS.items():
            shown = dressed(image, landmarks, SCALE, np.random.default_rng(seed))
            for size, share in _SIZES.items():
                small = cv2.resize(shown, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
                found = _tracked(tracker, small)
                if found is None:
                    lost[look, size] += 1
                    continue
                found = (found + 0.5) / share - 0.5
                away = np.linalg.norm(found - landmarks, axis=1)[LIPS].mean() / unit
                errors.setdefault((look, size), []).append((away, _gap(found) / unit, _gap(landmarks) / unit))
    rows = []
    for (look, size), values in errors.items():
        away, gap, true = np.array(values).T
        slope = np.polyfit(true, gap, 1)[0]
        correlation = np.corrcoef(true, gap)[0, 1]
        apart = 100.0 * np.abs(gap - true).mean()
        rows.append((look, size, 100.0 * away.mean(), apart, correlation, slope, lost[look, size]))
    columns = ("mouth", "pixels between the eyes", "error, %", "error of the gap, %", "correlation", "slope", "lost")
    finish(arguments, [Table("Beards and painted lips", columns, rows)], {})
    return 0


def _renders(data: Path, tracker: FaceTracker) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Pictures of the held-out people as they speak, their landmarks (66, 2), and a seed for each."""
    head, pdm = load_ict(data), tracker.pdm
    backgrounds = split(read_photos(data, "congress"))[0]
    for number, photo in enumerate(split(read_photos(data, *HAND_LABELLED))[1]):
        rng = np.random.default_rng((5, number))
        skinned = skin_photo(head, pdm, photo, rng)
        for _ in range(_RENDERS):
            expression = personal_expression(head, skinned, rng, sample_speech)
            pose = np.array([SCALE, rng.normal(0.0, 0.1), rng.normal(0.0, 0.25), 0.0, CENTRE, CENTRE])
            scene = Scene(random_light(rng), 0.05, (0.0, 0.0), (0.4, 1.3))
            picture = render(head, skinned, expression, pose, SIZE, scene, rng)
            yield composed(picture, skinned, head, backgrounds, rng), picture.landmarks, int(rng.integers(2**31))


def _tracked(tracker: FaceTracker, image: np.ndarray) -> np.ndarray | None:
    """The landmarks (66, 2) of a still; None if no face is found."""
    tracker.reset()
    for _ in range(_REPEATED):
        result = tracker.track(image)
    return result.landmarks.astype(np.float64) if result.found else None


def _gap(landmarks: np.ndarray) -> float:
    return float(landmarks[LOWER_LIPS, 1].mean() - landmarks[UPPER_LIPS, 1].mean())


if __name__ == "__main__":
    sys.exit(main())

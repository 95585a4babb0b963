"""Landmarks drawn on data that cannot be published: `python -m lab.bench.overlays -o FOLDER`.

One sheet shows photos of held-out people, those with the largest errors first, and there is one sheet per clip. The
images contain photos and frames of ../shared/data and must stay out of the repository.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from facemime.core.base.landmarks import EDGES, INNER
from facemime.core.tracking.tracker import FaceTracker
from lab.training.data import add_data_option
from lab.training.tracker.sources import HAND_LABELLED, read_photos, split

SIDE, COLUMNS, FRAMES = 240, 8, 48
"""Size of an image in pixels, images per row, and frames per clip."""


def draw_face(image: np.ndarray, landmarks: np.ndarray, caption: str) -> np.ndarray:
    """Crop an image to its face, (SIDE, SIDE, 3), and draw the landmarks; uncropped if no face was found."""
    if not np.isfinite(landmarks).all():
        out = cv2.resize(image, (SIDE, SIDE))
    else:
        centre, reach = landmarks.mean(0), 0.75 * np.ptp(landmarks, axis=0).max()
        gain = SIDE / (2 * reach)
        matrix = np.array([[gain, 0, SIDE / 2 - gain * centre[0]], [0, gain, SIDE / 2 - gain * centre[1]]])
        out = cv2.warpAffine(image, matrix, (SIDE, SIDE), flags=cv2.INTER_CUBIC)
        points = np.round((landmarks @ matrix[:, :2].T + matrix[:, 2]) * 8).astype(int)
        for a, b in EDGES:
            cv2.line(out, tuple(points[a]), tuple(points[b]), (0, 255, 0), 1, cv2.LINE_AA, 3)
    return cv2.putText(out, caption, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 255, 255), 1, cv2.LINE_AA)


def photo_sheet(tracker: FaceTracker, data: Path) -> list[np.ndarray]:
    """All held-out photos, including smiling ones with automatic labels, the largest differences first."""
    drawn = []
    for photo in split(read_photos(data, *HAND_LABELLED, "london_smiling"))[1]:
        image = cv2.imread(str(photo.path))
        found = tracker.locate(image).landmarks
        error = np.linalg.norm(found - photo.landmarks, axis=1)[INNER].mean() / photo.eye_distance() * 100
        drawn.append((error, draw_face(image, found, f"{photo.source} {photo.name} {error:.1f}")))
    return [picture for _, picture in sorted(drawn, key=lambda d: -np.nan_to_num(d[0], nan=1e3))]


def clip_sheet(tracker: FaceTracker, path: Path) -> list[np.ndarray]:
    """Return evenly spaced frames of a tracked clip."""
    reader = cv2.VideoCapture(str(path))
    every = max(int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) // FRAMES, 1)
    tracker.reset()
    drawn, number = [], 0
    while (read := reader.read())[0]:
        result = tracker.track(read[1])
        if number % every == 0:
            drawn.append(draw_face(read[1], result.landmarks, f"{number} {result.confidence:.2f}"))
        number += 1
    return drawn


def main() -> None:
    """Write the sheets."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument("-o", "--output", type=Path, required=True, help="folder for the sheets")
    add_data_option(command)
    command.add_argument("--model", type=Path, help="tracker model (the shipped one)")
    arguments = command.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    tracker = FaceTracker.load(arguments.model)
    sheets = {"photos": photo_sheet(tracker, arguments.data)}
    for path in sorted((arguments.data / "videos").glob("*.mp4")):
        sheets[path.stem] = clip_sheet(tracker, path)
    for name, pictures in sheets.items():
        whole = pictures + [np.zeros_like(pictures[0])] * (-len(pictures) % COLUMNS)
        rows = [np.hstack(whole[i : i + COLUMNS]) for i in range(0, len(whole), COLUMNS)]
        target = arguments.output / f"{name}.png"
        cv2.imwrite(str(target), np.vstack(rows))
        print(target)


if __name__ == "__main__":
    main()

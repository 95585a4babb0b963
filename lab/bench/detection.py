"""Faces that the network and the cascades detect: turned, tilted, distant, or with another person behind.

Usage: python -m lab.bench.detection [--json build/bench/detection.json]. Held-out people are rendered against a grey
wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.core.face.landmarks import INNER
from facemime.core.tracking.tracker import CASCADES, NETWORK, FaceTracker, TrackingSettings
from lab.bench.report import Table, finish, people_parser
from lab.training.tracker.checks import surface
from lab.training.tracker.detection import background_piece
from lab.training.tracker.heads import load_ict
from lab.training.tracker.reproject import WINDOW_LIGHT, Scene, render, skin_head
from lab.training.tracker.sources import Photo, read_photos, split

_WIDTH, _HEIGHT = 640, 480
_NEAR = 0.12
"""Mean error of the visible inner points, in eye distances, below which the right face was found."""
_LARGE, _BEHIND = 80.0, 26.0
"""Outer-eye distances, in pixels, of a large person and of the blurred one behind."""
_FRAMES_WITHOUT_A_FACE, _IMAGES_WITHOUT_A_FACE, _PIECES = 16, 60, 8


@dataclass(frozen=True)
class Case:
    """A rendered person: angles in degrees and sizes in pixels, with or without another person behind."""

    title: str
    yaw: float = 0.0
    roll: float = 0.0
    size: float = _LARGE
    behind: bool = False


CASES = (
    *(Case(f"yaw {yaw} degrees", yaw=yaw) for yaw in (0, 45, 60, 70, 80)),
    *(Case(f"yaw {yaw} degrees, another person behind", yaw=yaw, behind=True) for yaw in (0, 45, 60, 70, 80)),
    *(Case(f"roll {roll} degrees", roll=roll) for roll in (30, 60, 90, 135, 180)),
    *(Case(f"eyes {size} pixels apart", size=size) for size in (25, 15, 11, 8)),
)


class Renderer:
    """Renders people who are held out of the training, in grey images (480, 640)."""

    def __init__(self, data: Path, tracker: FaceTracker) -> None:
        self._data, self._pdm, self._head = data, tracker.pdm, load_ict(data)
        self.photos: list[Photo] = split(read_photos(data, "london_neutral"))[1]

    def picture(self, case: Case, number: int) -> tuple[NDArray[np.uint8], np.ndarray, np.ndarray]:
        """Return the image of a person, their landmarks (66, 2) in pixels, and which of these are visible (66,)."""
        rng = np.random.default_rng(number)
        picture = np.clip(110.0 + rng.normal(0.0, 3.0, (_HEIGHT, _WIDTH)), 0, 255).astype(np.uint8)
        if case.behind:
            self._draw(picture, number + 1, Case("", size=_BEHIND), (60, 90), rng)
            picture = cv2.GaussianBlur(picture, (0, 0), 2.0)
        place = (200, 80) if case.size == _LARGE else (300, 200)
        landmarks, seen = self._draw(picture, number, case, place, rng)
        return picture, landmarks, seen

    def _draw(
        self, picture: NDArray[np.uint8], number: int, case: Case, place: tuple[int, int], rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        photo = self.photos[number % len(self.photos)]
        skinned = skin_head(self._head, self._pdm, photo.grey(), photo.landmarks, acting=False)
        side, way = int(4 * case.size), 1 if number % 2 else -1
        turn = np.radians([0.0, way * case.yaw, way * case.roll])
        drawn = render(
            self._head,
            skinned,
            np.zeros(len(self._head.names), np.float32),
            np.array([case.size, *turn, side / 2, side / 2]),
            side,
            Scene(WINDOW_LIGHT),
            rng,
        )
        x, y = place
        picture[y : y + side, x : x + side][drawn.covered] = drawn.image[drawn.covered]
        return drawn.landmarks + place, drawn.visible & np.isin(np.arange(66), INNER)

    def empty(self, count: int) -> list[NDArray[np.uint8]]:
        """Return images without people: collages of walls and of the surroundings of faces in photos."""
        rng = np.random.default_rng(5)
        photos = (
            self.photos + split(read_photos(self._data, "canada"))[1] + split(read_photos(self._data, "congress"))[1]
        )
        out = []
        for _ in range(count):
            picture = cv2.resize(surface(rng), (_WIDTH, _HEIGHT))
            for _ in range(_PIECES):
                photo = photos[rng.integers(len(photos))]
                width, height = rng.integers(60, 320, 2).tolist()
                x, y = int(rng.integers(_WIDTH - width)), int(rng.integers(_HEIGHT - height))
                picture[y : y + height, x : x + width] = cv2.resize(
                    background_piece(photo.grey(), photo.landmarks, rng), (width, height)
                )
            out.append(picture)
        return out


def count_found(tracker: FaceTracker, renderer: Renderer, case: Case, people: int) -> tuple[int, float]:
    """Number of people that are found in their images, and median milliseconds per image."""
    right, times = 0, []
    for number in range(people):
        picture, landmarks, seen = renderer.picture(case, number)
        began = perf_counter()
        result = tracker.locate(picture)
        times.append(1e3 * (perf_counter() - began))
        away = np.linalg.norm(result.landmarks - landmarks, axis=1)[seen].mean() / case.size
        right += bool(result.found and away < _NEAR)
    return right, float(np.median(times))


def measure_without_a_face(detector: str, pictures: list[NDArray[np.uint8]]) -> dict[str, str]:
    """Milliseconds per frame without people, live and in a file, and number of images with false detections."""
    out = {}
    for gradual, where in ((True, "live"), (False, "file, after the first frame")):
        tracker, times, wrong = FaceTracker.load(gradual=gradual, settings=TrackingSettings(detector)), [], 0
        for picture in pictures:
            tracker.reset()
            for frame in range(_FRAMES_WITHOUT_A_FACE):
                began = perf_counter()
                if tracker.track(picture).found:
                    wrong += 1
                    break
                if gradual or frame:
                    times.append(1e3 * (perf_counter() - began))
        out[f"{where}: median"] = f"{np.median(times):.0f} ms"
        out[f"{where}: 95th percentile"] = f"{np.percentile(times, 95):.0f} ms"
        out[f"{where}: false detections"] = f"{wrong} of {len(pictures)}"
    return out


def main() -> int:
    """Run the benchmark; returns the exit status."""
    arguments = people_parser(__doc__.splitlines()[0], people=16).parse_args()
    cv2.setNumThreads(1)
    trackers = {name: FaceTracker.load(settings=TrackingSettings(name)) for name in (NETWORK, CASCADES)}
    renderer = Renderer(arguments.data, trackers[NETWORK])
    rows = []
    for case in CASES:
        result = [count_found(tracker, renderer, case, arguments.people) for tracker in trackers.values()]
        rows.append((case.title, *(f"{right} of {arguments.people}, {time:.0f} ms" for right, time in result)))
    columns = ("", "neural network", "Viola-Jones")
    pictures = renderer.empty(_IMAGES_WITHOUT_A_FACE)
    times = [measure_without_a_face(name, pictures) for name in trackers]
    empty = [(title, *(result[title] for result in times)) for title in times[0]]
    tables = [Table("Faces found, by detector", columns, rows), Table("Frames without a face", columns, empty)]
    finish(arguments, tables, {table.title: [list(row) for row in table.rows] for table in tables})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

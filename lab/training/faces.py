"""Conversion of sets of face photos, as published by their authors, to the folders used here (lab/training/README.md).

`python -m lab.training.faces FOLDER SET` reads the photos of a folder, and frames of its clips. Landmarks come from the
template beside each photo (`001_03.tem` beside `001_03.jpg`); MediaPipe finds them if there is no template.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from .data import add_data_option
from .tracker.sources import AUTOMATIC, CLIPS, HAND_LABELLED

LARGEST_SIDE = 640
"""Photos with a longer side are cut to a square about the face and reduced to this many pixels."""
_MARGIN = 2.0
"""Side of that square, in sides of the landmarks' bounding box."""
EVERY = 3
"""Every third frame of a clip is used, as frames hardly differ from the next."""
TEMPLATE_POINTS = 189
_EAR_TO_CHIN = (109, 185, 110, 186, 111, *range(125, 130)), (112, 187, 113, 188, 114, *range(133, 128, -1))
_UPPER_LIDS, _LOWER_LIDS = ((18, 19, 20, 21, 22), (23, 24, 25, 26, 27)), ((18, 28, 29, 30, 22), (23, 31, 32, 33, 27))
_BROWS = (71, 72, 73, 74, 75, 76), (77, 78, 79, 80, 81, 82)
_SIDES_OF_BRIDGE, _UNDER_NOSE = ((50, 51, 52, 53, 54), (56, 57, 58, 59, 60)), 55
_BRIDGE_ENDS = 0.65, 0.25
"""Where the landmarks of the bridge begin and end, as shares of the first and last segments of its middle line."""
_NOSTRILS = (64, 180, 55), (55, 181, 69)
_OUTER_LIPS = (87, 88, 89, 90, 91, 92, 93, 108, 107, 106, 105, 104)
_UPPER_INNER_LIP, _LOWER_INNER_LIP, _INNER_CORNER = (94, 95, 96, 97, 98), (103, 102, 101, 100, 99), 0.4
"""Points of the inner lips, and where an inner corner lies between the outer corner and the first of them."""

_CLIPS = (".mp4", ".mov", ".mkv", ".webm", ".avi")
Label = Callable[[np.ndarray], np.ndarray]


def read_template(text: str) -> np.ndarray:
    """Read the points (189, 2), `(x, y)` in pixels, of a template in the format of Psychomorph and WebMorph.

    Raises ValueError if the text is not a template of 189 points.
    """
    lines = text.split("\n")
    try:
        count = int(lines[0])
        points = np.array([[float(value) for value in line.split()] for line in lines[1 : count + 1]])
    except ValueError as error:
        raise ValueError("its template is damaged") from error
    if points.shape != (TEMPLATE_POINTS, 2):
        raise ValueError(f"its template has {count} points, and not the {TEMPLATE_POINTS} of the Face Research Lab")
    if not np.isfinite(points).all():
        raise ValueError("its template has points that are not numbers")
    return points


def landmarks_of_template(points: np.ndarray) -> np.ndarray:
    """Return the landmarks (68, 2), in iBUG order, of a face that looks at the viewer, from its template (189, 2).

    They are spread along the curves of the template.
    """
    left, right = (points[list(side)] for side in _SIDES_OF_BRIDGE)
    middle = np.concatenate([(left + right) / 2.0, points[[_UNDER_NOSE]]])
    first, last = _BRIDGE_ENDS
    middle[0] += first * (middle[1] - middle[0])
    middle[-1] = middle[-2] + last * (middle[-1] - middle[-2])
    jaw = [_spread(points[list(half)], 9) for half in _EAR_TO_CHIN]
    beside = [_spread(points[list(curve)], 3) for curve in _NOSTRILS]
    upper, lower = points[list(_UPPER_INNER_LIP)], points[list(_LOWER_INNER_LIP)]
    corners = points[[_OUTER_LIPS[0], _OUTER_LIPS[6]]]
    inner = corners + _INNER_CORNER * ((upper[[0, -1]] + lower[[-1, 0]]) / 2.0 - corners)
    return np.concatenate(
        [
            *(jaw[0], jaw[1][-2::-1]),
            *(_spread(points[list(brow)], 5) for brow in _BROWS),
            _spread(middle, 4),
            *(beside[0], beside[1][1:]),
            *(_eye(points, *lids) for lids in zip(_UPPER_LIDS, _LOWER_LIDS, strict=True)),
            points[list(_OUTER_LIPS)],
            *(inner[:1], upper[1:-1], inner[1:], lower[1:-1]),
        ]
    )


def _eye(points: np.ndarray, upper: Sequence[int], lower: Sequence[int]) -> np.ndarray:
    """Landmarks of an eye: along its upper lid, then back along its lower one."""
    return np.concatenate([_spread(points[list(upper)], 4), _spread(points[list(lower)], 4)[2:0:-1]])


def _spread(curve: np.ndarray, count: int) -> np.ndarray:
    """Points at equal distances along a polyline (n, 2), from its first to its last point, (count, 2)."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    wanted = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(wanted, along, axis) for axis in curve.T], axis=1)


def reduced(image: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a large photo (H, W, 3) to its face, and reduce it to at most 640 pixels in width and height.

    Returns that photo and the landmarks (68, 2) in its pixels.
    """
    if max(image.shape[:2]) <= LARGEST_SIDE:
        return image, landmarks
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    reach = 0.5 * _MARGIN * float((high - low).max())
    middle, size = (low + high) / 2.0, np.array(image.shape[1::-1])
    left, top = np.clip(np.floor(middle - reach), 0, size - 1).astype(int)
    right, bottom = np.clip(np.ceil(middle + reach), [left + 1, top + 1], size).astype(int)
    cut = image[top:bottom, left:right]
    share = min(1.0, LARGEST_SIDE / max(cut.shape[:2]))
    shape = tuple(max(1, round(side * share)) for side in cut.shape[1::-1])
    scale = np.array(shape) / cut.shape[1::-1]
    # The middle of the first pixel is (0, 0) before and after.
    return cv2.resize(cut, shape, interpolation=cv2.INTER_AREA), (landmarks - (left, top) + 0.5) * scale - 0.5


def convert(photos: Sequence[Path], folder: Path, label: Label) -> tuple[int, list[str]]:
    """Write photos and landmarks as `images` and `landmarks68.npz` in `folder`; a clip is every third of its frames.

    Returns how many there are, and what is left out, and why. `label` returns the landmarks (68, 2) of a picture
    without a template; NaN if it finds no face. Raises OSError if a file cannot be written.
    """
    names, every, left_out = [], [], []
    (folder / "images").mkdir(parents=True, exist_ok=True)
    pictures = ((path, *picture) for path in photos for picture in _pictures(path))
    for path, name, picture in pictures:
        try:
            image, landmarks = reduced(*_labelled(path, picture, label))
        except ValueError as error:
            left_out.append(f"{name} is left out: {error}")
            continue
        names.append(f"{Path(name).stem}.jpg")
        if not cv2.imwrite(str(folder / "images" / names[-1]), image, [cv2.IMWRITE_JPEG_QUALITY, 95]):
            raise OSError(f"{folder / 'images' / names[-1]} cannot be written")
        every.append(landmarks)
        print(f"\r{len(names)} pictures", end="", file=sys.stderr)
    print(file=sys.stderr)
    if names:
        np.savez_compressed(folder / "landmarks68.npz", names=np.array(names), pts68=np.array(every).astype(np.float32))
    return len(names), left_out


def _pictures(path: Path) -> Iterator[tuple[str, np.ndarray | None]]:
    """A photo, or frames of a clip, with their names; None for what cannot be read."""
    if path.suffix.lower() not in _CLIPS:
        yield path.name, cv2.imread(str(path))
        return
    clip, number = cv2.VideoCapture(str(path)), 0
    if not clip.isOpened():
        yield path.name, None
    while (read := clip.read())[0]:
        if number % EVERY == 0:
            yield f"{path.stem}_{number:04d}", read[1]
        number += 1


def _labelled(path: Path, picture: np.ndarray | None, label: Label) -> tuple[np.ndarray, np.ndarray]:
    """A picture and its landmarks (68, 2)."""
    if picture is None:
        raise ValueError("it is not an image")
    template = path.with_suffix(".tem")
    landmarks = landmarks_of_template(read_template(template.read_text())) if template.exists() else label(picture)
    if not np.isfinite(landmarks).all():
        raise ValueError("MediaPipe finds no face")
    return picture, landmarks


def _by_mediapipe() -> Label:
    """Return the function that labels photos without a template; MediaPipe is loaded by the first of them."""
    made: list[Label] = []

    def label(image: np.ndarray) -> np.ndarray:
        from lab.bench.peers.mediapipe478 import VERTICES_68, MediaPipe

        if not made:
            try:
                made.append(MediaPipe(VERTICES_68).locate)
            except ImportError as error:
                raise SystemExit(
                    "A photo has no template, and MediaPipe is not installed. Run `make build/peers/.ready`, and use "
                    "build/peers/bin/python."
                ) from error
        return made[0](image)

    return label


def main() -> int:
    """Convert the photos or clips of a folder; return the exit status."""
    command = argparse.ArgumentParser(prog="python -m lab.training.faces", description=__doc__.splitlines()[0])
    command.add_argument("folder", type=Path, help="folder of the photos or clips")
    command.add_argument("set", choices=(*HAND_LABELLED, *AUTOMATIC, CLIPS), help="the set that they belong to")
    command.add_argument("--pattern", default="*.jpg", help="names to use, such as *_03.jpg (all)")
    add_data_option(command)
    arguments = command.parse_args()
    photos = sorted(arguments.folder.glob(arguments.pattern))
    if not photos:
        command.error(f"There is no {arguments.pattern} in {arguments.folder}. Name the folder of the photos.")
    folder = arguments.data / "faces" / arguments.set
    try:
        pictures, left_out = convert(photos, folder, _by_mediapipe())
    except OSError as error:
        command.error(f"{error}. Choose another folder by --data.")
    print(*left_out, f"{folder}: {pictures} pictures", sep="\n")
    return int(not pictures)


if __name__ == "__main__":
    sys.exit(main())

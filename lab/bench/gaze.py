"""Pupils of strangers compared with another program's: `build/peers/bin/python -m lab.bench.gaze CLIPS`.

MediaPipe's Face Mesh places the centres of irises as well. It is a reader, and not the truth: the same program on
mirrored images shows how far it agrees with itself. Each program's pupils are relative to its own corners of the eyes,
in widths of the eye, and to their median in a clip. The clips are divided by name into two halves of alternate clips:
what is chosen on one of them has to hold on the other.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import EYE_CORNERS
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.peers.mediapipe478 import MediaPipe
from lab.bench.report import Table, finish, parser

_CORNERS = (33, 133, 362, 263)
"""MediaPipe's corners of the eyes, from the viewer's left to the right."""
_CENTRES = (468, 473)
_MOST, _FEWEST = 450, 30
"""Frames of a clip that are compared at most, and at least."""
_FAR = 0.12
"""Distance in widths of the eye, about 15 degrees, from which a pupil counts as misplaced."""
_OURS, _MIRRORED = "Facemime", "MediaPipe, mirrored"


def main() -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("clips", type=Path)
    arguments = command.parse_args()
    tracker, peers = FaceTracker.load(), [MediaPipe((*_CORNERS, *_CENTRES)) for _ in range(2)]
    clips = sorted(path for path in arguments.clips.iterdir() if not path.name.startswith("."))
    measured = {path.stem: of_clip for path in clips if (of_clip := compare(path, tracker, *peers))}
    names = sorted(measured)
    halves = {"A": names[::2], "B": names[1::2]}
    rows = [
        (who, *(" / ".join(_figure(measured, halves[half], who, k) for half in halves) for k in range(4)))
        for who in (_OURS, _MIRRORED)
    ]
    columns = ("pupils", "across, rms", "down, rms", "correlation, across", "misplaced, %")
    finish(arguments, [Table("Pupils of strangers", columns, rows)], {"halves": halves, "clips": measured})
    return 0


def compare(path: Path, tracker: FaceTracker, peer: MediaPipe, flipped: MediaPipe) -> dict[str, list[float]]:
    """Figures of our pupils, and of those of the other program on mirrored images; none if too few are seen."""
    tracker.reset()
    peer.reset()
    flipped.reset()
    read: dict[str, list[np.ndarray]] = {"theirs": [], _OURS: [], _MIRRORED: []}
    for image in _frames(path):
        result = tracker.track(image)
        theirs, mirrored = peer.track(image), flipped.track(np.ascontiguousarray(image[:, ::-1]))
        mirrored = mirrored[[3, 2, 1, 0, 5, 4]] * (-1.0, 1.0)
        ours = np.concatenate([result.landmarks[EYE_CORNERS], result.pupils])
        for name, points in (("theirs", theirs), (_OURS, ours), (_MIRRORED, mirrored)):
            read[name].append(_relative(points))
    places = {name: np.array(rows) for name, rows in read.items()}
    seen = np.all([np.isfinite(rows).all(axis=(1, 2)) for rows in places.values()], axis=0)
    if seen.sum() < _FEWEST:
        return {}
    return {name: _differences(places[name][seen], places["theirs"][seen]) for name in (_OURS, _MIRRORED)}


def _frames(path: Path) -> Iterator[np.ndarray]:
    video = cv2.VideoCapture(str(path))
    for _ in range(_MOST):
        read, image = video.read()
        if not read:
            return
        yield image


def _relative(points: np.ndarray) -> np.ndarray:
    """Places of the pupils (2, 2), across and down, for the corners of both eyes and the pupils (6, 2)."""
    corners, pupils = points[:4].reshape(2, 2, 2), points[4:]
    across = corners[:, 1] - corners[:, 0]
    away = pupils - corners.mean(axis=1)
    size = np.square(across).sum(axis=1)
    down = away[:, 1] * across[:, 0] - away[:, 0] * across[:, 1]
    return np.stack([(away * across).sum(axis=1), down], axis=1) / size[:, None]


def _differences(one: np.ndarray, other: np.ndarray) -> list[float]:
    """Rms difference across and down, correlation of the eyes' mean across, and percentage of misplaced pupils."""
    apart = one - other
    apart -= np.median(apart, axis=0)
    rms = np.sqrt(np.square(apart).mean(axis=(0, 1)))
    together = float(np.corrcoef(one[..., 0].mean(axis=1), other[..., 0].mean(axis=1))[0, 1])
    return [*rms.tolist(), together, 100.0 * float((np.linalg.norm(apart, axis=2) > _FAR).mean())]


def _figure(measured: Mapping[str, Mapping[str, list[float]]], names: list[str], who: str, k: int) -> str:
    """Mean over the clips of a half; the median for correlations, which mean nothing where eyes rest."""
    values = [measured[name][who][k] for name in names]
    return f"{np.median(values) if k == 2 else np.mean(values):.3g}"


if __name__ == "__main__":
    sys.exit(main())

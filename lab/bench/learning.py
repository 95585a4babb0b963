"""Learning of the performer in a live session, on rendered clips of held-out people: `python -m lab.bench.learning`.

Each clip lasts six seconds and is repeated as if seen by a camera, from five starts: at rest, in a smile, before
speech, and so on. At each start the neutral face is that of the first second, as in a live session. Its error is
measured against the mean of the tracked frames that truly show no expression; lids are those of the avatar in the
middle of true blinks.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import INNER, lid_gaps
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.learning import PerformerLearner
from facemime.core.puppet.performer import NeutralCalibration
from facemime.core.takes.neutral import Neutral
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.exact import FPS, ExactFaces, performed
from lab.bench.report import Table, finish, people_parser

PEOPLE = 6
_STARTS = (0, 30, 60, 90, 120)
_WHEN = {"first second": 1.0, "after 5 s": 5.0, "after 10 s": 10.0, "after 20 s": 20.0, "after 60 s": 60.0}
_CALM, _SHUT = 0.02, 0.98
"""Largest expression of a frame at rest, and smallest `eyeBlink` in the middle of a blink."""


@dataclass(frozen=True)
class Errors:
    """Distance of the neutral face from the true one, % of the eye distance, and opening of shut eyes, % of rest."""

    neutral: float
    lids: float


def measure(results: Sequence[TrackResult], start: int, driver: HeadDriver) -> dict[str, Errors]:
    """Play a clip from a start, and measure the neutral face at each time of `_WHEN`."""
    shown = [performed(frame) for frame in range(len(results))]
    at_rest = [r.shape for r, a in zip(results, shown, strict=True) if r.found and max(a.values()) < _CALM]
    blinks = [r for r, a in zip(results, shown, strict=True) if r.found and a["eyeBlink"] > _SHUT]
    true = np.mean(at_rest, axis=0)
    first, learner, out = NeutralCalibration(asked=False), None, {}
    for count in range(int(max(_WHEN.values()) * FPS) + 2):
        time, result = count / FPS, results[(start + count) % len(results)]
        if learner is not None:
            learner.add(time, result)
        elif (result.found or len(first)) and first.add(time, result):
            learner = PerformerLearner(first.neutral())
        for name, when in _WHEN.items():
            if learner is not None and name not in out and time >= when:
                out[name] = _errors(learner.neutral, true, blinks, driver)
    return out


def _errors(neutral: Neutral, true: np.ndarray, blinks: Sequence[TrackResult], driver: HeadDriver) -> Errors:
    own = HeadDriver(driver.rig, neutral, driver.options, reuse=driver)
    rest = lid_gaps(np.asarray(driver.rig.vertices, dtype=np.float64)[driver.rig.landmarks])
    gaps = [lid_gaps(own.frame(result).vertices[driver.rig.landmarks].astype(np.float64)) / rest for result in blinks]
    off = np.linalg.norm(neutral.shape - true, axis=1)[INNER].mean()
    return Errors(100.0 * float(off), 100.0 * float(np.mean(gaps)))


def main() -> None:
    """Track, learn, and print."""
    options = people_parser(__doc__.splitlines()[0], PEOPLE).parse_args()
    cv2.setNumThreads(1)
    faces, tracker = ExactFaces(options.data, options.people), FaceTracker.load()
    runs = []
    for person in range(faces.people):
        tracker.reset()
        results = [tracker.track(image) for image in faces.clip(person).frames]
        found = NeutralCalibration(asked=False)
        while not found.add(len(found) / FPS, results[len(found)]):
            pass
        driver = HeadDriver(built_in_head(), found.neutral())
        runs += [measure(results, start, driver) for start in _STARTS]
    rows: list[list[object]] = []
    for name in _WHEN:
        neutral, lids = (np.array([getattr(run[name], what) for run in runs]) for what in ("neutral", "lids"))
        rows.append([name, float(neutral.mean()), float(neutral.max()), float(lids.mean()), float(lids.max())])
    columns = ["time", "error of the neutral face, %", "worst, %", "opening of shut eyes, %", "worst, %"]
    finish(options, [Table("Learning", columns, rows)], {str(row[0]): row[1:] for row in rows})


if __name__ == "__main__":
    sys.exit(main())

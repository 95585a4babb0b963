"""Accuracy of ARKit's coefficients, on the sample clip and rendered performances: `python -m lab.bench.coefficients`.

In the sample clip, the script of its performance is the truth. The other clips show held-out people with random
scripts, rendered at 12.5 frames per second. All are tracked end to end, with the neutral face that Facemime finds.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, FITTED
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import TakeRecorder, describe
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.report import Table, finish, people_parser
from lab.training.coefficients.performances import performer, tracked
from lab.training.data import ROOT
from lab.training.sample.performance import FPS, times, units_at
from lab.training.tracker.heads import load_ict
from lab.training.tracker.sources import HAND_LABELLED, read_photos, split

PEOPLE, _SECONDS, _FPS = 24, 16.0, 12.5
_ACTED, _SPURIOUS, _SHOWN = 0.05, 0.3, 0.3
"""Truth above which a coefficient counts as acted, value above which one that is not acted is spurious, and truth that
a coefficient has to reach in some frame for its figures to count."""


@dataclass(frozen=True)
class Performed:
    """Acted and found coefficients over all frames, (F, 52) each."""

    acted: np.ndarray
    found: np.ndarray

    @property
    def shown(self) -> list[int]:
        """Columns of the coefficients that are acted in some frame."""
        return [int(k) for k in FITTED if self.acted[:, k].max() > _SHOWN]

    def correlation(self, k: int) -> float:
        """Pearson correlation over the frames; 0 if the coefficient is never found."""
        found, acted = self.found[:, k], self.acted[:, k]
        return float(np.corrcoef(found, acted)[0, 1]) if found.std() > 0.0 else 0.0

    def error(self, k: int) -> float:
        """Mean absolute error in the frames in which the coefficient is acted."""
        on = self.acted[:, k] > _ACTED
        return float(np.abs(self.found[on, k] - self.acted[on, k]).mean())

    def spurious(self, k: int) -> float:
        """Share of frames in which the coefficient is found but not acted."""
        return float(((self.acted[:, k] < _ACTED) & (self.found[:, k] > _SPURIOUS)).mean())


def sample(tracker: FaceTracker, path: Path) -> Performed:
    """The sample clip and its script, whose units exceed 1, unlike coefficients."""
    video, recorder = cv2.VideoCapture(str(path)), TakeRecorder(describe("sample", FPS, (1, 1), tracker.model_id))
    tracker.reset()
    acted = np.zeros((len(times()), len(COEFFICIENTS)))
    for frame, time in enumerate(times()):
        recorder.append(time, tracker.track(video.read()[1]))
        for name, amount in units_at(time).items():
            acted[frame, COEFFICIENT_INDEX[name]] = min(amount, 1.0)
    take = recorder.finish()
    return Performed(acted[take.found], arkit_coefficients(take, calibrate(take)))


def rendered(tracker: FaceTracker, data: Path, people: int) -> Performed:
    """Random scripts of held-out people, spread evenly over the people."""
    head, photos = load_ict(data), split(read_photos(data, *HAND_LABELLED))[1]
    acted, found = [], []
    for number, i in enumerate(np.linspace(0, len(photos) - 1, people).round().astype(int)):
        take, keys = tracked(tracker, performer(head, tracker.pdm, photos[i], number), _SECONDS, _FPS)
        acted.append(keys[take.found])
        found.append(arkit_coefficients(take, calibrate(take)))
    return Performed(np.concatenate(acted), np.concatenate(found))


def summary(name: str, performed: Performed) -> list[object]:
    """A row of a table: frames, and the three figures over the coefficients."""
    shown = performed.shown
    return [
        name,
        len(performed.acted),
        float(np.mean([performed.correlation(k) for k in shown])),
        float(np.mean([performed.error(k) for k in shown])),
        float(sum(performed.spurious(int(k)) for k in FITTED)),
    ]


def rows_of(clips: dict[str, Performed]) -> list[list[object]]:
    """Rows for all coefficients: correlation and error of each clip, and the share of spurious frames."""
    rows: list[list[object]] = []
    for k in FITTED.tolist():
        row: list[object] = [COEFFICIENTS[k]]
        for clip in clips.values():
            row += [clip.correlation(k), clip.error(k)] if k in clip.shown else ["", ""]
            row.append(clip.spurious(k))
        rows.append(row)
    return rows


def main() -> None:
    """Render, track, and print."""
    options = people_parser(__doc__.splitlines()[0], PEOPLE).parse_args()
    cv2.setNumThreads(1)
    tracker = FaceTracker.load()
    clips = {"sample": sample(tracker, ROOT / "assets" / "sample" / "sample.mp4")}
    clips["rendered"] = rendered(tracker, options.data, options.people)
    figures = [summary(name, clip) for name, clip in clips.items()]
    columns = ["clip", "frames", "correlation", "acted error", "spurious per frame"]
    each = [
        "coefficient",
        *(f"{name}: {what}" for name in clips for what in ("correlation", "acted error", "spurious")),
    ]
    tables = [Table("Coefficients", columns, figures), Table("By coefficient", each, rows_of(clips))]
    numbers = {str(row[0]): dict(zip(columns[1:], row[1:], strict=True)) for row in figures}
    finish(options, tables, numbers)


if __name__ == "__main__":
    sys.exit(main())

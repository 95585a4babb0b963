"""Accuracy of actions that no landmark shows, on rendered clips of held-out people: `python -m lab.bench.actions`.

Each person rests, then shows one action after the other while the head moves a little: the tongue, puffed cheeks,
pressed lips and so on, separately on each side if there are two, and crossed eyes. The clip is tracked end to end, and
the activations of the avatar, with the neutral face that Facemime finds, are compared with the exact truth. The area
under the curve (AUC) is the share of pairs of frames, one with the action above half and one without it, in which the
former has the higher measured activation.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facemime.core.drive.actions import ActionDriver
from facemime.core.face.names import ACTIONS, N_ACTIONS
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import TakeRecorder, describe
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.exact import FPS, ExactFaces
from lab.bench.report import Table, finish, people_parser

PEOPLE = 12
_ON, _OFF = 0.5, 0.1
_CROSSED, _PARALLEL = np.radians((15.0, 3.0))


@dataclass(frozen=True)
class Seen:
    """True, measured and shown activations over the frames of all people, (F, 15), the measured ones above rest; and
    vergence in radians, (F,).
    """

    truth: np.ndarray
    measured: np.ndarray
    shown: np.ndarray
    true_vergence: np.ndarray
    vergence: np.ndarray


def auc(measured: np.ndarray, shown: np.ndarray, absent: np.ndarray) -> float:
    """Share of pairs of a frame in `shown` (F,) and one in `absent` (F,) in the right order; ties count half."""
    on, off = np.sort(measured[shown]), measured[absent]
    below, upto = np.searchsorted(on, off, "left"), np.searchsorted(on, off, "right")
    return float(1.0 - (0.5 * (below + upto)).mean() / len(on))


def track(faces: ExactFaces) -> Seen:
    """Track the acting clips of all people."""
    tracker, parts = FaceTracker.load(), []
    for person in range(faces.people):
        tracker.reset()
        clip, recorder = faces.acting(person), TakeRecorder(describe("acting", FPS, (1, 1), tracker.model_id))
        for frame, image in enumerate(clip.frames):
            recorder.append(frame / FPS, tracker.track(image))
        take = recorder.finish()
        neutral = calibrate(take)
        driver = ActionDriver(neutral.actions, neutral.shape)
        results = [take.result(frame) for frame in range(len(take))]
        above, shown = (
            np.array([measure(result.actions, result.shape) for result in results])
            for measure in (driver.above_rest, driver.activations)
        )
        parts.append((clip.actions, above, shown, clip.vergence, take.vergence - neutral.vergence))
    return Seen(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def rows_of(seen: Seen) -> list[list[object]]:
    """A row per action, and one for crossed eyes."""
    rows: list[list[object]] = []
    for k, name in enumerate(ACTIONS):
        truth, measured, shown = seen.truth[:, k], seen.measured[:, k], seen.shown[:, k]
        on, off = truth > _ON, truth < _OFF
        rows.append(
            [name, int(on.sum()), auc(measured, on, off), float(shown[truth > 0.95].mean()), float(shown[off].mean())]
        )
    known = np.isfinite(seen.vergence)
    on, off = known & (seen.true_vergence > _CROSSED), known & (np.abs(seen.true_vergence) < _PARALLEL)
    angles = np.degrees(seen.vergence)
    rows.append(
        [
            "crossed eyes",
            int(on.sum()),
            auc(seen.vergence, on, off),
            f"{angles[on].mean():.0f}°",
            f"{angles[off].mean():.0f}°",
        ]
    )
    return rows


def main() -> None:
    """Render, track, and print."""
    arguments = people_parser(__doc__.splitlines()[0], PEOPLE)
    arguments.add_argument("--sheet", type=Path, metavar="FILE.png", help="write a frame of each action")
    options = arguments.parse_args()
    cv2.setNumThreads(1)
    faces = ExactFaces(options.data, options.people)
    rows = rows_of(track(faces))
    columns = ["action", "frames", "AUC", "avatar at 1", "avatar at 0"]
    numbers = {str(row[0]): row[2] for row in rows}
    if options.sheet is not None:
        clip = faces.acting(0)
        best = [clip.frames[int(np.argmax(clip.actions[:, k]))] for k in range(N_ACTIONS)]
        best.append(clip.frames[int(np.argmax(clip.vergence))])
        cv2.imwrite(str(options.sheet), np.vstack([np.hstack(best[i : i + 8]) for i in (0, 8)]))
    finish(options, [Table("Actions", columns, rows)], numbers)


if __name__ == "__main__":
    sys.exit(main())

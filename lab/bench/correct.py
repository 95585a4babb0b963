"""Effect of pins on the frames around them, on rendered clips with exact landmarks: `python -m lab.bench.correct`.

A simulated user puts one group of landmarks in its true places in a few frames: those with its largest error, at least
a third of a second apart, or the most doubtful ones. The error in all other frames is compared with that before. The
group is the one that is tracked worst, relative to its usual error. Every second person is of half A, on which
constants were chosen; the others are of half B. Figures are given as A / B. How far features move, relative to the
truth, is measured as well.
"""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from facemime.core.face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, JAW, LIPS
from facemime.core.face.rotation import euler_to_matrices
from facemime.core.numeric import linalg
from facemime.core.takes.correction import learn, solve_pins
from facemime.core.takes.learnt import corrected_result
from facemime.core.takes.pin_editor import doubtful_frames, uncertainty
from facemime.core.takes.pins import LEARN, Pin, with_pins
from facemime.core.takes.take import Take, TakeRecorder, describe
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.exact import FPS, SIZE, ExactFaces
from lab.bench.expressions import THRESHOLDS, components
from lab.bench.report import Table, finish, people_parser

PEOPLE = 12
GROUPS = {
    **{"right brow": BROWS[:5], "left brow": BROWS[5:], "right eye": EYE_RIGHT, "left eye": EYE_LEFT},
    **{"lips": LIPS, "jaw": JAW},
}
_USUAL = {"right brow": 1.0, "left brow": 1.0, "right eye": 0.5, "left eye": 0.5, "lips": 0.6, "jaw": 2.0}
"""Usual errors of the groups, relative to that of the brows."""
_COUNTS = (0, 1, 3, 10)
"""Numbers of frames with pins."""
_APART = 8
"""Least number of frames between two frames with pins."""
_RISE = 1.05
"""Share of the error before above which a group counts as worse."""
_FIRST = 5
"""Number of doubtful frames that a user looks at."""
_ROUNDS = 300
"""Number of timed results."""

Errors = dict[str, np.ndarray]
Chooser = Callable[[np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class Performer:
    """A tracked clip, its true landmarks (N, 66, 2), the errors (N,) of each group, and milliseconds per frame."""

    take: Take
    truth: np.ndarray
    errors: Errors
    milliseconds: float

    @property
    def worst(self) -> str:
        """The group that is tracked worst, relative to its usual error."""
        return max(GROUPS, key=lambda group: float(self.errors[group].mean()) / _USUAL[group])


@dataclass(frozen=True)
class Effect:
    """Errors after pinning relative to those before: of the group in frames without and with pins, of the worst other
    group, and the error that is left, in % of the eye distance.
    """

    elsewhere: float
    pinned: float
    others: float
    left: float


def errors_of(take: Take, truth: np.ndarray) -> Errors:
    """Mean distance of the landmarks of each group from the true ones, (N,), in eye distances."""
    away = np.linalg.norm(take.landmarks - truth, axis=2) / take.pose[:, :1]
    return {name: away[:, group].mean(axis=1) for name, group in GROUPS.items()}


def largest(errors: np.ndarray, count: int) -> np.ndarray:
    """Frames of the largest errors (N,) that lie apart."""
    left, chosen = errors.copy(), []
    for _ in range(count):
        frame = int(left.argmax())
        chosen.append(frame)
        left[max(0, frame - _APART + 1) : frame + _APART] = -1.0
    return np.array(chosen, dtype=np.intp)


def pinned(take: Take, truth: np.ndarray, group: str, frames: np.ndarray) -> Take:
    """Return the take with a group of landmarks in its true places in some frames."""
    return with_pins(
        take,
        [Pin(float(take.times[f]), int(n), *truth[f, n].astype(float).tolist()) for f in frames for n in GROUPS[group]],
    )


def effect(performer: Performer, group: str, frames: np.ndarray, *, learns: bool) -> Effect:
    """Pin a group in some frames, and measure."""
    take, before = pinned(performer.take, performer.truth, group, frames), performer.errors
    after = errors_of(solve_pins(replace(take, info={**take.info, LEARN: learns})), performer.truth)
    free = np.setdiff1d(np.arange(len(take)), frames)
    rises = {name: float(after[name][free].mean() / before[name][free].mean()) for name in GROUPS}
    shown = float(after[group][frames].mean() / before[group][frames].mean()) if len(frames) else np.nan
    others = max(rise for name, rise in rises.items() if name != group)
    return Effect(rises[group], shown, others, 100.0 * float(after[group][free].mean()))


def tracked(faces: ExactFaces, tracker: FaceTracker, person: int) -> Performer:
    """Track the clip of a person."""
    clip, spent = faces.clip(person), []
    tracker.reset()
    recorder = TakeRecorder(describe(clip.name, FPS, (SIZE, SIZE), tracker.model_id))
    for time, image in zip(clip.times.tolist(), clip.frames, strict=True):
        start = clock.perf_counter()
        recorder.append(time, tracker.track(image))
        spent.append(clock.perf_counter() - start)
    take = recorder.finish()
    return Performer(take, clip.landmarks, errors_of(take, clip.landmarks), 1000.0 * float(np.median(spent)))


def pair(halves: Iterable[Iterable[float]], digits: str = "{:.2f}", how: Callable[..., object] = np.median) -> str:
    """Text of a figure for both halves."""
    return " / ".join(digits.format(how(list(half))) for half in halves)


def by_count(halves: Sequence[Sequence[Performer]], user: str) -> Table:
    """Measure the worst group against the number of frames with pins."""
    rows: list[list[object]] = []
    for count in _COUNTS:
        for learns in (False, True) if count else (False,):
            measured = [
                [effect(one, one.worst, _chosen(one, one.worst, user, count), learns=learns) for one in half]
                for half in halves
            ]
            figures = partial(_figures, measured)
            rows.append([count, "yes" if learns else "no", figures("left"), figures("elsewhere")])
            rows[-1] += [figures("elsewhere", np.mean), figures("elsewhere", np.max)]
            rows[-1] += [figures("pinned") if count else "", figures("others", np.max)]
    columns = [
        "frames with pins",
        "learning",
        "error, %",
        "relative",
        "mean",
        "worst",
        "at pins",
        "other groups, worst",
    ]
    return Table(f"Pins in {user} frames", columns, rows)


def _chosen(performer: Performer, group: str, user: str, count: int) -> np.ndarray:
    if user == "the most doubtful":
        return doubtful_frames(performer.take)[:count]
    return largest(performer.errors[group], count)


def _figures(measured: Sequence[Sequence[Effect]], name: str, how: Callable[..., object] = np.median) -> str:
    return pair([[getattr(one, name) for one in half] for half in measured], how=how)


def by_group(halves: Sequence[Sequence[Performer]]) -> Table:
    """Measure every group of every person with three frames of pins and learning."""
    rows: list[list[object]] = []
    for group in GROUPS:
        measured = [[effect(one, group, largest(one.errors[group], 3), learns=True) for one in half] for half in halves]
        worse = [[float(one.elsewhere > _RISE) for one in half] for half in measured]
        figures = partial(_figures, measured, "elsewhere")
        rows.append([group, figures(), figures(np.mean), figures(np.max), pair(worse, "{:.0f}", np.sum)])
    return Table("Three frames with pins", ["group", "relative", "mean", "worst", "people worse by 5 %"], rows)


def by_doubt(halves: Sequence[Sequence[Performer]]) -> Table:
    """Measure how doubtful frames are related to true errors."""
    rank = linalg.part("stats").spearmanr
    rows: list[list[object]] = []
    for name, error in (("all groups", _mean_error), ("worst group", _worst_error)):
        ranks = [[float(rank(uncertainty(one.take), error(one))[0]) for one in half] for half in halves]
        first = [
            [float(error(one)[doubtful_frames(one.take)[:_FIRST]].mean() / error(one).mean()) for one in half]
            for half in halves
        ]
        rows.append([name, pair(ranks, how=np.mean), pair(ranks, how=np.min), pair(first, how=np.mean)])
    columns = ["error", "rank correlation", "lowest", f"error of the first {_FIRST}, relative"]
    return Table("Doubtful frames", columns, rows)


def _mean_error(performer: Performer) -> np.ndarray:
    return np.mean(list(performer.errors.values()), axis=0)


def _worst_error(performer: Performer) -> np.ndarray:
    """Error of the worst group, each relative to its median in the clip, (N,)."""
    return np.max([errors / np.median(errors) for errors in performer.errors.values()], axis=0)


def by_motion(halves: Sequence[Sequence[Performer]]) -> Table:
    """Measure how far features move relative to the truth, in images in which heads turn by little."""
    rows: list[list[object]] = []
    for name in THRESHOLDS:
        figures = [[_followed(one, name) for one in half] for half in halves]
        correlations, slopes = ([[one[which] for one in half] for half in figures] for which in (0, 1))
        rows.append([name, pair(correlations), pair(slopes)])
    return Table("Motion of landmarks, tracked and true", ["feature", "correlation", "slope"], rows)


def _followed(performer: Performer, name: str) -> tuple[float, float]:
    """Correlation and slope of a tracked feature against the true one, without what the head's rotation explains."""
    pose = performer.take.pose.astype(np.float64)
    turned = np.column_stack([np.ones(len(pose)), pose[:, 1:3], np.square(pose[:, 1:3])])
    upright = euler_to_matrices(np.column_stack([np.zeros((len(pose), 2)), -pose[:, 3]]))[:, :2, :2]
    moved = []
    for places in (performer.truth, performer.take.landmarks.astype(np.float64)):
        level = np.einsum("nij,nkj->nki", upright, places) / pose[:, 0, None, None]
        feature = components(level)[name]
        moved.append(feature - turned @ np.linalg.lstsq(turned, feature, rcond=None)[0])
    true, tracked = moved
    return float(np.corrcoef(true, tracked)[0, 1]), float(true @ tracked / (true @ true))


def live_share(performers: Sequence[Performer]) -> float:
    """Time of the correction of a live result by four parts, relative to a tracked frame."""
    one = performers[0]
    take = one.take
    for group in ("right brow", "left brow", "lips", "jaw"):
        pins = pinned(take, one.truth, group, largest(one.errors[group], 3))
        take = replace(take, info={**take.info, "pins": [*take.info.get("pins", []), *pins.info["pins"]]})
    learnt, result, spent = learn(take), take.result(0), []
    for _ in range(_ROUNDS):
        start = clock.perf_counter()
        corrected_result(result, learnt)
        spent.append(clock.perf_counter() - start)
    return 1000.0 * float(np.median(spent)) / float(np.median([one.milliseconds for one in performers]))


def main() -> None:
    """Track, pin, and print."""
    options = people_parser(__doc__.splitlines()[0], PEOPLE).parse_args()
    cv2.setNumThreads(1)
    faces, tracker = ExactFaces(options.data, options.people), FaceTracker.load()
    performers = [tracked(faces, tracker, person) for person in range(faces.people)]
    halves = performers[::2], performers[1::2]
    tables = [by_count(halves, "the worst"), by_count(halves, "the most doubtful"), by_group(halves), by_doubt(halves)]
    tables.append(by_motion(halves))
    share = live_share(performers)
    tables.append(Table("Live cost of what was learnt", ["relative to a tracked frame"], [[share]]))
    finish(options, tables, {table.title: [list(row) for row in table.rows] for table in tables})


if __name__ == "__main__":
    sys.exit(main())

"""How far a few examples bring a head towards another artist's shapes: `python -m lab.bench.teaching CLIPS`.

The truth is the same performance shown by keys that an artist made for the head: ICT-FaceKit's on its own head, and
those of the built-in head, mixed by ARKit's coefficients of the take. In each clip, *Suggest Frames* chooses the frames
in which the head is given the artist's shape; the error is measured in all frames. The clips are divided by name into
two halves of alternate clips: what was chosen on half A, the kernel and its width, has to hold on half B.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.teaching import doubts_of, suggest_frames
from facemime.core.errors import FacemimeError
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.heads.style import Example, Style
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.take import Take
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.expressions import take_of
from lab.bench.heads import TrueHead, ict_head, true_built_in_head
from lab.bench.report import Table, finish, parser
from lab.training.data import add_data_option

EXAMPLES = (0, 1, 3, 10)
_FRAMES = 300
"""Largest number of frames of a clip."""
_FEWEST = 20
"""Smallest number of frames with a face."""
_ROUNDS = 5


@dataclass(frozen=True)
class Shown:
    """A clip as a head shows it.

    Attributes
    ----------
    errors : dict of int to float
        Mean error of the vertices of the regions in all frames, for each number of examples, in eye distances.
    later : float
        The error in the second half of the frames, with ten examples of the first half.
    untaught : float
        The same without examples.
    """

    errors: dict[int, float]
    later: float
    untaught: float


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    add_data_option(command)
    command.add_argument("clips", type=Path, nargs="+", metavar="CLIPS", help="folders with clips")
    command.add_argument(
        "--takes", type=Path, default=Path("build/bench/teaching"), help="folder in which takes are cached"
    )
    arguments = command.parse_args()
    paths = sorted((path for folder in arguments.clips for path in folder.iterdir()), key=lambda path: path.name)
    takes = list(_takes(paths, arguments.takes))
    halves = {"A": takes[::2], "B": takes[1::2]}
    shown, costs = {}, []
    for head in (ict_head(arguments.data), true_built_in_head()):
        driver = HeadDriver(head.rig, takes[0].neutral)
        for half, chosen in halves.items():
            shown[head.title, half] = [_shown(head, take, driver) for take in chosen]
        costs.append((head.title, *_cost(head, takes[0], driver)))
    rows = [
        (
            *(title, half, len(clips), 100.0 * _mean(clip.errors[0] for clip in clips)),
            *(_ratio(clips, count) for count in EXAMPLES[1:]),
            sum(clip.later for clip in clips) / sum(clip.untaught for clip in clips),
        )
        for (title, half), clips in shown.items()
    ]
    columns = ("head", "half", "clips", "error without, %", *(f"with {count}" for count in EXAMPLES[1:]))
    tables = [
        Table(
            "Error to another artist's shapes, relative to that without examples",
            (*columns, "ten of the first half, in the second"),
            rows,
        ),
        Table(
            "Time of a frame with ten examples, relative to that without",
            ("head", "ratio", "added, ms"),
            costs,
        ),
    ]
    finish(arguments, tables, {f"{title}, half {half}": _ratio(clips, 10) for (title, half), clips in shown.items()})
    return 0


def _takes(paths: list[Path], folder: Path) -> Iterator[Performance]:
    """Track clips, or read their takes, and prepare those in which a face can be calibrated."""
    tracker = FaceTracker.load()
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        take = take_of(path, tracker, folder)
        print(path.name, file=sys.stderr)
        try:
            performance = Performance.of(take.part(slice(_FRAMES)), PuppetSettings())
        except FacemimeError as error:
            print(error, file=sys.stderr)
            continue
        if int(performance.take.found.sum()) >= _FEWEST:
            yield performance


@dataclass(frozen=True)
class Acted:
    """N frames of a take, and the true shapes (N, V, 3) of a head in them."""

    take: Take
    frames: np.ndarray
    true: np.ndarray

    @property
    def results(self) -> list[TrackResult]:
        """What was tracked in the frames."""
        return [self.take.result(int(frame)) for frame in self.frames]

    def part(self, rows: slice) -> Acted:
        """Some of the frames."""
        return Acted(self.take, self.frames[rows], self.true[rows])

    @classmethod
    def of(cls, head: TrueHead, performance: Performance, rest: np.ndarray) -> Acted:
        """Every second frame of a performance, and what the keys of a head show, which rests at `rest` (V, 3)."""
        take = performance.take
        weights = _weights(head, arkit_coefficients(take, performance.neutral))
        return cls(take, np.flatnonzero(take.found), rest + head.true(weights)).part(slice(None, None, 2))


def _shown(head: TrueHead, performance: Performance, reuse: HeadDriver) -> Shown:
    driver = HeadDriver(reuse.rig, performance.neutral, performance.settings, reuse=reuse)
    acted = Acted.of(head, performance, driver.rest)
    half = len(acted.frames) // 2
    first, second = acted.part(slice(half)), acted.part(slice(half, None))
    return Shown(
        {count: _error(head, _taught(driver, acted, count), acted) for count in EXAMPLES},
        _error(head, _taught(driver, first, EXAMPLES[-1]), second),
        _error(head, driver, second),
    )


def _weights(head: TrueHead, coefficients: np.ndarray) -> np.ndarray:
    """Weights (N, E) of the keys of a head for coefficients (N, 52); halves of a key are named _L and _R, too."""
    names = [name.replace("_L", "Left").replace("_R", "Right") for name in head.names]
    whole = [name if name in COEFFICIENT_INDEX else name.removesuffix("Left").removesuffix("Right") for name in names]
    return coefficients[:, [COEFFICIENT_INDEX[name] for name in whole]]


def _taught(driver: HeadDriver, acted: Acted, count: int) -> HeadDriver:
    """Give a head the true shapes in at most `count` of the frames, which are suggested."""
    results = acted.results
    expressions = np.array([driver.expression(result) for result in results])
    rows = suggest_frames(expressions, doubts_of(acted.take, acted.frames), [], count)
    examples = [
        Example(str(row), "", expressions[row], driver.offsets(driver.frame(results[row]), acted.true[row]))
        for row in rows
    ]
    rig = replace(driver.rig, style=Style(tuple(examples)))
    return HeadDriver(rig, driver.neutral, driver.options, reuse=driver)


def _error(head: TrueHead, driver: HeadDriver, acted: Acted) -> float:
    """Mean distance of the vertices of the regions from the true shapes."""
    moved = head.regions.sum(axis=0) > 0.0
    away = (driver.frame(result).vertices - wanted for result, wanted in zip(acted.results, acted.true, strict=True))
    return _mean(float(np.linalg.norm(one[moved], axis=1).mean()) for one in away)


def _ratio(clips: list[Shown], count: int) -> float:
    return sum(clip.errors[count] for clip in clips) / sum(clip.errors[0] for clip in clips)


def _cost(head: TrueHead, performance: Performance, reuse: HeadDriver) -> tuple[float, float]:
    """Time of a frame with ten examples relative to that without, and what they add in ms: the best of some rounds."""
    driver = HeadDriver(reuse.rig, performance.neutral, performance.settings, reuse=reuse)
    acted = Acted.of(head, performance, driver.rest)
    taught = _taught(driver, acted, EXAMPLES[-1])
    without, with_ten = (min(_seconds(one, acted.results) for _ in range(_ROUNDS)) for one in (driver, taught))
    return with_ten / without, 1e3 * (with_ten - without)


def _seconds(driver: HeadDriver, results: list[TrackResult]) -> float:
    started = perf_counter()
    for result in results:
        driver.frame(result)
    return (perf_counter() - started) / len(results)


def _mean(values: Iterator[float]) -> float:
    return float(np.mean(list(values)))


if __name__ == "__main__":
    sys.exit(main())

"""Effect of pins on clips labelled by hand: `python -m lab.bench.correct_labelled LABELS.csv NEUTRAL.csv CLIPS`.

Where the avatar is on the wrong side of rest in some labelled frames of a clip, a simulated user pins the landmarks of
that dimension in up to k of these, so that they show what the label says. Signs are compared before and after in the
labelled frames that have no pins, end to end (`lab.bench.expressions`): the pins' own labels are not counted.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from facemime.core.face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, LOWER_LIPS, MOUTH_CORNERS, from_ibug
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.correction import solve_pins
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.pins import Pin, with_learning, with_pins
from facemime.core.takes.take import Take
from facemime.core.takes.timing import project
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.expressions import (
    THRESHOLDS,
    Clip,
    Features,
    features,
    is_right,
    read_clips,
    shown_features,
    take_of,
)
from lab.bench.report import Table, finish, parser

_UPWARDS = {
    **{"brow_l": BROWS[:5], "brow_r": BROWS[5:], "lid_l": EYE_RIGHT[1:3], "lid_r": EYE_LEFT[1:3]},
    **{"jaw": np.concatenate([LOWER_LIPS, from_ibug((55, 56, 57, 58, 59))]), "smile": MOUTH_CORNERS},
}
"""Landmarks that a user moves up or down; left and right are the image's."""
_SHOWN = 1.5
"""How much of a dimension the pins show where it is labelled, relative to its threshold."""
_COUNTS = (1, 3)
"""Largest numbers of frames with pins."""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("labels", type=Path)
    command.add_argument("neutral", type=Path)
    command.add_argument("clips", type=Path)
    command.add_argument(
        "--takes", type=Path, default=Path("build/bench/expressions"), help="folder in which takes are cached"
    )
    arguments = command.parse_args(argv)
    arguments.takes.mkdir(parents=True, exist_ok=True)
    tracker, rig = FaceTracker.load(), built_in_head()
    cases = []
    for clip in read_clips(arguments.labels, arguments.neutral, arguments.clips):
        take = take_of(clip.path, tracker, arguments.takes)
        before = _shown(rig, take)
        cases += [(clip, take, before, name) for name in (*_UPWARDS, "width") if _wrong(clip, before, name)]
    rows = [_row(rig, cases, count, learns=learns) for count in _COUNTS for learns in (False, True)]
    columns = (
        *("most frames with pins", "learning", "cases", "frames without pins", "right before", "right after"),
        *("better", "worse", "other dimensions before", "after"),
    )
    finish(arguments, [Table("Pins on labelled clips", columns, rows)], {})
    return 0


def _row(
    rig: HeadRig, cases: Sequence[tuple[Clip, Take, Features, str]], count: int, *, learns: bool
) -> tuple[object, ...]:
    """Pin each wrong dimension of each clip in up to `count` of its wrong frames, and count right signs elsewhere."""
    own, other = [], []
    for clip, take, before, name in cases:
        frames = _wrong(clip, before, name)[:count]
        after = _shown(rig, solve_pins(with_learning(with_pins(take, _pins(take, clip, name, frames)), learns)))
        for dimension in THRESHOLDS:
            values = [_signs(clip, one, dimension, frames) for one in (before, after)]
            (own if dimension == name else other).append(np.array(values, dtype=bool).reshape(2, -1))
    (was, now), (others_was, others_now) = np.concatenate(own, axis=1), np.concatenate(other, axis=1)
    shares = [float(right.mean()) for right in (was, now, others_was, others_now)]
    changed = int((now & ~was).sum()), int((was & ~now).sum())
    return count, "yes" if learns else "no", len(cases), len(was), *shares[:2], *changed, *shares[2:]


def _shown(rig: HeadRig, take: Take) -> Features:
    return shown_features(rig, Performance.of(take, PuppetSettings(smoothing=0.0)), take)[0]


def _labels(clip: Clip, name: str) -> Mapping[int, float]:
    return {frame: float(row[name]) for frame, row in clip.labels.items() if row[name] not in (".", "")}


def _signs(clip: Clip, shown: Features, name: str, pinned: Sequence[int]) -> list[bool]:
    """Whether the labelled frames without pins are on the right side of rest."""
    labels = _labels(clip, name).items()
    return [is_right(name, label, float(shown[name][frame])) for frame, label in labels if frame not in pinned]


def _wrong(clip: Clip, shown: Features, name: str) -> list[int]:
    """Labelled frames on the wrong side of rest, the farthest from their label first."""
    labels = _labels(clip, name)
    wrong = [
        f for f, label in labels.items() if np.isfinite(shown[name][f]) and not is_right(name, label, shown[name][f])
    ]
    return sorted(wrong, key=lambda frame: -abs(shown[name][frame] - _wanted(name, labels[frame])))


def _wanted(name: str, label: float) -> float:
    """What a dimension shows where it is labelled: a jaw that is labelled 1 is hardly open."""
    return _SHOWN * THRESHOLDS[name] * float(np.sign(label - (name == "jaw")) if name != "jaw" or label else 0.0)


def _pins(take: Take, clip: Clip, name: str, frames: Sequence[int]) -> list[Pin]:
    """Pins after which the tracked shape shows in some frames what they are labelled as."""
    rest, pins = calibrate(take).shape, []
    move = np.zeros_like(rest)
    if name == "width":
        move[MOUTH_CORNERS, 0] = (-0.5, 0.5)
    else:
        move[_UPWARDS[name], 1] = -1.0
    for frame in frames:
        shape = take.shape[frame].astype(np.float64)
        here, there = (float(features(one[None], rest)[name][0]) for one in (shape, shape + 0.01 * move))
        moved = 0.01 * (_wanted(name, _labels(clip, name)[frame]) - here) / (there - here) * move
        pose = take.pose[frame][None].astype(np.float64)
        places = take.landmarks[frame] + project(moved[None], pose)[0] - pose[0, 4:6]
        chosen = np.flatnonzero(move.any(axis=1))
        pins += [Pin(float(take.times[frame]), int(n), *places[n].astype(float).tolist()) for n in chosen]
    return pins


if __name__ == "__main__":
    sys.exit(main())

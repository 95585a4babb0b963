"""Agreement of the avatar with another reader on clips of strangers: `python -m lab.bench.strangers CLIPS PEER`.

PEER has an archive NAME.npz for each clip: `points` (N, 66, 3), pose-free landmarks, NaN where no face was found;
`blendshapes` (N, 52) and their `names`. The clips are divided by name into two halves of alternate clips: a rule that
was chosen on one of them has to hold on the other. `--ablate` shows, on each half, what every rule contributes.

*Within* a clip, the features of the driven built-in head are compared with those of the peer's landmarks (correlation
and slope, medians over the clips in which the peer sees motion). *Across* clips, they are compared with the peer's
coefficients by rank: these know no neutral face of the clip, so a wrong neutral face counts. *Shut* is the share of
frames with shut lips, by the peer, in which the avatar's are shut. ARKit's coefficients of both are compared both ways.
The peer is a reader, not the truth.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from facemime.core.bake import arkit
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.drive import retarget
from facemime.core.drive.driver import drive_take
from facemime.core.face.landmarks import LOWER_LIDS, LOWER_LIPS, UPPER_LIDS, UPPER_LIPS, outer_eye_distance
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes import face_space, neutral
from facemime.core.takes import rest as resting
from facemime.core.takes.face_space import load_face_space, without_similarity
from facemime.core.takes.neutral import calibrate, calmest
from facemime.core.takes.take import Take
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.expressions import THRESHOLDS, Features, features, take_of
from lab.bench.report import Table, finish, parser
from lab.training.patching import patched

MOVES = {
    **{"brow_l": 0.02, "brow_r": 0.02, "brow_in": 0.012, "lid_l": 0.12, "lid_r": 0.12},
    **{"jaw": 0.03, "smile": 0.02, "width": 0.03, "side": 0.015},
}
"""Standard deviation above which the peer sees a feature move in a clip."""
ACROSS: Mapping[str, tuple[str, float, tuple[str, ...]]] = {
    "brows up": ("brow", 1.0, ("browOuterUpLeft", "browOuterUpRight", "browInnerUp")),
    "brows down": ("brow", -1.0, ("browDownLeft", "browDownRight")),
    "blink": ("lid", 1.0, ("eyeBlinkLeft", "eyeBlinkRight")),
    "jaw": ("jaw", 1.0, ("jawOpen",)),
    "smile": ("smile", 1.0, ("mouthSmileLeft", "mouthSmileRight")),
    "pucker": ("width", -1.0, ("mouthPucker", "mouthFunnel")),
}
"""The feature, its sign, and the peer's coefficients, whose mean it is compared with."""
_SAMPLED = 100
"""Frames of each clip that are compared across clips."""
_FEWEST = 30
"""Smallest number of frames that both find in a clip."""
_PEER_SHUT = 0.0156
"""Gap of the peer's lips below which they are shut, in outer-eye distances."""
_STATED = 0.05
"""Standard deviation above which a coefficient of the peer's moves in a clip."""
_MOVING = 3
"""Smallest number of clips on each half in which the peer's moves, for a coefficient to have figures within clips."""
_SHUT = 0.03
"""Gap of the avatar's lips below which they are shut."""
_SHUT_LIDS = 0.1
"""Opening, relative to rest, below which the eyes of the driven head are shut."""
_KEYED = "head driven by its keys"
"""The rule of the built-in head whose ARKit keys are set to the coefficients."""
_ACTED = "its keys not brought nearer to its looks"
"""The same with the coefficients that were found to be acted."""
ABLATIONS: Mapping[str, Mapping[tuple[Any, str], Any]] = {
    "as it is": {},
    "neutral face not moved towards the mean": {(resting, "_TOWARDS_MEAN"): 0.0},
    "a third of the way": {(resting, "_TOWARDS_MEAN"): 1.0 / 3.0},
    "two thirds of the way": {(resting, "_TOWARDS_MEAN"): 2.0 / 3.0},
    "broad mouths not told to smile": {(face_space, "_ACTS"): 1e3},
    "brows as far as the rest": {(neutral, "_ACTED"): 1e-6},
    "frowns that last not told by their actions": {(resting, "_FROWN_DOWN"): -1.0, (resting, "_FROWN_IN"): -1.0},
    "frowns told by their actions alone": {(resting, "_LOW_COUNTS"): 0.0},
    "brows' doubt up to an activation of 0.3": {(neutral, "_ACTED"): 0.3},
    "brows' doubt up to an activation of 0.8": {(neutral, "_ACTED"): 0.8},
    "gap of shut lips not from the take": {(resting, "_MAX_SEALED"): 1e-6},
    "calmest moment without the brows' usual height": {(resting, "_USUAL"): 0.0},
    "calmest moment without the lids": {(resting, "_LIDS"): 0.0},
    "no expression removed from it": {(resting, "_WEAK"): 10.0},
    "every expression removed from it": {(resting, "_WEAK"): 0.0},
    "half a second of it": {(neutral, "_MOMENT"): 0.5},
    "lower lip not relative to the upper one": {(retarget, "_FACING_LIPS"): ()},
    "lips without gains": {(retarget, "_LIP_GAIN"): (1.0, 1.0)},
    "lips that are hardly parted not shut": {(retarget, "_LIPS_SHUT"): 1e-9},
    "wide mouths opened as far as small ones": {(retarget, "_WIDE_SHARE"): 1.0},
    "brows without a gain": {(retarget, "_BROW_GAIN"): 1.0},
    "brows tilted as tracked": {(retarget, "_BROW_TILT"): 0.0},
    "widest opening not stretched": {(neutral, "_MAX_GAIN"): 1.0},
}
"""Rules of the neutral face and of retargeting with the values that turn them off, or with others."""


@dataclass(frozen=True)
class Clip:
    """A clip as both read it: `seen` are the frames in which both find the face."""

    take: Take
    points: np.ndarray
    coefficients: Mapping[str, np.ndarray]
    seen: np.ndarray

    @property
    def sampled(self) -> np.ndarray:
        """About `_SAMPLED` of the frames `seen`."""
        return self.seen[:: max(1, len(self.seen) // _SAMPLED)]


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("clips", type=Path)
    command.add_argument("peer", type=Path)
    command.add_argument(
        "--takes", type=Path, default=Path("build/bench/strangers"), help="folder in which takes are cached"
    )
    command.add_argument("--ablate", action="store_true", help="measure each rule as well; 20 s each")
    arguments = command.parse_args(argv)
    arguments.takes.mkdir(parents=True, exist_ok=True)
    clips = read_clips(arguments.clips, arguments.peer, arguments.takes)
    names = sorted(clips)
    halves = {"A": names[::2], "B": names[1::2]}
    rig, rules = built_in_head(), ABLATIONS if arguments.ablate else {"as it is": {}}
    rest = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    measured: dict[str, dict[str, dict[str, Any]]] = {half: {} for half in halves}
    for rule, values in rules.items():
        with patched(values):
            shown = {name: driven(clip.take, rig) for name, clip in clips.items()}
        for half, chosen in halves.items():
            avatar = [(clips[name], shown[name], rest) for name in chosen]
            measured[half][rule] = {"across": across(avatar), "within": within(avatar), "shut": shut_lips(avatar)}
    mean = np.median(np.concatenate([clip.points[clip.sampled] for clip in clips.values()]), axis=0)
    for half, chosen in halves.items():
        for rule, face in simple_rules().items():
            shapes = [
                (clips[name], clips[name].take.shape.astype(np.float64), face(clips[name].take)) for name in chosen
            ]
            measured[half][rule] = {"across": across(shapes)}
        peers = [(clips[name], clips[name].points, mean) for name in chosen]
        measured[half]["the other program's landmarks, their mean"] = {"across": across(peers)}
    as_driven = {name: driven(clip.take, rig) for name, clip in clips.items()}
    stated: dict[str, dict[str, tuple[float, int, float, float]]] = {}
    for rule, values in ((_ACTED, {(arkit, "alike"): lambda coefficients, *_: coefficients}), (_KEYED, {})):
        with patched(values):
            found = {name: arkit_coefficients(clip.take, calibrate(clip.take)) for name, clip in clips.items()}
        keyed = {name: by_keys(clip.take, found[name]) for name, clip in clips.items()}
        for half, chosen in halves.items():
            avatar = [(clips[name], keyed[name], rest) for name in chosen]
            measured[half][rule] = {"across": across(avatar), "within": within(avatar), "shut": shut_lips(avatar)}
            measured[half][rule]["lids"] = shut_lids([(as_driven[name], keyed[name], rest) for name in chosen])
            stated[half] = stated_alike([(clips[name], found[name]) for name in chosen])
    tables = [*_tables(measured), _table_of_coefficients(list(stated.values()))]
    finish(arguments, tables, {"halves": halves, "measured": measured, "coefficients": stated})
    return 0


def read_clips(folder: Path, peer: Path, takes: Path) -> dict[str, Clip]:
    """Track the clips of `folder` that the peer has read, or read their takes from the folder `takes`."""
    tracker, clips = FaceTracker.load(), {}
    for path in sorted(peer.glob("*.npz")):
        video = next(iter(sorted(folder.glob(f"{path.stem}.*"))), None)
        if video is None:
            print(f"{path.stem} is left out: no such clip", file=sys.stderr)
            continue
        take = take_of(video, tracker, takes)
        with np.load(path) as archive:
            points, columns = archive["points"].astype(np.float64), archive["blendshapes"].astype(np.float64).T
            coefficients = dict(zip(map(str, archive["names"]), columns, strict=True))
        count = min(len(take), len(points))
        seen = np.flatnonzero(np.isfinite(points[:count, 0, 0]) & take.found[:count])
        if len(seen) < _FEWEST:
            print(f"{path.stem} is left out: both find a face in {len(seen)} frames", file=sys.stderr)
            continue
        clips[path.stem] = Clip(take, points, coefficients, seen)
    return clips


def driven(take: Take, rig: HeadRig) -> np.ndarray:
    """Landmarks (N, 66, 3) of the head that a take drives; NaN where no face was found."""
    performance = Performance.of(take, PuppetSettings(smoothing=0.0))
    shown = np.full((len(take), len(rig.landmarks), 3), np.nan)
    moved = drive_take(performance.driver(rig), take).vertices[:, rig.landmarks]
    shown[take.found] = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks] + moved
    return shown


def by_keys(take: Take, coefficients: np.ndarray) -> np.ndarray:
    """Landmarks (N, 66, 3) of the built-in head whose keys are set to the coefficients (F, 52) of the frames with a
    face; NaN elsewhere.
    """
    head = load_head()
    units = head.units[:, head.landmarks].astype(np.float64)
    shown = np.full((len(take), len(head.landmarks), 3), np.nan)
    shown[take.found] = head.vertices[head.landmarks] + np.tensordot(coefficients, units, 1)
    return shown


def simple_rules() -> dict[str, Callable[[Take], np.ndarray]]:
    """Rules that find a neutral face for the tracked shape: ours, and simpler ones."""
    mean = load_face_space().mean

    def calm(take: Take) -> np.ndarray:
        return calmest(take, prior=False).shape

    def half_way(take: Take) -> np.ndarray:
        face = calm(take)
        return np.asarray(face - 0.5 * without_similarity((face - mean)[None], mean)[0])

    return {
        "tracked shape, today's neutral face": lambda take: calibrate(take).shape,
        "tracked shape, calmest moment": calm,
        "tracked shape, half way from it to the mean face": half_way,
        "tracked shape, mean face of people": lambda take: mean,
        "tracked shape, median of the clip": lambda take: np.median(take.shape[take.found].astype(np.float64), axis=0),
    }


Read = tuple[Clip, np.ndarray, np.ndarray]
"""A clip, landmarks (N, 66, 3) that stand for it, and these at rest (66, 3)."""


def across(reads: Sequence[Read]) -> dict[str, float]:
    """Rank correlation of features with the peer's coefficients, over frames of all clips."""
    pooled: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in ACROSS}
    for clip, shown, rest in reads:
        frames = clip.sampled
        moved = features(shown, rest)
        both = {
            "brow": 0.5 * (moved["brow_l"] + moved["brow_r"]),
            "lid": 0.5 * (moved["lid_l"] + moved["lid_r"]),
            **moved,
        }
        for name, (feature, sign, columns) in ACROSS.items():
            pooled[name][0].extend(sign * both[feature][frames])
            pooled[name][1].extend(np.mean([clip.coefficients[column][frames] for column in columns], axis=0))
    return {name: float(np.corrcoef(rankdata(ours), rankdata(theirs))[0, 1]) for name, (ours, theirs) in pooled.items()}


def within(reads: Sequence[Read]) -> dict[str, tuple[int, float, float]]:
    """By feature: clips in which the peer sees it move, and their median correlation and slope."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in THRESHOLDS}
    for clip, shown, rest in reads:
        ours, theirs = _both(clip, shown, rest)
        for name, kept in found.items():
            one, other = ours[name], theirs[name]
            if other.std() > MOVES[name]:
                correlation = float(np.corrcoef(one, other)[0, 1]) if one.std() > 0.0 else 0.0
                kept.append((correlation, correlation * float(one.std() / other.std())))
    return {name: (len(kept), *np.median(kept, axis=0).tolist()) for name, kept in found.items() if kept}


def stated_alike(reads: Sequence[tuple[Clip, np.ndarray]]) -> dict[str, tuple[float, int, float, float]]:
    """Compare coefficients (F, 52) of the frames with a face with the peer's, by coefficient.

    The rank correlation over frames of all clips; the number of clips in which the peer's moves, and the medians over
    these of correlation and slope, NaN for none.
    """
    compared = {}
    for column, name in enumerate(COEFFICIENTS):
        if name not in reads[0][0].coefficients:
            continue
        within, pooled = [], []
        for clip, found in reads:
            ours = np.full(len(clip.take), np.nan)
            ours[clip.take.found] = found[:, column]
            theirs = clip.coefficients[name]
            pooled.append((ours[clip.sampled], theirs[clip.sampled]))
            one, other = ours[clip.seen], theirs[clip.seen]
            if other.std() > _STATED:
                correlation = float(np.corrcoef(one, other)[0, 1]) if one.std() > 0.0 else 0.0
                within.append((correlation, correlation * float(one.std() / other.std())))
        ranks = [rankdata(np.concatenate(values)) for values in zip(*pooled, strict=True)]
        medians = np.median(within, axis=0).tolist() if within else [np.nan, np.nan]
        compared[name] = (float(np.corrcoef(*ranks)[0, 1]), len(within), *medians)
    return compared


def shut_lips(reads: Sequence[Read]) -> float:
    """Share of the frames with shut lips, by the peer, in which the lips shown are shut."""
    shut: list[np.ndarray] = []
    for clip, shown, rest in reads:
        theirs = clip.points[clip.seen]
        apart = np.linalg.norm(theirs[:, UPPER_LIPS].mean(axis=1) - theirs[:, LOWER_LIPS].mean(axis=1), axis=1)
        ours = shown[clip.seen][apart < _PEER_SHUT]
        gap = ours[:, LOWER_LIPS, 1].mean(axis=1) - ours[:, UPPER_LIPS, 1].mean(axis=1)
        shut.append(gap / outer_eye_distance(rest) < _SHUT)
    return float(np.concatenate(shut).mean())


def shut_lids(shown: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[float]:
    """How far eyes stay open, relative to rest, where those of the driven head are shut: three quarters of them, and
    19 of 20, stay within these.

    Each clip has landmarks (N, 66, 3) of the driven head, those that are compared with them, and those at rest.
    """

    def opening(points: np.ndarray) -> np.ndarray:
        return (points[..., LOWER_LIDS, 1] - points[..., UPPER_LIDS, 1]).reshape(*points.shape[:-2], 2, 2).mean(axis=-1)

    left = [
        opening(keyed)[opening(by) < _SHUT_LIDS * opening(rest)] / opening(rest).mean() for by, keyed, rest in shown
    ]
    return np.quantile(np.maximum(np.concatenate(left), 0.0), (0.75, 0.95)).tolist()


def _both(clip: Clip, shown: np.ndarray, rest: np.ndarray) -> tuple[Features, Features]:
    """Features of both in the frames in which both find a face; the peer's are relative to the clip's median."""
    theirs = clip.points[clip.seen]
    return features(shown[clip.seen], rest), features(theirs, np.median(theirs, axis=0))


def _tables(measured: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[Table]:
    """Tables whose cells state the figure on each half."""
    halves = list(measured.values())
    across = [
        (rule, *(_both_halves(half[rule]["across"][name] for half in halves) for name in ACROSS), shut)
        for rule in halves[0]
        for shut in [_both_halves(half[rule]["shut"] for half in halves) if "shut" in halves[0][rule] else ""]
    ]
    yield Table("Across clips of strangers", ("rule", *ACROSS, "lips shut"), across)
    moving = [name for name in THRESHOLDS if all(name in half["as it is"]["within"] for half in halves)]
    within_rows = [
        (what, *(_both_halves(half[rule]["within"][name][which] for half in halves) for name in moving))
        for what, rule, which in (
            ("correlation", "as it is", 1),
            ("slope", "as it is", 2),
            ("slope, lips without gains", "lips without gains", 2),
            ("correlation, by its keys", _KEYED, 1),
            ("slope, by its keys", _KEYED, 2),
        )
        if rule in halves[0]
    ]
    yield Table("Within clips of strangers", ("figure", *moving), within_rows)
    lids = [
        (rule, *(_both_halves(100.0 * half[rule]["lids"][k] for half in halves) for k in range(2)))
        for rule in (_ACTED, _KEYED)
    ]
    yield Table("Opening of shut eyes by keys, %", ("rule", "three quarters within", "19 of 20 within"), lids)


def _table_of_coefficients(halves: Sequence[Mapping[str, tuple[float, int, float, float]]]) -> Table:
    """Table of the coefficients that the peer sees move within clips on both halves."""
    rows = [
        (name, *(_both_halves(half[name][figure] for half in halves) for figure in (0, 2, 3)))
        for name in halves[0]
        if min(half[name][1] for half in halves) >= _MOVING
    ]
    return Table("Coefficients of strangers", ("coefficient", "across clips", "within clips", "slope"), rows)


def _both_halves(values: Iterable[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())

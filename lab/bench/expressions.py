"""Accuracy of the avatar's expressions: `python -m lab.bench.expressions LABELS.csv NEUTRAL.csv CLIPS`.

Frames of clips, labelled by hand relative to the performer's neutral face, are compared end to end with the landmark
vertices of the built-in head that the clip drives, with the neutral face that Facemime chooses. MediaPipe's landmarks,
relative to the labelled neutral frames, are measured too if it is installed.

Order is the share of pairs of a clip's frames with different labels that are in the right order (0.5 by chance). Sign
is the share of labelled frames on the right side of rest, so a wrong neutral face counts. Slopes state how far the
avatar's mouth opens and widens relative to the performer's, by MediaPipe's landmarks, both in eye distances.
"""

from __future__ import annotations

import csv
import hashlib
import inspect
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadMotion, drive_take
from facemime.core.face.landmarks import IBUG68_INDICES, from_ibug, outer_eye_distance
from facemime.core.files.capture import VideoSource
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import load_take, save_take
from facemime.core.takes.from_video import track_video
from facemime.core.takes.take import Take
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.report import Table, finish, parser

THRESHOLDS = {
    **{"brow_l": 0.02, "brow_r": 0.02, "brow_in": 0.02, "lid_l": 0.25, "lid_r": 0.25},
    **{"jaw": 0.04, "smile": 0.025, "width": 0.04, "side": 0.02},
}
"""Eye distances below which a feature counts as rest, by dimension; for lids, shares of the neutral opening."""
_JAW_IN_SMILE = 0.4
"""How far an open jaw lowers the corners of the mouth, by which a smile is corrected; measured on MediaPipe's
landmarks."""
_RIGID = (33, 133, 362, 263, 168, 6, 197, 195, 5, 4, 127, 356, 234, 454, 10, 151, 9, 8)
"""MediaPipe's vertices that expressions hardly move, from which its poses are estimated and removed."""

Features = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Clip:
    """A labelled clip.

    Attributes
    ----------
    path : Path
    labels : mapping of int to (mapping of str to str)
        Labels of each labelled frame, by dimension; "." where it cannot be judged.
    neutral : (int, int) or None
        First and last of the frames closest to neutral.
    frontal : int or None
        The frame that faces the camera most directly.
    """

    path: Path
    labels: Mapping[int, Mapping[str, str]]
    neutral: tuple[int, int] | None
    frontal: int | None


@dataclass
class Score:
    """Numbers of right answers and of all: pairs in order, frames on the right side."""

    order: list[bool] = field(default_factory=list)
    sign: list[bool] = field(default_factory=list)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("labels", type=Path)
    command.add_argument("neutral", type=Path)
    command.add_argument("clips", type=Path)
    command.add_argument("--given-neutral", action="store_true", help="start from the labelled neutral frames")
    command.add_argument(
        "--takes", type=Path, default=Path("build/bench/expressions"), help="folder in which takes are cached"
    )
    command.add_argument("--wrong", action="store_true", help="list the frames on the wrong side of rest")
    arguments = command.parse_args(argv)
    clips = read_clips(arguments.labels, arguments.neutral, arguments.clips)
    tracker, rig, mesh = FaceTracker.load(), built_in_head(), _mediapipe()
    arguments.takes.mkdir(parents=True, exist_ok=True)
    scores: dict[str, dict[str, Score]] = {"avatar": {}, "MediaPipe": {}}
    rows: list[tuple[object, ...]] = []
    mouths: list[tuple[object, ...]] = []
    for clip in clips:
        take = take_of(clip.path, tracker, arguments.takes)
        fps = float(take.info.get("fps", 25.0))
        given = clip.neutral[0] / fps if arguments.given_neutral and clip.neutral is not None else None
        performance = Performance.of(take, PuppetSettings(neutral=given, smoothing=0.0))
        avatar, motion = shown_features(rig, performance, take)
        wrong = score(clip, avatar, scores["avatar"])
        rows.append(
            (clip.path.stem, performance.neutral.start, _labelled(clip, fps), *_turn(clip, take, motion.rotation))
        )
        if mesh is not None and clip.neutral is not None:
            points, neutral = mesh.pose_free(clip.path, clip.neutral)
            performer = features(points, neutral)
            score(clip, performer, scores["MediaPipe"])
            mouths.append((clip.path.stem, *(slope(avatar[name], performer[name]) for name in ("jaw", "width"))))
        if arguments.wrong:
            print(*(f"{clip.path.stem} {line}" for line in wrong), sep="\n", file=sys.stderr)
    measured = {name: _shares(by) for name, by in scores.items() if by}
    columns = ("dimension", *(f"{name}, {what}" for name in measured for what in ("order", "sign")))
    table = [(key, *(share for by in measured.values() for share in by[key])) for key in (*THRESHOLDS, "all")]
    neutrals = Table(
        "Neutral face", ("clip", "found, s", "labelled, s", "rotation in the frontal frame, degrees"), rows
    )
    tables = [Table("Expressions", columns, table), neutrals]
    if mouths:
        mouths.append(("median", *np.median([row[1:] for row in mouths], axis=0).tolist()))
        tables.append(Table("Mouth", ("clip", "opening, avatar / performer", "width, avatar / performer"), mouths))
    finish(arguments, tables, {"shares": measured})
    return 0


def slope(avatar: np.ndarray, performer: np.ndarray) -> float:
    """How far the avatar's feature moves per unit of the performer's, (N,) each, by least squares."""
    both = np.isfinite(avatar) & np.isfinite(performer)
    moved, wanted = (x[both] - np.median(x[both]) for x in (avatar, performer))
    return float(moved @ wanted / (wanted @ wanted))


def read_clips(labels: Path, neutral: Path, folder: Path) -> list[Clip]:
    """Return the labelled clips that are in `folder`."""
    by_clip: dict[str, dict[int, dict[str, str]]] = {}
    for row in csv.DictReader(labels.open(encoding="utf-8")):
        by_clip.setdefault(row["clip"], {})[int(row["frame"])] = row
    notes = {row["clip"]: row for row in csv.DictReader(neutral.open(encoding="utf-8"))}
    clips = []
    for name, frames in sorted(by_clip.items()):
        path, note = next(iter(sorted(folder.glob(f"{name}.*"))), None), notes.get(name, {})
        if path is None:
            print(f"{name} is left out: no such clip", file=sys.stderr)
            continue
        known = note.get("first", "").isdigit()
        span = (int(note["first"]), int(note["last"])) if known else None
        frontal = int(note["best_frontal"]) if note.get("best_frontal", "").isdigit() else None
        clips.append(Clip(path, frames, span, frontal))
    return clips


def features(points: np.ndarray, rest: np.ndarray) -> Features:
    """Signed features (N,) of pose-free landmarks (N, 66, 3), by dimension, in eye distances from `rest` (66, 3)."""
    unit, now, then = outer_eye_distance(rest), components(points), components(rest)
    moved = {name: (now[name] - then[name]) / unit for name in now}
    for lid in ("lid_l", "lid_r"):
        moved[lid] = moved[lid] / (abs(then[lid]) / unit)  # shut is +1
    return moved


def components(points: np.ndarray) -> dict[str, np.ndarray]:
    """Components of the features; left and right are the image's, and y points down."""

    def mean(numbers: Sequence[int], axis: int = 1) -> np.ndarray:
        return points[..., from_ibug(numbers), axis].mean(axis=-1)

    corners, nose = (48, 54), range(31, 36)
    jaw = mean(range(65, 68)) - mean(range(61, 64))
    return {
        "brow_l": mean((36, 39)) - mean(range(17, 22)),
        "brow_r": mean((42, 45)) - mean(range(22, 27)),
        "brow_in": (mean((17, 18)) - mean((20, 21)) + mean((25, 26)) - mean((22, 23))) / 2.0,
        "lid_l": mean((37, 38)) - mean((40, 41)),
        "lid_r": mean((43, 44)) - mean((46, 47)),
        "jaw": jaw,
        "smile": mean(nose) - mean(corners) + _JAW_IN_SMILE * jaw,
        "width": mean((54,), 0) - mean((48,), 0),
        "side": mean(corners, 0) - mean(nose, 0),
    }


def score(clip: Clip, shown: Features, scores: dict[str, Score]) -> list[str]:
    """Add the clip's pairs and frames to `scores`; return a line per frame on the wrong side of rest."""
    wrong = []
    for name in THRESHOLDS:
        labelled = {
            frame: (float(row[name]), float(shown[name][frame]))
            for frame, row in clip.labels.items()
            if row[name] not in (".", "")
        }
        kept = scores.setdefault(name, Score())
        for frame, (label, value) in labelled.items():
            kept.sign.append(is_right(name, label, value))
            if not kept.sign[-1]:
                wrong.append(f"frame {frame}: {name} is {value:.3f}, labelled {label:g}")
        for (one, here), (other, there) in combinations(labelled.values(), 2):
            if one != other:
                known = bool(np.isfinite(here) and np.isfinite(there))
                kept.order.append(known and (one > other) == (here > there))
    return wrong


def is_right(name: str, label: float, value: float) -> bool:
    """Whether a value is on its label's side of rest, scored one step leniently; a lost frame is not."""
    if not np.isfinite(value):
        return False
    threshold = THRESHOLDS[name]
    if name == "jaw":
        return label == 1.0 or (value > threshold / 2.0) == (label > 1.0)
    if label == 0.0:
        return abs(value) < 2.0 * threshold
    return (0.0 if abs(value) < threshold else np.sign(value)) == np.sign(label)


def _shares(scores: Mapping[str, Score]) -> dict[str, tuple[float, float]]:
    """Shares of right answers by dimension, and of all."""
    every = Score([r for s in scores.values() for r in s.order], [r for s in scores.values() for r in s.sign])
    return {name: (float(np.mean(s.order)), float(np.mean(s.sign))) for name, s in {**scores, "all": every}.items()}


def shown_features(rig: HeadRig, performance: Performance, take: Take) -> tuple[Features, HeadMotion]:
    """Features of the avatar in each frame of a take, NaN without a face, and its motion."""
    motion = drive_take(performance.driver(rig), take)
    rest = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    shown = np.full((len(take), *rest.shape), np.nan)
    shown[take.found] = rest + motion.vertices[:, rig.landmarks]
    return features(shown, rest), motion


def by_labels(folder: Path, takes: Path, options: DriveSettings) -> dict[str, tuple[float, float]]:
    """Shares of pairs in order and of frames on the right side of rest, by dimension and for all, by hand labels.

    `folder` has labels.csv, neutral.csv and clips.
    """
    takes.mkdir(parents=True, exist_ok=True)
    tracker, rig, scores = FaceTracker.load(), built_in_head(), dict[str, Score]()
    for clip in read_clips(folder / "labels.csv", folder / "neutral.csv", folder / "clips"):
        take = take_of(clip.path, tracker, takes)
        performance = Performance.of(take, PuppetSettings(smoothing=0.0, drive=options))
        score(clip, shown_features(rig, performance, take)[0], scores)
    return _shares(scores)


def take_of(path: Path, tracker: FaceTracker, folder: Path) -> Take:
    """Track a clip, or read its take from `folder` if the model and the code that tracks were the same."""
    kept = folder / f"{path.stem}-{tracker.model_id}-{_code_of_tracking()}.facetake"
    if not kept.exists():
        tracker.reset()
        save_take(track_video(path, tracker), kept)
    return load_take(kept)


@cache
def _code_of_tracking() -> str:
    """First digits of the checksum of the code that tracks."""
    sources = sorted(Path(inspect.getfile(FaceTracker)).parent.glob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:8]


def _labelled(clip: Clip, fps: float) -> str:
    return "" if clip.neutral is None else f"{clip.neutral[0] / fps:.2f} to {clip.neutral[1] / fps:.2f}"


def _turn(clip: Clip, take: Take, rotation: np.ndarray) -> tuple[object, ...]:
    """How far the head is turned in the frame that faces the camera most directly, in degrees."""
    if clip.frontal is None or not take.found[clip.frontal]:
        return ("",)
    turn = rotation[int(take.found[: clip.frontal].sum())]
    return (float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))),)


class _Mesh:
    """MediaPipe's 478 points without the pose of the head."""

    def __init__(self) -> None:
        import mediapipe

        from lab.bench.peers.mediapipe478 import VERTICES_68

        self._make = lambda: mediapipe.solutions.face_mesh.FaceMesh(refine_landmarks=True, max_num_faces=1)
        self._vertices = np.array(VERTICES_68)[IBUG68_INDICES]

    def pose_free(self, path: Path, neutral: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return a clip's landmarks (N, 66, 3), aligned with the mean of the frames `neutral`, and that mean."""
        points = self._points(path)
        part = points[neutral[0] : neutral[1] + 1]
        mean = np.nanmean(part, axis=0)
        level = _level(mean)
        laid = np.stack([_laid(frame, mean) for frame in points])
        return (laid @ level)[:, self._vertices], (mean @ level)[self._vertices]

    def _points(self, path: Path) -> np.ndarray:
        rows = []
        with VideoSource(path) as source, self._make() as mesh:
            for frame in source:
                height, width = frame.image.shape[:2]
                faces = mesh.process(cv2.cvtColor(frame.image, cv2.COLOR_BGR2RGB)).multi_face_landmarks
                scale = (width, height, width)  # depth is in the width's unit
                found = [(p.x, p.y, p.z) for p in faces[0].landmark] if faces else np.full((478, 3), np.nan)
                rows.append(np.array(found) * scale)
        return np.stack(rows)


def _laid(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """Move, turn and scale points (478, 3) so that the rigid ones lie on those of `onto` (Umeyama 1991)."""
    rigid, wanted = points[list(_RIGID)], onto[list(_RIGID)]
    if not np.isfinite(rigid).all():
        return np.full_like(points, np.nan)
    here, there = rigid - rigid.mean(axis=0), wanted - wanted.mean(axis=0)
    left, strengths, right = np.linalg.svd(here.T @ there)
    proper = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = (strengths * proper).sum() / (here**2).sum()
    return np.asarray(scale * (points - rigid.mean(axis=0)) @ (left * proper @ right) + wanted.mean(axis=0))


def _level(points: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) in the image after which the outer corners of the eyes are level."""
    along = points[263] - points[33]
    angle = np.arctan2(along[1], along[0])
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def _mediapipe() -> _Mesh | None:
    try:
        return _Mesh()
    except ImportError as reason:
        print(f"MediaPipe is left out: {reason}", file=sys.stderr)
        return None


if __name__ == "__main__":
    sys.exit(main())

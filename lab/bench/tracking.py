"""Accuracy, stability and speed of the tracker, compared with others: `python -m lab.bench.tracking [--model FILE]`.

The data are held-out people with hand labels, the same people re-projected with exact truth, clips of known landmarks,
and the clips of ../shared/data, of which it is only known that they contain a face.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from facemime.core.face.landmarks import BROWS, INNER, JAW
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.smoothing import ResultSmoother
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.accuracy import (
    LOST_ABOVE,
    BlinkCount,
    Differences,
    aperture_errors,
    count_blinks,
    delay,
    differences,
    eye_distances,
    jitter,
    locate_all,
    second_differences,
    track_all,
)
from lab.bench.crossing import on_crossings
from lab.bench.exact import AXES, EYES, FPS, Clip, ExactFaces, shown_size
from lab.bench.figures import draw_tracking
from lab.bench.peers import Live, Ours, Peer, add_options, chosen_peers
from lab.bench.report import finish, parser
from lab.bench.tracking_tables import tables
from lab.training.tracker.sources import HAND_LABELLED, Photo, read_photos, split

ROOT = Path(__file__).resolve().parents[2]
PHOTO_WIDTH = 640
JITTER_FRAMES = 30
_WARM_UP = 5
"""Number of frames of a still before jitter is measured."""


def main() -> int:
    """Run the benchmark; returns the exit status."""
    arguments = _arguments()
    cv2.setNumThreads(1)
    tracker, peers = chosen_peers(arguments)
    photos = split(read_photos(arguments.data, *HAND_LABELLED))[1]
    exact = ExactFaces(arguments.data, arguments.people)
    clips = [*(exact.clip(person) for person in range(min(arguments.people, 3))), sample_clip()]
    videos = sorted((arguments.data / "videos").glob("*.mp4"))
    measured = {peer.name: measure(peer, photos, exact, clips, videos) for peer in peers}
    numbers: dict[str, object] = {"model": tracker.model_id, "people": arguments.people, "trackers": measured}
    ours = any(isinstance(p, Ours) for p in peers)
    live = FaceTracker.load(arguments.model, gradual=True)
    with live.in_two_threads():
        numbers["paces"] = paces([*peers, Live(live)] if ours else peers, clips[-1].frames)
    if ours:
        numbers["stages"] = stage_times(tracker)
        numbers["smoothing"] = on_smoothing(tracker, photos[::3], clips)
        numbers["crossings"] = on_crossings(tracker, clips[:-1])
    if arguments.figure is not None:
        draw_tracking(arguments.figure, measured)
    finish(arguments, tables(measured, numbers), numbers)
    return 0


def _arguments() -> argparse.Namespace:
    command = parser(__doc__.splitlines()[0])
    add_options(command)
    command.add_argument("--people", type=int, default=12, help="number of re-projected people")
    return command.parse_args()


def measure(peer: Peer, photos: list[Photo], exact: ExactFaces, clips: list[Clip], videos: list[Path]) -> dict:
    """Return all results of a tracker, as written to JSON."""
    print(f"measuring {peer.name}", file=sys.stderr)
    studio, located = on_photos(peer, photos)
    offsets = studio.offsets()
    return {
        "photos": {
            "raw": _errors(studio.errors()),
            "removed": _errors(studio.errors(offsets)),
            "lost": _lost(studio.errors()),
            "locate_ms": float(np.median(located.seconds) * 1e3),
        },
        "jitter": on_stills(peer, photos[::3]),
        "axes": {axis: on_axis(peer, axis, exact, offsets) for axis in AXES},
        "clips": on_clips(peer, clips),
        "turning": on_turning(peer, [exact.turning(person) for person in range(exact.people)]),
        "videos": {path.name: on_video(peer, path) for path in videos},
    }


def _errors(values: np.ndarray) -> list[float]:
    """Sorted errors, 100 for lost faces."""
    return [round(float(v), 3) for v in np.sort(np.minimum(values, 100.0))]


def _lost(errors: np.ndarray) -> float:
    return float((errors > LOST_ABOVE).mean())


def on_photos(peer: Peer, photos: list[Photo]) -> tuple[Differences, object]:
    """Hand-labelled photos of held-out people, reduced to the width of a webcam image."""
    images, truth = [], []
    for photo in photos:
        image = cv2.imread(str(photo.path))
        factor = PHOTO_WIDTH / image.shape[1]
        images.append(cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA))
        truth.append((photo.landmarks + 0.5) * factor - 0.5)
    located = locate_all(peer, images)
    true = np.stack(truth)
    return differences(located.landmarks, true, eye_distances(true)), located


def on_stills(peer: Peer, photos: list[Photo]) -> dict[str, float]:
    """Jitter on still photos."""
    runs = []
    for photo in photos:
        runs.append(track_all(peer, noisy_still(photo)).landmarks[_WARM_UP:])
    return asdict(jitter(runs, EYES))


def noisy_still(photo: Photo) -> list[np.ndarray]:
    """The same photo repeatedly, 100 pixels between the eyes, with new noise of 3 grey levels."""
    rng = np.random.default_rng(0)
    factor = EYES / photo.eye_distance()
    still = cv2.resize(photo.grey(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return [np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8) for _ in range(JITTER_FRAMES)]


def on_axis(peer: Peer, axis: str, exact: ExactFaces, offsets: np.ndarray) -> dict[str, dict]:
    """Errors on re-projected faces at every value of an axis: median raw, median without offsets, share lost."""
    out = {}
    for value, stills in exact.stills(axis).items():
        found = locate_all(peer, stills.images).landmarks
        away = differences(found, stills.landmarks, shown_size(axis, value))
        raw, removed = away.errors(), away.errors(offsets)
        out[str(value)] = {
            "raw": float(np.median(np.minimum(raw, LOST_ABOVE))),
            "removed": float(np.median(np.minimum(removed, LOST_ABOVE))),
            "lost": _lost(removed),
            "errors": _errors(removed),
        }
    return out


def sample_clip() -> Clip:
    """The sample clip and its exact landmarks."""
    reader, frames = cv2.VideoCapture(str(ROOT / "assets" / "sample" / "sample.mp4")), []
    while (read := reader.read())[0]:
        frames.append(read[1])
    with np.load(ROOT / "assets" / "sample" / "sample_landmarks.npz", allow_pickle=False) as truth:
        return Clip("sample clip", frames, truth["landmarks"].astype(np.float64), truth["times"])


def on_clips(peer: Peer, clips: list[Clip]) -> dict[str, object]:
    """Clips of known landmarks: errors, apertures over all of them, blinks over all of them."""
    found, true, units, blinks, each = [], [], [], BlinkCount(0, 0, 0, 0), {}
    for clip in clips:
        followed = track_all(peer, clip.frames)
        unit = float(np.percentile(eye_distances(clip.landmarks), 95))
        away = differences(followed.landmarks, clip.landmarks, unit)
        each[clip.name] = {
            "raw": float(np.median(away.errors())),
            "removed": float(np.median(away.errors(away.offsets()))),
            "lost": _lost(away.errors(away.offsets())),
        }
        blinks += count_blinks(followed.landmarks, clip.landmarks)
        found.append(followed.landmarks)
        true.append(clip.landmarks)
        units.append(np.full(len(clip.frames), unit))
    apertures = aperture_errors(*(np.concatenate(part) for part in (found, true, units)))
    return {
        "each": each,
        "apertures": asdict(apertures),
        "blinks": {**asdict(blinks), "recall": blinks.recall, "precision": blinks.precision},
    }


def on_turning(peer: Peer, clips: list[Clip]) -> dict[str, float]:
    """Heads that turn to the limits: frames without a face, with a wrong one, and the errors of the others."""
    errors = []
    for clip in clips:
        followed = track_all(peer, clip.frames).landmarks
        errors.append(differences(followed, clip.landmarks, EYES).errors())
    every = np.concatenate(errors)
    near = every[every <= LOST_ABOVE]
    return {
        "frames": len(every),
        "none": int(np.isinf(every).sum()),
        "elsewhere": int((np.isfinite(every) & (every > LOST_ABOVE)).sum()),
        "median": float(np.median(near)) if len(near) else float("nan"),
        "worst of twenty": float(np.percentile(near, 95)) if len(near) else float("nan"),
    }


def on_video(peer: Peer, path: Path) -> dict[str, float]:
    """A clip with a face but without known landmarks: share found, jitter, and milliseconds."""
    reader, frames = cv2.VideoCapture(str(path)), []
    while (read := reader.read())[0]:
        frames.append(read[1])
    followed = track_all(peer, frames)
    points = followed.landmarks
    moving = second_differences(points[:, INNER]) / np.nanmedian(eye_distances(points)) * 100.0
    return {
        "frames": len(frames),
        "found": float(np.isfinite(points[:, 0, 0]).mean()),
        "jitter": float(np.nanmedian(moving)),
        "ms": float(np.median(followed.seconds) * 1e3),
    }


def paces(peers: list[Peer], frames: list[np.ndarray]) -> dict[str, float]:
    """Median milliseconds per frame; trackers take turns, so that other load affects all of them.

    Their order changes, as threads of some still run for a moment when the next begins.
    """
    seconds: dict[str, list[float]] = {peer.name: [] for peer in peers}
    order = np.random.default_rng(0)
    for peer in peers:
        peer.reset()
    for frame in frames:
        for peer in (peers[i] for i in order.permutation(len(peers))):
            began = perf_counter()
            peer.track(frame)
            seconds[peer.name].append(perf_counter() - began)
    return {name: float(np.median(spent[_WARM_UP:]) * 1e3) for name, spent in seconds.items()}


def stage_times(tracker: FaceTracker) -> dict[str, dict[str, float]]:
    """Median milliseconds of Facemime's stages on the sample clip, 640 x 480, when tracking and when detecting."""
    frames = sample_clip().frames
    tracker.reset()
    out: dict[str, dict[str, float]] = {}
    for name, look, shown in (("tracking", tracker.track, frames), ("detecting", tracker.locate, frames[::10])):
        rows = []
        for frame in shown:
            look(frame)
            rows.append(list(tracker.timings.values()))
        medians = 1e3 * np.median(rows[1:], axis=0)
        out[name] = dict(zip(tracker.timings, (float(v) for v in medians), strict=True))
    return out


def on_smoothing(tracker: FaceTracker, photos: list[Photo], clips: list[Clip]) -> dict[str, dict]:
    """Reduction of jitter by smoothing, and its delay of each motion in milliseconds."""
    stills: dict[str, list[np.ndarray]] = {"raw": [], "smoothed": []}
    for photo in photos:
        runs = followed(tracker, noisy_still(photo), np.arange(JITTER_FRAMES) / FPS)
        for name, run in zip(stills, runs, strict=True):
            stills[name].append(np.stack([r.landmarks for r in run])[_WARM_UP:])
    delays: dict[str, list[float]] = {name: [] for name in MOTIONS}
    for clip in clips:
        raw, smooth = followed(tracker, clip.frames, clip.times)
        for name, motion in MOTIONS.items():
            delays[name].append(delay(*(np.array([motion(r) for r in run]) for run in (raw, smooth))) / FPS * 1e3)
    return {
        "jitter": {name: asdict(jitter(runs, EYES)) for name, runs in stills.items()},
        "delay_ms": {name: float(np.mean(values)) for name, values in delays.items()},
    }


def followed(
    tracker: FaceTracker, frames: list[np.ndarray], times: np.ndarray
) -> tuple[list[TrackResult], list[TrackResult]]:
    """Results of a clip, without and with smoothing."""
    tracker.reset()
    smoother = ResultSmoother()
    raw = [tracker.track(frame) for frame in frames]
    return raw, [smoother.smooth(r, float(t)) for r, t in zip(raw, times, strict=True)]


MOTIONS: dict[str, Callable[[TrackResult], float]] = {
    "lids": lambda r: float(r.eye_apertures.mean()),
    "lips": lambda r: r.mouth_aperture,
    "brows": lambda r: float(r.shape[BROWS, 1].mean()),
    "jaw": lambda r: float(r.shape[JAW[8], 1]),
    "rotation": lambda r: float(r.pose[2]),
    "position": lambda r: float(r.pose[4]),
}
"""A value of each part that has its own filter."""


if __name__ == "__main__":
    sys.exit(main())

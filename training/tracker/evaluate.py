"""How good the tracker is: `python -m training.tracker.evaluate`. Photos of held-out people, and the clips.

Errors are means over the 49 inner points in percent of the outer-eye distance, against labels made by hand.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from facemime.core.apertures import eye_apertures, mouth_aperture
from facemime.core.landmarks import EDGES, INNER
from facemime.core.tracking.tracker import FaceTracker

from .samples import Samples
from .sources import HAND_LABELLED, Photo, read_photos, split

DEFAULT_DATA = Path(__file__).parents[3] / "shared" / "data"
LOST_ABOVE = 10.0


@dataclass(frozen=True)
class PhotoErrors:
    """Errors in percent: median raw, median without each point's median offset, and pictures lost of all."""

    raw: float
    offset_removed: float
    lost: int
    pictures: int
    offsets: np.ndarray


def evaluate_photos(tracker: FaceTracker, photos: list[Photo], width: int = 0) -> PhotoErrors:
    """Locate the face of every photo (shrunk to `width` pixels if that is not 0) and compare with its labels."""
    away, lost = [], 0
    for photo in photos:
        image, truth = cv2.imread(str(photo.path)), photo.landmarks
        if width:
            factor = width / image.shape[1]
            image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
            truth = (truth + 0.5) * factor - 0.5
        found = tracker.locate(image)
        unit = np.linalg.norm(truth[36] - truth[45]) / 100.0
        difference = (found.landmarks - truth) / unit
        if not found.found or np.linalg.norm(difference, axis=1)[INNER].mean() > LOST_ABOVE:
            lost += 1
        else:
            away.append(difference)
    if not away:
        return PhotoErrors(np.nan, np.nan, lost, len(photos), np.full((66, 2), np.nan))
    every = np.stack(away)
    offsets = np.median(every, axis=0)
    raw = np.linalg.norm(every, axis=2)[:, INNER].mean(1)
    removed = np.linalg.norm(every - offsets, axis=2)[:, INNER].mean(1)
    return PhotoErrors(float(np.median(raw)), float(np.median(removed)), lost, len(photos), offsets)


def still_jitter(tracker: FaceTracker, photos: list[Photo], frames: int = 30) -> tuple[float, float]:
    """Mean deviation and mean second difference, in percent, of the inner landmarks of faces that do not move.

    The photos are shrunk to 100 pixels between the outer eye corners and get fresh noise of 3 grey levels a frame.
    """
    rng, deviations, differences = np.random.default_rng(0), [], []
    for photo in photos:
        factor = 100.0 / photo.eye_distance()
        still = cv2.resize(photo.grey(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        tracker.reset()
        noisy = (np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8) for _ in range(frames))
        found = np.stack([tracker.track(frame).landmarks for frame in noisy])[5:, INNER]
        deviations.append(np.linalg.norm(found.std(0), axis=1).mean())
        differences.append(np.linalg.norm(found[2:] - 2 * found[1:-1] + found[:-2], axis=2).mean())
    tracker.reset()
    return float(np.mean(deviations)), float(np.mean(differences))


@dataclass(frozen=True)
class RenderedErrors:
    """On re-projected held-out people, whose landmarks are known exactly.

    Attributes
    ----------
    by_yaw : dict of str to (float, float)
        Median error in percent and share lost, by the head's turn in degrees.
    shut_eye, open_eye, eye_slope : float
        Median opening found (percent of the outer-eye distance) where the truth is below 1.5 % and above 6 %, and the
        slope of found against true opening: 1 follows fully, 0 not at all.
    mouth_slope : float
        The same slope for the lips' inner opening.
    """

    by_yaw: dict[str, tuple[float, float]]
    shut_eye: float
    open_eye: float
    eye_slope: float
    mouth_slope: float


def evaluate_rendered(tracker: FaceTracker, samples: Samples) -> RenderedErrors:
    """Locate every rendered face and compare with its exact landmarks."""
    found = np.stack([tracker.locate(image).landmarks for image in samples.images])
    unit = samples.poses[:, 0, None] / 100.0
    error = np.linalg.norm(found - samples.landmarks, axis=2)[:, INNER].mean(1) / unit[:, 0]
    good = error < LOST_ABOVE
    yaw = np.degrees(np.abs(samples.poses[:, 2]))
    by_yaw = {}
    for low, high in ((0, 15), (15, 30), (30, 45), (45, 60)):
        rows = (yaw >= low) & (yaw < high)
        by_yaw[f"{low}-{high}"] = (float(np.median(error[rows & good])), float(1 - good[rows].mean()))
    eyes, true_eyes = eye_apertures(found[good]) / unit[good], eye_apertures(samples.landmarks[good]) / unit[good]
    lips, true_lips = (
        mouth_aperture(found[good]) / unit[good, 0],
        mouth_aperture(samples.landmarks[good]) / unit[good, 0],
    )
    return RenderedErrors(
        by_yaw,
        float(np.median(eyes[true_eyes < 1.5])),
        float(np.median(eyes[true_eyes > 6.0])),
        float(np.polyfit(true_eyes.ravel(), eyes.ravel(), 1)[0]),
        float(np.polyfit(true_lips, lips, 1)[0]),
    )


@dataclass(frozen=True)
class ClipReport:
    """One video: frames, share found, detections after the first, jitter in percent, milliseconds a frame."""

    frames: int
    found: float
    detections: int
    jitter: float
    median_ms: float
    lost_frames: list[int]


def evaluate_clip(tracker: FaceTracker, path: Path, sheet: Path | None = None, every: int = 0) -> ClipReport:
    """Track a video; `sheet` receives a picture of some frames with their landmarks.

    Jitter is the median over frames of the mean second difference of the inner landmarks: a tracker's own noise, as
    far as the performer's motion is smooth.
    """
    reader, tracker_points, seconds, lost, shown = cv2.VideoCapture(str(path)), [], [], [], []
    total = int(reader.get(cv2.CAP_PROP_FRAME_COUNT))
    every = every or max(total // 40, 1)
    detections, number = -1, 0
    tracker.reset()
    while True:
        there, frame = reader.read()
        if not there:
            break
        began = perf_counter()
        result = tracker.track(frame)
        seconds.append(perf_counter() - began)
        detections += tracker.timings["detect"] > 0
        tracker_points.append(result.landmarks / result.pose[0] * 100.0)
        if not result.found:
            lost.append(number)
        if sheet is not None and number % every == 0:
            shown.append(draw_face(frame, result.landmarks, f"{number} {result.confidence:.2f}"))
        number += 1
    points = np.stack(tracker_points)[:, INNER]
    second = np.linalg.norm(points[2:] - 2 * points[1:-1] + points[:-2], axis=2).mean(1)
    if sheet is not None:
        _contact_sheet(shown, sheet)
    return ClipReport(
        number, 1 - len(lost) / number, detections, float(np.nanmedian(second)), float(np.median(seconds) * 1e3), lost
    )


def draw_face(image: np.ndarray, landmarks: np.ndarray, caption: str = "", width: int = 300) -> np.ndarray:
    """The face cut out (width square) with its landmarks, or the whole image where there is none."""
    if not np.isfinite(landmarks).all():
        out = cv2.resize(image, (width, width))
    else:
        centre, reach = landmarks.mean(0), 0.75 * np.ptp(landmarks, axis=0).max()
        gain = width / (2 * reach)
        matrix = np.array([[gain, 0, width / 2 - gain * centre[0]], [0, gain, width / 2 - gain * centre[1]]])
        out = cv2.warpAffine(image, matrix, (width, width), flags=cv2.INTER_CUBIC)
        points = np.round((landmarks @ matrix[:, :2].T + matrix[:, 2]) * 8).astype(int)
        for a, b in EDGES:
            cv2.line(out, tuple(points[a]), tuple(points[b]), (0, 255, 0), 1, cv2.LINE_AA, 3)
    return cv2.putText(out, caption, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 255, 255), 1, cv2.LINE_AA)


def _contact_sheet(pictures: list[np.ndarray], path: Path, columns: int = 8) -> None:
    while len(pictures) % columns:
        pictures.append(np.zeros_like(pictures[0]))
    rows = [np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    cv2.imwrite(str(path), np.vstack(rows))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA)
    parser.add_argument("--work", type=Path, default=Path(__file__).parents[2] / "build" / "model")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--sheets", type=Path, help="folder for contact sheets of the clips")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    tracker = FaceTracker.load(options.model)
    print(f"model {tracker.model_id}")
    for width in (0, 200):
        _, held_out = split(read_photos(options.data, *HAND_LABELLED))
        e = evaluate_photos(tracker, held_out, width)
        print(f"held-out people, {f'{width} px wide' if width else 'full size'}: {e.raw:.2f} % median raw, ", end="")
        print(f"{e.offset_removed:.2f} % with offsets removed, {e.lost} of {e.pictures} lost")
    deviation, difference = still_jitter(tracker, held_out[::3])
    print(f"jitter on stills with noise: {deviation:.2f} % position, {difference:.2f} % second difference")
    parts = sorted((options.work / "held_out").glob("[0-9]*.npz"))
    if parts:
        r = evaluate_rendered(tracker, Samples.join([Samples.load(p) for p in parts]))
        turns = ", ".join(f"{turn}: {error:.2f} % ({lost:.0%} lost)" for turn, (error, lost) in r.by_yaw.items())
        print(f"held-out people re-projected, by degrees of yaw: {turns}")
        print(f"eyes: shut {r.shut_eye:.1f} %, open {r.open_eye:.1f} %, slope {r.eye_slope:.2f}; ", end="")
        print(f"mouth slope {r.mouth_slope:.2f}")
    for path in sorted((options.data / "videos").glob("*.mp4")):
        sheet = options.sheets and options.sheets / f"{path.stem}.jpg"
        c = evaluate_clip(tracker, path, sheet)
        print(f"{path.name}: {c.found:.1%} of {c.frames} found, {c.detections} re-detections, ", end="")
        print(f"jitter {c.jitter:.2f} %, {c.median_ms:.1f} ms a frame; lost {c.lost_frames[:12]}")


if __name__ == "__main__":
    main()

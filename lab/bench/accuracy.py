"""Measures of a tracker's accuracy, independent of the source of the images.

Errors are means over the 49 inner points, in percent of the face's outer-eye distance. A face counts as lost if none is
found or the error is above 10 %.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np

from facemime.core.face.landmarks import INNER, OUTER_EYE_CORNERS, eye_apertures, mouth_aperture
from lab.bench.peers import Peer

LOST_ABOVE = 10.0
_SLACK = 2
"""Largest distance in frames between a detected blink and the true one."""


@dataclass(frozen=True)
class Differences:
    """Tracked minus true landmarks of N images, (N, 66, 2), without roll, in percent; NaN if no face was found."""

    values: np.ndarray

    def errors(self, offsets: np.ndarray | float = 0.0) -> np.ndarray:
        """Mean error of the inner points after removing `offsets` (66, 2), (N,); infinite if no face was found."""
        error = np.linalg.norm(self.values - offsets, axis=2)[:, INNER].mean(axis=1)
        return np.where(np.isnan(error), np.inf, error)

    def offsets(self) -> np.ndarray:
        """Median error of each point over the images with a face, (66, 2)."""
        kept = self.values[self.errors() <= LOST_ABOVE]
        return np.median(kept, axis=0) if len(kept) else np.zeros(self.values.shape[1:])


def differences(found: np.ndarray, truth: np.ndarray, units: np.ndarray | float) -> Differences:
    """Compare landmarks (N, 66, 2) in pixels; `units` (N,) is the outer-eye distance of each face in pixels."""
    across = np.diff(truth[:, OUTER_EYE_CORNERS], axis=1)[:, 0]
    along = across / np.linalg.norm(across, axis=1, keepdims=True)
    away = (found - truth) / (np.broadcast_to(units, len(found)) / 100.0)[:, None, None]
    turn = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
    return Differences(np.einsum("nij,npj->npi", turn, away))


def eye_distances(landmarks: np.ndarray) -> np.ndarray:
    """Distance between the outer eye corners of landmarks (N, 66, 2), (N,)."""
    return np.linalg.norm(np.diff(landmarks[:, OUTER_EYE_CORNERS], axis=1)[:, 0], axis=1)


@dataclass(frozen=True)
class Located:
    """Landmarks (N, 66, 2) found by a tracker in N independent images, and the seconds (N,) spent on each."""

    landmarks: np.ndarray
    seconds: np.ndarray


def locate_all(peer: Peer, images: Iterable[np.ndarray]) -> Located:
    """Locate the face in each image independently."""
    return _timed(peer.locate, images)


def track_all(peer: Peer, frames: Iterable[np.ndarray]) -> Located:
    """Track the face in a clip."""
    peer.reset()
    return _timed(peer.track, frames)


def _timed(look: object, images: Iterable[np.ndarray]) -> Located:
    landmarks, seconds = [], []
    for image in images:
        shown = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        began = perf_counter()
        landmarks.append(look(shown))
        seconds.append(perf_counter() - began)
    return Located(np.stack(landmarks), np.array(seconds))


@dataclass(frozen=True)
class Jitter:
    """Jitter on a still: mean standard deviation and mean second difference of the inner points, in percent."""

    position: float
    second_difference: float


def jitter(runs: Sequence[np.ndarray], unit: float) -> Jitter:
    """Motion of the landmarks (T, 66, 2) of faces at rest, without lost frames."""
    deviations, seconds = [], []
    for run in runs:
        inner = run[np.isfinite(run[:, 0, 0])][:, INNER] / (unit / 100.0)
        if len(inner) > 2:
            deviations.append(np.linalg.norm(inner.std(axis=0), axis=1).mean())
            seconds.append(second_differences(inner).mean())
    return Jitter(float(np.mean(deviations)), float(np.mean(seconds))) if deviations else Jitter(np.nan, np.nan)


def second_differences(points: np.ndarray) -> np.ndarray:
    """Mean length of the second differences of the points, (T - 2,)."""
    return np.linalg.norm(points[2:] - 2.0 * points[1:-1] + points[:-2], axis=2).mean(axis=1)


@dataclass(frozen=True)
class Apertures:
    """How lids and lips follow: medians of the absolute error and of what is found where the truth is shut; slopes.

    Values are in percent of the outer-eye distance; at a slope of 1 the motion is followed fully, at 0 not at all.
    """

    eye_error: float
    shut_eye: float
    eye_slope: float
    mouth_error: float
    shut_mouth: float
    mouth_slope: float


def aperture_errors(found: np.ndarray, truth: np.ndarray, units: np.ndarray | float) -> Apertures:
    """Compare the apertures of landmarks (N, 66, 2); images without a face are left out."""
    seen = np.isfinite(found[:, 0, 0])
    scale = np.broadcast_to(units, len(found))[seen] / 100.0
    eyes, true_eyes = (eye_apertures(x[seen]) / scale[:, None] for x in (found, truth))
    lips, true_lips = (mouth_aperture(x[seen]) / scale for x in (found, truth))
    return Apertures(
        float(np.median(np.abs(eyes - true_eyes))),
        _median(eyes[true_eyes < 1.5]),
        _slope(true_eyes.ravel(), eyes.ravel()),
        float(np.median(np.abs(lips - true_lips))),
        _median(lips[true_lips < 1.5]),
        _slope(true_lips, lips),
    )


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _slope(truth: np.ndarray, found: np.ndarray) -> float:
    return float(np.polyfit(truth, found, 1)[0]) if np.ptp(truth) > 0 else float("nan")


@dataclass(frozen=True)
class BlinkCount:
    """Numbers of true blinks, of detected ones among them, of reported blinks, and of true ones among them."""

    true: int
    found: int
    reported: int
    correct: int

    def __add__(self, other: BlinkCount) -> BlinkCount:
        return BlinkCount(*(a + b for a, b in zip(_counts(self), _counts(other), strict=True)))

    @property
    def recall(self) -> float:
        """Share of the true blinks that were detected."""
        return self.found / self.true if self.true else float("nan")

    @property
    def precision(self) -> float:
        """Share of the reported blinks that are true."""
        return self.correct / self.reported if self.reported else float("nan")


def _counts(count: BlinkCount) -> tuple[int, int, int, int]:
    return count.true, count.found, count.reported, count.correct


def count_blinks(found: np.ndarray, truth: np.ndarray) -> BlinkCount:
    """Count blinks in landmarks (T, 66, 2): spans in which the eyes are open by less than half their median."""
    reported, true = _blinks(found), _blinks(truth)

    def met(span: tuple[int, int], others: list[tuple[int, int]]) -> bool:
        return any(span[0] <= end + _SLACK and start - _SLACK <= span[1] for start, end in others)

    return BlinkCount(
        len(true), sum(met(s, reported) for s in true), len(reported), sum(met(s, true) for s in reported)
    )


def _blinks(landmarks: np.ndarray) -> list[tuple[int, int]]:
    """First and last frame of each blink."""
    share = eye_apertures(landmarks).mean(axis=1) / eye_distances(landmarks)
    shut = share < 0.5 * np.nanmedian(share)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], shut, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def delay(motion: np.ndarray, late: np.ndarray) -> float:
    """Delay in frames, to a twentieth, at which a signal (T,) is closest to its delayed copy (T,)."""
    times = np.arange(len(motion))
    shifts = np.arange(-1.0, 6.0, 0.05)
    misses = [np.square(np.interp(times - s, times, motion) - late)[8:-8].sum() for s in shifts]
    return float(shifts[int(np.argmin(misses))])

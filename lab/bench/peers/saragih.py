"""J. Saragih's FaceTracker model (text format) in Facemime's reference frame, with Facemime's mean-shift fit.

Only the learnt parts differ from Facemime's tracker: the shape model and the patch experts. Its own detector and start
are not used. It starts at the pose that Facemime's tracker finds, with its mean shape, so a face that is not found
there counts as lost for both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import cv2
import numpy as np

from facemime.core.base.landmarks import INNER, N_LANDMARKS
from facemime.core.tracking.experts import ResponseMaps
from facemime.core.tracking.mean_shift import Evidence, MeanShiftOptions, regularised_mean_shift
from facemime.core.tracking.pdm import FittedShape, PointDistributionModel
from facemime.core.tracking.reference import pose_in_image, warp_to_reference
from facemime.core.tracking.tracker import FaceTracker

RADII = (5, 4, 3)
"""Radii of the search windows, coarse to fine: 11, 9 and 7 pixels wide."""
_ITERATIONS = 10
_REGULARISATION = 0.5
_HALF = 5
_REACH, _MARGIN = 1.35, 14
"""Half the side of the reference frame in outer-eye distances, and additional pixels for the filters."""


@dataclass(frozen=True)
class Filter:
    """A linear expert: `1 / (1 + exp(gain * r + offset))` of the correlation coefficient r with `weights` (11, 11).

    `kind` is its input: 0 grey levels, 1 squared gradients, 2 local binary patterns.
    """

    kind: int
    gain: float
    offset: float
    weights: np.ndarray


@dataclass(frozen=True)
class PeerModel:
    """The content of the file, with the shape model converted to the head frame.

    `views` are frontal, nose to the viewer's left, nose to the viewer's right; each has filters per landmark, none if
    it is hidden. `scale` is that of the reference frame, in pixels per outer-eye distance of Facemime's mean face.
    """

    pdm: PointDistributionModel
    scale: float
    views: tuple[tuple[tuple[Filter, ...], ...], ...]


def read_peer(path: Path, ours: PointDistributionModel) -> PeerModel:
    """Read `face2.tracker`; FileNotFoundError if it is missing."""
    words = iter(path.read_text(encoding="ascii").split())

    def expect(kind: int) -> None:
        if int(next(words)) != kind:
            raise ValueError(f"{path} is not a FaceTracker model. Download it again.")

    expect(8)
    expect(4)
    n_views = int(next(words))
    expect(0)
    basis, variances, mean, reference = (_matrix(words) for _ in range(4))
    yaws = [_matrix(words)[1, 0] for _ in range(n_views)]
    for _ in range(n_views):
        _matrix(words)  # visibility; filters of hidden landmarks are empty
    views = [tuple(_filters(words, expect) for _ in range(N_LANDMARKS)) for _ in range(n_views)]
    order = [int(np.argmin(np.abs(np.array(yaws) - yaw))) for yaw in (0.0, 0.7, -0.7)]
    points, modes = mean.reshape(3, N_LANDMARKS).T, basis.reshape(3, N_LANDMARKS, -1).transpose(1, 0, 2)
    turn, moved = _onto(points, ours.mean_shape)
    pdm = PointDistributionModel(moved, np.einsum("ab,nbk->nak", turn, modes), variances.ravel())
    flat = reference.reshape(2, N_LANDMARKS).T
    scale = np.linalg.norm(flat - flat.mean(0)) / np.linalg.norm(moved[:, :2] - moved[:, :2].mean(0))
    return PeerModel(pdm, float(scale), tuple(views[i] for i in order))


def _matrix(words: Iterator[str]) -> np.ndarray:
    rows, columns, _ = (int(next(words)) for _ in range(3))
    return np.array([float(next(words)) for _ in range(rows * columns)]).reshape(rows, columns)


def _filters(words: Iterator[str], expect: object) -> tuple[Filter, ...]:
    next(words)
    _, _, count = (int(next(words)) for _ in range(3))
    found = []
    for _ in range(count):
        expect(2)
        kind, gain, offset = int(next(words)), float(next(words)), float(next(words))
        found.append(Filter(kind, gain, offset, _matrix(words).astype(np.float32)))
    return tuple(found)


def _onto(points: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit a scaled rotation (3, 3) from points (66, 3) to the target; also return the moved points (Umeyama 1991).

    Only inner points are used, as the jaw line is a contour in one model and a place on the skin in the other.
    """
    centre, aim = points[INNER].mean(0), target[INNER].mean(0)
    a, b = points[INNER] - centre, target[INNER] - aim
    u, spread, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = (spread * sign).sum() / (a * a).sum() * (u * sign) @ vt
    return turn, (points - centre) @ turn.T + aim


class PeerExperts:
    """Filters of one view; their three kinds of input are computed once per frame."""

    def __init__(self, filters: tuple[tuple[Filter, ...], ...]) -> None:
        self.filters = filters
        self.visible = np.array([float(len(f) > 0) for f in filters])

    def response_maps(self, pixels: np.ndarray, centres: np.ndarray, radius: int) -> ResponseMaps:
        """Product of the filters of each landmark in windows around centres (N, 2), each with a sum of 1."""
        side, span = 2 * radius + 1, 2 * (radius + _HALF) + 1
        corner = np.clip(centres - radius - _HALF, 0, len(pixels) - span)
        shown = (pixels, _squared_gradient(pixels), _binary_pattern(pixels))
        maps = np.full((N_LANDMARKS, side, side), 1.0 / side**2, np.float32)
        for i, (x, y) in enumerate(corner):
            for f in self.filters[i]:
                crop = np.ascontiguousarray(shown[f.kind][y : y + span, x : x + span])
                alike = cv2.matchTemplate(crop, f.weights, cv2.TM_CCOEFF_NORMED)
                maps[i] *= 1.0 / (1.0 + np.exp(f.gain * alike + f.offset))
                maps[i] /= max(maps[i].sum(), 1e-20)
        first = (corner + _HALF).astype(np.float32)
        return ResponseMaps(np.arange(N_LANDMARKS), maps, first, np.ones((N_LANDMARKS, 1), np.float32))


def _squared_gradient(pixels: np.ndarray) -> np.ndarray:
    out = np.zeros_like(pixels)
    out[1:-1, 1:-1] = (pixels[1:-1, 2:] - pixels[1:-1, :-2]) ** 2 + (pixels[2:, 1:-1] - pixels[:-2, 1:-1]) ** 2
    return out


def _binary_pattern(pixels: np.ndarray) -> np.ndarray:
    """Sum of powers of two, from 2 upwards, over neighbours in reading order that are not brighter than the pixel."""
    out = np.zeros_like(pixels)
    height, width = pixels.shape
    around = [(dy, dx) for dy in (0, 1, 2) for dx in (0, 1, 2) if (dy, dx) != (1, 1)]
    for power, (dy, dx) in enumerate(around, start=1):
        neighbour = pixels[dy : height - 2 + dy, dx : width - 2 + dx]
        out[1:-1, 1:-1] += np.float32(2**power) * (pixels[1:-1, 1:-1] >= neighbour)
    return out


class Saragih:
    """FaceTracker as a `Peer`."""

    name = "Saragih's model, our fit"

    def __init__(self, path: Path, tracker: FaceTracker) -> None:
        self.tracker = tracker
        self.model = read_peer(path, tracker.pdm)
        self.experts = [PeerExperts(view) for view in self.model.views]
        self._last: FittedShape | None = None

    def locate(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.locate`."""
        result = self.tracker.locate(image)
        if not result.found:
            return result.landmarks
        fitted = self._fit(image, FittedShape(result.pose, np.zeros(self.model.pdm.n_modes)), RADII)
        return self.model.pdm.project(fitted.pose, fitted.shape_params)

    def track(self, image: np.ndarray) -> np.ndarray:
        """Track by its own fit from frame to frame, lost if Facemime's tracker is. See `Peer.track`."""
        result = self.tracker.track(image)
        if not result.found:
            self._last = None
            return result.landmarks
        start = self._last or FittedShape(result.pose, np.zeros(self.model.pdm.n_modes))
        self._last = self._fit(image, start, RADII if self._last is None else RADII[-1:])
        return self.model.pdm.project(self._last.pose, self._last.shape_params)

    def reset(self) -> None:
        """See `Peer.reset`."""
        self.tracker.reset()
        self._last = None

    def _fit(self, image: np.ndarray, start: FittedShape, radii: tuple[int, ...]) -> FittedShape:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        pdm, fitted = self.model.pdm, start
        for radius in radii:
            yaw = fitted.pose[2]
            experts = self.experts[0 if abs(yaw) < 0.35 else 1 if yaw > 0 else 2]
            size, scale = 2 * ceil(_REACH * self.model.scale + _MARGIN), self.model.scale
            middle = (size - 1) / 2.0
            pixels = warp_to_reference(grey, fitted.pose, scale, (size, size)).pixels.astype(np.float32)
            pitch, yaw = fitted.pose[1:3]
            local = FittedShape(np.array([scale, pitch, yaw, 0.0, middle, middle]), fitted.shape_params)
            centres = np.round(pdm.project(local.pose, local.shape_params)).astype(np.intp)
            evidence = [Evidence(experts.response_maps(pixels, centres, radius), experts.visible)]
            variance = (2 * radius + 1) ** 2 / 36.0
            for _ in range(_ITERATIONS):
                options = MeanShiftOptions((variance,), _REGULARISATION * variance)
                local = regularised_mean_shift(pdm, local, evidence, options)
            s, *turn, x, y = local.pose
            relative = np.array([s / scale, *turn, (x - middle) / scale, (y - middle) / scale])
            fitted = FittedShape(pose_in_image(relative, fitted.pose), local.shape_params)
        return fitted

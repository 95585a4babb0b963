"""OpenSeeFace: landmarks in the format that its tracker sends to VTuber programs (streams.md).

A datagram contains 1,785 little-endian bytes per face; none is sent while there is no face. Its 66 points differ from
Facemime's: both leave out two of iBUG's 68, but OpenSeeFace keeps the inner corners of the mouth, as numbers 58 and 62,
and has no outer ones.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from ...face.landmarks import MOUTH_CORNERS, eye_apertures, from_ibug, mouth_aperture
from ...face.rotation import euler_to_matrix, matrix_to_euler, to_quaternion
from ...numeric import linalg
from ...numeric.arrays import FloatArray
from ...tracking.result import TrackResult
from .frames import PacketError, StreamFrame

PORT = 11573
_FACE = struct.Struct("<di2f2fBf4f3f3f")
_BYTES = _FACE.size + 4 * (68 + 2 * 68 + 3 * 70 + 14)
_MAX_FACES = 16
_UNIT = 0.63181
"""Distance between the outer eye corners of OpenSeeFace's own face, to whose width it scales all faces."""
_PIXELS = 1e5
"""Largest coordinates in an image."""
_UNITS = 100.0
"""Largest coordinates of points on a face."""
_MIN_SCALE = 1e-3
PLACES: NDArray[np.intp] = np.concatenate([np.arange(48), from_ibug([*range(49, 54), *range(55, 60)]), MOUTH_CORNERS])
"""(60,) Facemime's landmarks at OpenSeeFace's numbers `NUMBERS`."""
NUMBERS: NDArray[np.intp] = np.array([*range(58), 58, 62])
_INNER, _INNER_NUMBERS = from_ibug([61, 62, 63, 65, 66, 67]), np.array([59, 60, 61, 63, 64, 65])
_OURS = np.concatenate([PLACES, _INNER])
_THEIRS = np.concatenate([NUMBERS, _INNER_NUMBERS])
_AXES = np.array([-1.0, 1.0, 1.0])
"""From OpenSeeFace's axes, to the viewer's left, down and away, to those of the head frame, and back."""
_CAMERA = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From a rotation in the head frame to OpenSeeFace's, whose camera has rows first and negative depths."""
_EYE_DEPTH = 0.385
"""Depth of the centre of an eyeball behind its corners, as a share of their distance."""


class OpenSeeFaceDecoder:
    """Decodes OpenSeeFace; each face is a separate subject."""

    def decode(self, data: bytes) -> list[StreamFrame]:
        """Decode a datagram. See `Decoder.decode`."""
        count, rest = divmod(len(data), _BYTES)
        if rest or not 1 <= count <= _MAX_FACES:
            raise PacketError("not OpenSeeFace")
        return [_frame(data[at : at + _BYTES]) for at in range(0, len(data), _BYTES)]


def _frame(data: bytes) -> StreamFrame:
    time, number, width, height, right, left, found, *_ = _FACE.unpack_from(data)
    with np.errstate(invalid="ignore"):  # a signalling NaN is refused below
        values = np.frombuffer(data, "<f4", offset=_FACE.size).astype(np.float64)
    confidence, points, shape, _ = np.split(values, np.cumsum([68, 2 * 68, 3 * 70]))
    sane = (abs(time) < 1e12, 0.0 < width < _PIXELS, 0.0 < height < _PIXELS, found in (0, 1), abs(right + left) < 1e6)
    if not all(sane) or not (np.abs(points) < _PIXELS).all() or not (np.abs(shape) < _UNITS).all():
        raise PacketError("a number is impossible")
    if not ((confidence >= -1.0) & (confidence <= 2.0)).all():
        raise PacketError("a confidence is impossible")
    face = None
    if found:
        face = _result(points.reshape(-1, 2), shape.reshape(-1, 3), np.clip(confidence, 0.0, 1.0))
    return StreamFrame(face, str(number), time)


def _result(points: FloatArray, places: FloatArray, confidence: FloatArray) -> TrackResult:
    landmarks, shape, certain = np.empty((66, 2)), np.empty((66, 3)), np.empty(66)
    landmarks[_OURS], certain[_OURS] = points[_THEIRS], confidence[_THEIRS]
    shape[_OURS] = places[_THEIRS] * _AXES / _UNIT
    gaze, vergence = _gaze(places * _AXES)
    return TrackResult(
        found=True,
        landmarks=landmarks,
        pose=fit_pose(shape, landmarks),
        shape_params=np.empty(0),
        shape=shape,
        confidence=float(certain.mean()),
        landmark_confidence=certain,
        pupils=points[66:68].copy(),
        gaze=gaze,
        vergence=vergence,
    )


def _gaze(places: FloatArray) -> tuple[FloatArray, float]:
    """Compute gaze and vergence from the pupils (66, 67) and the centres of the eyeballs (68, 69), right and left."""
    x, y, z = (places[66:68] - places[68:70]).T
    if not (z < 0.0).all():
        return np.full(2, np.nan), float("nan")
    pitch, yaw = np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, -z)
    return np.array([pitch.mean(), yaw.mean()]), float(yaw[1] - yaw[0])


def fit_pose(shape: FloatArray, landmarks: FloatArray) -> FloatArray:
    """Fit the pose (6,) under which a shape (66, 3) is seen at landmarks (66, 2) in pixels, under weak perspective.

    It consists of the rotation and scale nearest to the linear part of the best affine map. The shape is without the
    pose, in the head frame and outer-eye distances. Raises PacketError if the points have no extent.
    """
    middle = shape.mean(axis=0)
    spread = shape - middle
    gram = spread.T @ spread
    if linalg.svdvals(gram)[-1] <= 1e-9:
        raise PacketError("the points lie in a plane")
    linear = linalg.solve(gram, spread.T @ landmarks).T
    u, scales, vt = linalg.svd(linear, full_matrices=False)
    scale = float(scales.mean())
    if not _MIN_SCALE < scale < _PIXELS:
        raise PacketError("the points have no extent")
    rows = u @ vt
    turn = np.stack([*rows, np.cross(*rows)])
    place = landmarks.mean(axis=0) - scale * rows @ middle
    return np.array([scale, *matrix_to_euler(turn), *place])


def encode(result: TrackResult, time: float, size: tuple[int, int], rest: FloatArray | None = None) -> bytes:
    """Encode a result with a face, in an image of width and height `size`, as a datagram.

    The openings of eyes and mouth are measured from `rest` (66, 3), the neutral shape; by default from that of
    `result`.
    """
    rest = result.shape if rest is None else rest
    points, places, confidence = np.zeros((68, 2)), np.zeros((70, 3)), np.ones(68)
    points[_THEIRS], places[_THEIRS] = result.landmarks[_OURS], result.shape[_OURS] * _UNIT
    known = np.isfinite(result.landmark_confidence)
    certain = np.where(known, result.landmark_confidence, result.confidence)
    confidence[_THEIRS] = certain[_OURS]
    places[66:] = _eyes(places, result)
    turn = euler_to_matrix(*result.pose[1:4])
    points[66:68] = result.pose[0] / _UNIT * (places[66:68] @ turn.T)[:, :2] + result.pose[4:]
    if np.isfinite(result.pupils).all():
        points[66:68] = result.pupils
    opened = np.clip(eye_apertures(result.shape) / np.maximum(eye_apertures(rest), 1e-3), 0.0, 1.0)
    turned = _CAMERA @ turn
    angles = cv2.RQDecomp3x3(turned)[0]
    depth = size[0] * _UNIT / float(result.pose[0])
    x, y = depth * (result.pose[4:] - np.array(size) / 2.0) / size[0]
    head = _FACE.pack(
        *(time, 0, *map(float, size), *opened.tolist(), 1, 0.0),
        *to_quaternion(turned.T),  # OpenSeeFace's convention
        *angles,
        *(-float(y), -float(x), -depth),
    )
    tail = np.concatenate([confidence, points.ravel(), (places * _AXES).ravel(), _features(result.shape, rest, opened)])
    return bytes(head + tail.astype("<f4").tobytes())


def _eyes(places: FloatArray, result: TrackResult) -> FloatArray:
    """Right and left pupil, and the centres of the eyeballs, in the head frame, (4, 3)."""
    corners = places[[[36, 39], [42, 45]]]
    depth = _EYE_DEPTH * np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    centres = corners.mean(axis=1) + depth[:, None] * [0.0, 0.0, 1.0]
    pitch, yaw = np.nan_to_num(result.gaze)
    aside = 0.5 * float(np.nan_to_num(result.vergence)) * np.array([-1.0, 1.0])
    forward = np.stack([-euler_to_matrix(float(pitch), float(yaw + turn), 0.0)[:, 2] for turn in aside])
    return np.concatenate([centres + depth[:, None] * forward, centres])


def _features(shape: FloatArray, rest: FloatArray, opened: FloatArray) -> FloatArray:
    """Features for programs without landmarks, (14,): openings of eyes and mouth, heights of brows, corners below the
    upper lip.
    """

    def raised(rows: NDArray[np.intp]) -> float:
        return float(4.0 * (rest[rows, 1] - shape[rows, 1]).mean())

    lip = raised(from_ibug([50, 51, 52]))
    corners = np.clip([lip - raised(MOUTH_CORNERS[[side]]) for side in (1, 0)], -1.0, 1.0).tolist()
    left, right = np.clip([raised(from_ibug(rows)) for rows in (range(22, 27), range(17, 22))], -1.0, 1.0).tolist()
    wide = np.linalg.norm(np.subtract(*shape[MOUTH_CORNERS])) / np.linalg.norm(np.subtract(*rest[MOUTH_CORNERS])) - 1.0
    gap = float(np.clip(2.0 * (mouth_aperture(shape) - mouth_aperture(rest)), 0.0, 1.0))
    brows = [0.0, left, 0.0, 0.0, right, 0.0]
    mouth = [corners[0], 0.0, corners[1], 0.0, gap, float(np.clip(2.0 * wide, -1.0, 1.0))]
    return np.array([opened[1] - 1.0, opened[0] - 1.0, *brows, *mouth])

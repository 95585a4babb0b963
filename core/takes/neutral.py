"""The performer's neutral face, from which expressions are measured: found in a take, and kept (METHOD section 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..apertures import eye_apertures, mouth_aperture
from ..arrays import FloatArray
from ..errors import SourceError
from ..heads.regions import REGIONS, rms_extent
from ..landmarks import BROWS, MIRROR, MOUTH_CORNERS, N_LANDMARKS
from ..reading import as_object, parse_json
from ..rotation import euler_to_matrix
from .take import Take

_SURELY_SHUT = 0.45
_HARDLY_OPEN, _WIDE_OPEN, _MOST_GAIN = 0.12, 0.35, 1.4
"""Of the mouth, outer-eye distances from neutral."""
_MAY_BE_UNKNOWN = ("gaze", "open_mouth")
_LARGEST, _LARGEST_NUMBER = {"shape": 100.0, "gaze": 10.0, "open_mouth": 100.0}, 1e7
"""Of a stored calibration: outer-eye distances, radians; seconds and pixels."""
_FLAT, _TURN_ROUNDING = 1e-4, 1e-3
MIRROR_WIDTH = 1.0
"""Pixels: the width of which a mirrored picture has its middle at x = 0, as has a mirrored `Neutral`."""


@dataclass(frozen=True)
class Neutral:
    """The performer at rest.

    Attributes
    ----------
    shape : (66, 3) float64
        Mean pose-free shape: head frame, outer-eye distances.
    rotation : (3, 3) float64
        How the performer held the head, by the median of the take: the avatar looks straight ahead then. Where the
        camera stands below or beside the screen, that is not the attitude of a head that faces the camera.
    position : (3,) float64
        `(s, tx, ty)`, medians of the take: pixels an outer-eye distance, pixels, pixels.
    start, end : float
        Seconds of the take that were averaged.
    shut : float
        Opening of the eyes, as a fraction of the neutral one, at which the performer's eyes are shut: small, but not
        0, as lashes and blur keep a tracker's lids a little apart. 0 where the take shows no shut eyes.
    gaze : (2,) float64
        `(pitch, yaw)`, radians, median of the take: where the performer mostly looks. NaN where the take tells none.
    open_mouth : float
        Aperture of the mouth when it was opened as wide as it goes, outer-eye distances; NaN where nobody asked.
    """

    shape: FloatArray
    rotation: FloatArray
    position: FloatArray
    start: float
    end: float
    shut: float = 0.0
    gaze: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    open_mouth: float = np.nan

    @property
    def mouth_gain(self) -> float:
        """By how much the lower face moves more, so that the widest opening shown opens the avatar's mouth well too."""
        opened = self.open_mouth - float(mouth_aperture(self.shape))
        if not opened > _HARDLY_OPEN:
            return 1.0
        return float(np.clip(_WIDE_OPEN / opened, 1.0, _MOST_GAIN))

    def mirrored(self) -> Neutral:
        """The neutral of the performer's mirror image; of a picture `MIRROR_WIDTH` wide, as `mirror_result` has it."""
        flip = np.array([-1.0, 1.0, 1.0])
        return replace(
            self,
            shape=(self.shape * flip)[MIRROR],
            rotation=self.rotation * np.outer(flip, flip),
            position=self.position * (1.0, -1.0, 1.0),
            gaze=self.gaze * (1.0, -1.0),
        )

    def to_dict(self) -> dict[str, Any]:
        """As plain lists and numbers, for JSON; what is not known is None."""
        return {f.name: _plain(np.asarray(getattr(self, f.name), dtype=np.float64)) for f in fields(self)}

    @classmethod
    def from_json(cls, text: str) -> Neutral:
        """From the JSON of what `to_dict` gave; SourceError as for `from_dict`."""
        try:
            return cls.from_dict(as_object(parse_json(text), "it"))
        except ValueError as error:
            raise SourceError(f"The stored calibration is damaged ({error}). Calibrate again.") from error

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Neutral:
        """From what `to_dict` gave.

        Raises
        ------
        SourceError
            Where something is missing, has another shape, or is not what a calibration can be.
        """
        shapes = {"shape": (N_LANDMARKS, 3), "rotation": (3, 3), "position": (3,), "gaze": (2,)}
        values: dict[str, Any] = {}
        for name in (f.name for f in fields(cls)):
            try:
                value = np.array(data[name], dtype=np.float64)
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise SourceError(f"The stored calibration is damaged ({name}). Calibrate again.") from error
            known = np.isfinite(value) | ((name in _MAY_BE_UNKNOWN) & np.isnan(value))
            within = np.abs(np.nan_to_num(value)).max(initial=0.0) <= _LARGEST.get(name, _LARGEST_NUMBER)
            if value.shape != shapes.get(name, ()) or not known.all() or not within:
                raise SourceError(f"The stored calibration is damaged ({name}). Calibrate again.")
            values[name] = value if name in shapes else float(value)
        neutral = cls(**values)
        turn = neutral.rotation
        sound = {
            "rotation": np.allclose(turn @ turn.T, np.eye(3), atol=_TURN_ROUNDING) and np.linalg.det(turn) > 0.0,
            "position": neutral.position[0] > 0.0,
            "shut": 0.0 <= neutral.shut < _SURELY_SHUT,
            "shape": _is_face(neutral.shape),
        }
        if wrong := [name for name, is_sound in sound.items() if not is_sound]:
            raise SourceError(f"The stored calibration is damaged ({wrong[0]}). Calibrate again.")
        return neutral


def _is_face(shape: FloatArray) -> bool:
    """Whether each region of a shape (66, 3) has some width and height."""
    return all(float(rms_extent(shape[region.landmarks]).min()) > _FLAT for region in REGIONS)


def _plain(value: FloatArray) -> Any:
    if value.ndim:
        return [_plain(item) for item in value]
    return float(value) if np.isfinite(value) else None


def calibrate(take: Take, start: float | None = None, duration: float = 1.0) -> Neutral:
    """Average the pose-free shape over about a second in which the performer is neutral.

    Parameters
    ----------
    start : float, optional
        Seconds. By default the take's own calibration, if it carries one, or else the second with the least
        expression: lips closed, mouth not drawn wide, eyes open, brows where they mostly are, head towards the camera.
    duration : float
        Seconds to average.

    Raises
    ------
    SourceError
        Where no face was found in the chosen time, or in the whole take.

    Notes
    -----
    Of the second's frames the calmer half is averaged, so that one into which a smile or a blink has crept still
    gives a neutral face.
    """
    if not take.found.any():
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    if start is None and "calibration" in take.info:
        return Neutral.from_dict(take.info["calibration"])
    if start is None:
        start = _restful_second(take, duration)
    chosen = take.found & (take.times >= start - 1e-9) & (take.times <= start + duration)
    if not chosen.any():
        raise SourceError(
            f"No face was found between {start:.2f} s and {start + duration:.2f} s. Choose another neutral."
        )
    shapes = take.shape[chosen].astype(np.float64)
    expression = _expression(shapes)
    pitch, yaw, roll = (float(a) for a in np.median(take.pose[take.found, 1:4], axis=0))
    neutral = shapes[expression <= np.median(expression)].mean(axis=0)
    return Neutral(
        shape=neutral,
        rotation=euler_to_matrix(pitch, yaw, roll),
        position=np.median(take.pose[take.found][:, [0, 4, 5]], axis=0),
        start=float(take.times[chosen][0]),
        end=float(take.times[chosen][-1]),
        shut=shut_level(neutral, take.shape[take.found].astype(np.float64)),
        gaze=_usual_gaze(take.gaze[take.found].astype(np.float64)),
    )


def shut_level(neutral: FloatArray, shapes: FloatArray) -> float:
    """`Neutral.shut`: the fraction of the neutral opening left when the eyes of (N, 66, 3) shapes are most closed.

    The third smallest opening: a blink lasts some frames at any usual rate, a misplaced lid one or two.
    """
    opening = eye_apertures(shapes).mean(axis=1)
    at_rest = float(eye_apertures(neutral).mean())
    least = np.sort(opening)[min(2, len(opening) - 1)]
    left = float(np.clip(least / max(at_rest, 1e-9), 0.0, 1.0))
    return left if left < _SURELY_SHUT else 0.0


def _usual_gaze(gaze: FloatArray) -> FloatArray:
    """(2,) median of the frames (N, 2) that tell a gaze, NaN where none does."""
    told = gaze[np.isfinite(gaze).all(axis=1)]
    return np.median(told, axis=0) if len(told) else np.full(2, np.nan)


def _restful_second(take: Take, duration: float) -> float:
    """Start of the window with the least expression, the head as mostly held, and the tracker sure of itself."""
    found = np.flatnonzero(take.found)
    times = take.times[found]
    turned = np.abs(take.pose[found, 1:4] - np.median(take.pose[found, 1:4], axis=0)).sum(axis=1)
    doubt = 1.0 - take.confidence[found]
    expression = _expression(take.shape[found].astype(np.float64)) + 0.2 * turned + 0.2 * doubt
    ends = np.searchsorted(times, times + duration, side="right")
    full = np.flatnonzero(times + duration <= times[-1] + 1e-9)
    starts = full if len(full) else np.array([0])
    sums = np.concatenate([[0.0], np.cumsum(expression)])
    counts = ends[starts] - starts
    dense = counts >= 0.5 * counts.max()
    mean = np.where(dense, (sums[ends[starts]] - sums[starts]) / counts, np.inf)
    return float(times[starts[np.argmin(mean)]])


def _expression(shapes: FloatArray) -> FloatArray:
    """How far each of (N, 66, 3) shapes is from rest, (N,), outer-eye distances.

    A resting face has closed lips, a mouth that is not drawn wide, open eyes, and brows where they mostly are. A plain
    distance from the median would call a grin neutral in a clip of somebody who grins most of the time.
    """
    gap = mouth_aperture(shapes)
    width = np.linalg.norm(shapes[:, MOUTH_CORNERS[1]] - shapes[:, MOUTH_CORNERS[0]], axis=1)
    lids = eye_apertures(shapes).mean(axis=1)
    brows = shapes[:, BROWS]
    unusual = np.linalg.norm(brows - np.median(brows, axis=0), axis=2).mean(axis=1)
    closed, narrow, awake = np.percentile(gap, 5), np.percentile(width, 20), np.percentile(lids, 70)
    drowsy = 2.0 * np.maximum(awake - lids, 0.0)
    return np.asarray(np.abs(gap - closed) + 0.5 * np.abs(width - narrow) + drowsy + unusual)

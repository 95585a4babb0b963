"""The performer's neutral face, from which expressions are measured (docs/method.md, section 4.1)."""

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

_MAX_SHUT = 0.45
"""Largest opening, relative to the neutral one, that can count as shut."""
_MIN_OPENING, _WIDE_OPENING, _MAX_GAIN = 0.12, 0.35, 1.4
"""Openings of the mouth from neutral in outer-eye distances: the least that counts, and a wide one; and the largest
gain (section 4.2)."""
_OPTIONAL = ("gaze", "open_mouth")
"""Values that may be NaN."""
_MAX_VALUES, _MAX_VALUE = {"shape": 100.0, "gaze": 10.0, "open_mouth": 100.0}, 1e7
"""Upper bounds of stored values: outer-eye distances and radians; others are seconds and pixels."""
_MIN_EXTENT, _ROTATION_ERROR = 1e-4, 1e-3
"""Least extent of a region of a stored shape, and largest error of a stored rotation."""
MIRROR_WIDTH = 1.0
"""Width in pixels for which mirroring an image keeps x = 0 in place, as mirroring a `Neutral` does."""


@dataclass(frozen=True)
class Neutral:
    """The performer's neutral face and usual pose.

    Attributes
    ----------
    shape : (66, 3) float64
        Mean pose-free shape: head frame, outer-eye distances.
    rotation : (3, 3) float64
        Median rotation in the take, at which the avatar looks straight ahead. If the camera is below or beside the
        screen, the performer does not face the camera then.
    position : (3,) float64
        `(s, tx, ty)`, medians of the take: pixels per outer-eye distance, pixels, pixels.
    start, end : float
        Span of the take that was averaged, in seconds.
    shut : float
        Opening at which the performer's eyes are shut, as a fraction of the neutral one: small, but not 0, as lashes
        and blur keep tracked lids apart. 0 if the take shows no shut eyes.
    gaze : (2,) float64
        `(pitch, yaw)` in radians, median of the take: the usual gaze. NaN if the take has none.
    open_mouth : float
        Aperture of the mouth when opened wide, in outer-eye distances; NaN if unknown.
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
        """Factor of the lower face's vertical motion, by which the performer's widest opening becomes a wide one."""
        opened = self.open_mouth - float(mouth_aperture(self.shape))
        if not opened > _MIN_OPENING:
            return 1.0
        return float(np.clip(_WIDE_OPENING / opened, 1.0, _MAX_GAIN))

    def mirrored(self) -> Neutral:
        """The neutral face of the mirrored performer, in an image with the width `MIRROR_WIDTH`."""
        flip = np.array([-1.0, 1.0, 1.0])
        return replace(
            self,
            shape=(self.shape * flip)[MIRROR],
            rotation=self.rotation * np.outer(flip, flip),
            position=self.position * (1.0, -1.0, 1.0),
            gaze=self.gaze * (1.0, -1.0),
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to lists and numbers for JSON; unknown values become None."""
        return {f.name: _plain(np.asarray(getattr(self, f.name), dtype=np.float64)) for f in fields(self)}

    @classmethod
    def from_json(cls, text: str) -> Neutral:
        """Parse the JSON of what `to_dict` returned; SourceError as for `from_dict`."""
        try:
            return cls.from_dict(as_object(parse_json(text), "it"))
        except ValueError as error:
            raise SourceError(f"The stored calibration is damaged ({error}). Calibrate again.") from error

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Neutral:
        """Convert from what `to_dict` returned.

        Raises
        ------
        SourceError
            If a value is missing, or is impossible.
        """
        shapes = {"shape": (N_LANDMARKS, 3), "rotation": (3, 3), "position": (3,), "gaze": (2,)}
        values: dict[str, Any] = {}
        for name in (f.name for f in fields(cls)):
            try:
                value = np.array(data[name], dtype=np.float64)
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise SourceError(f"The stored calibration is damaged ({name}). Calibrate again.") from error
            known = np.isfinite(value) | ((name in _OPTIONAL) & np.isnan(value))
            within = np.abs(np.nan_to_num(value)).max(initial=0.0) <= _MAX_VALUES.get(name, _MAX_VALUE)
            if value.shape != shapes.get(name, ()) or not known.all() or not within:
                raise SourceError(f"The stored calibration is damaged ({name}). Calibrate again.")
            values[name] = value if name in shapes else float(value)
        neutral = cls(**values)
        turn = neutral.rotation
        sound = {
            "rotation": np.allclose(turn @ turn.T, np.eye(3), atol=_ROTATION_ERROR) and np.linalg.det(turn) > 0.0,
            "position": neutral.position[0] > 0.0,
            "shut": 0.0 <= neutral.shut < _MAX_SHUT,
            "shape": _is_face(neutral.shape),
        }
        if wrong := [name for name, is_sound in sound.items() if not is_sound]:
            raise SourceError(f"The stored calibration is damaged ({wrong[0]}). Calibrate again.")
        return neutral


def _is_face(shape: FloatArray) -> bool:
    """Whether each region of a shape (66, 3) has some width and height."""
    return all(float(rms_extent(shape[region.landmarks]).min()) > _MIN_EXTENT for region in REGIONS)


def _plain(value: FloatArray) -> Any:
    if value.ndim:
        return [_plain(item) for item in value]
    return float(value) if np.isfinite(value) else None


def calibrate(take: Take, start: float | None = None, duration: float = 1.0) -> Neutral:
    """Average the neutral face over about a second.

    Parameters
    ----------
    take : Take
        The take.
    start : float, optional
        Start in seconds. By default the calibration that the take contains, or else the second with the least
        expression (equation 4.1).
    duration : float
        Seconds to average.

    Returns
    -------
    Neutral
        The neutral face, with the median pose of the take.

    Raises
    ------
    SourceError
        If there is no face in that time, or in the whole take.

    Notes
    -----
    The calmer half of the frames is averaged, so that a smile or a blink that begins or ends in that second does not
    matter.
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
    # The calmer half of the frames, so that a smile or a blink that begins or ends in this time does not count.
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
    """Estimate `Neutral.shut`: the opening that is left when the eyes are most closed.

    Parameters
    ----------
    neutral : (66, 3) float64
        Neutral shape.
    shapes : (N, 66, 3) float64
        Shapes of the performance.

    Returns
    -------
    float
        As a fraction of the neutral opening; 0 if the eyes never shut.

    Notes
    -----
    The third smallest opening is used: a blink lasts some frames at any usual rate, a misplaced lid one or two.
    """
    opening = eye_apertures(shapes).mean(axis=1)
    at_rest = float(eye_apertures(neutral).mean())
    least = np.sort(opening)[min(2, len(opening) - 1)]
    left = float(np.clip(least / max(at_rest, 1e-9), 0.0, 1.0))
    return left if left < _MAX_SHUT else 0.0


def _usual_gaze(gaze: FloatArray) -> FloatArray:
    """(2,) median gaze over frames (N, 2), NaN if none has one."""
    known = gaze[np.isfinite(gaze).all(axis=1)]
    return np.median(known, axis=0) if len(known) else np.full(2, np.nan)


def _restful_second(take: Take, duration: float) -> float:
    """Start of the span with the lowest mean of equation 4.1."""
    found = np.flatnonzero(take.found)
    times = take.times[found]
    turned = np.abs(take.pose[found, 1:4] - np.median(take.pose[found, 1:4], axis=0)).sum(axis=1)
    doubt = 1.0 - take.confidence[found]
    expression = _expression(take.shape[found].astype(np.float64)) + 0.2 * turned + 0.2 * doubt
    # Means over all spans of the duration, by cumulative sums; spans with many lost frames are skipped.
    ends = np.searchsorted(times, times + duration, side="right")
    full = np.flatnonzero(times + duration <= times[-1] + 1e-9)
    starts = full if len(full) else np.array([0])
    sums = np.concatenate([[0.0], np.cumsum(expression)])
    counts = ends[starts] - starts
    dense = counts >= 0.5 * counts.max()
    mean = np.where(dense, (sums[ends[starts]] - sums[starts]) / counts, np.inf)
    return float(times[starts[np.argmin(mean)]])


def _expression(shapes: FloatArray) -> FloatArray:
    """Amount of expression (N,) of shapes (N, 66, 3), in outer-eye distances: the first terms of equation 4.1.

    A resting face has closed lips, a mouth that is not wide, open eyes, and brows in their usual place. By the plain
    distance from the median, a grin would be neutral in a clip of somebody who grins most of the time.
    """
    gap = mouth_aperture(shapes)
    width = np.linalg.norm(shapes[:, MOUTH_CORNERS[1]] - shapes[:, MOUTH_CORNERS[0]], axis=1)
    lids = eye_apertures(shapes).mean(axis=1)
    brows = shapes[:, BROWS]
    unusual = np.linalg.norm(brows - np.median(brows, axis=0), axis=2).mean(axis=1)
    closed, narrow, awake = np.percentile(gap, 5), np.percentile(width, 20), np.percentile(lids, 70)
    drowsy = 2.0 * np.maximum(awake - lids, 0.0)
    return np.asarray(np.abs(gap - closed) + 0.5 * np.abs(width - narrow) + drowsy + unusual)

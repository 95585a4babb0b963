"""The take: everything that was tracked, with the time of each frame, from which any head can be driven later.

It contains the pose-free 3-D landmarks as well as their parameters, so that it remains usable after the tracker's model
has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, SourceError
from ..face.landmarks import N_LANDMARKS
from ..face.names import N_ACTIONS, N_COEFFICIENTS
from ..files.assets import version
from ..numeric.arrays import FloatArray
from ..tracking.result import TrackResult


@dataclass(frozen=True)
class Take:
    """A tracked performance of N frames.

    Attributes
    ----------
    times : (N,) float64
        Times in seconds, strictly increasing; presentation times for a video.
    landmarks : (N, 66, 2) float32
        Positions in pixels; NaN where lost.
    pose : (N, 6) float64
        `(s, pitch, yaw, roll, tx, ty)` as in `TrackResult`; NaN where lost.
    shape_params : (N, K) float32
        Coefficients of the modes of the shape model; NaN where lost.
    shape : (N, 66, 3) float32
        Landmarks without the pose: head frame, outer-eye distances; NaN where lost.
    confidence : (N,) float32
        Confidence that there is a face, 0 to 1.
    found : (N,) bool
        Whether there is a face.
    landmark_confidence : (N, 66) float32
        Certainty of each landmark, 0 to 1; NaN where unknown.
    pupils : (N, 2, 2) float32
        Centres of the right and left pupil in pixels; NaN where the eye is shut or the pupil unknown.
    gaze : (N, 2) float32
        `(pitch, yaw)` in radians, as in `TrackResult`; NaN where unknown.
    vergence : (N,) float32
        As in `TrackResult`, in radians; NaN where unknown.
    actions : (N, 15) float32
        As in `TrackResult`; NaN where unknown, as in takes of earlier versions.
    teeth : (N,) float32
        As in `TrackResult`, 0 to 1; NaN where unknown, as in takes of earlier versions.
    coefficients : (N, 52) float32
        As in `TrackResult`; NaN where the source states none, as in a tracked video.
    info : dict
        Description, initially by `describe`. Later steps add `interrupted` (stopped before the end of the source),
        `recovered` (what is missing from a damaged file), `calibration` (a chosen neutral face), `bridged` (spans in
        seconds that were filled in) and `smoothed`.

    Examples
    --------
    >>> from facemime import Take, load_take
    >>> take: Take = load_take("performance.facetake")
    >>> len(take), take.landmarks.shape, take.result(0).found
    (60, (60, 66, 2), True)
    >>> len(take.part(take.times < 1.0))
    25
    """

    times: FloatArray
    landmarks: FloatArray
    pose: FloatArray
    shape_params: FloatArray
    shape: FloatArray
    confidence: FloatArray
    found: NDArray[np.bool_]
    landmark_confidence: FloatArray
    pupils: FloatArray
    gaze: FloatArray
    vergence: FloatArray
    actions: FloatArray
    teeth: FloatArray
    coefficients: FloatArray
    info: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times)

    def result(self, frame: int) -> TrackResult:
        """Return the tracking result of a frame."""
        rows = {name: getattr(self, name)[frame] for name in FIELDS[1:]}
        return TrackResult(**{name: row.astype(float) if row.ndim else row.item() for name, row in rows.items()})

    def part(self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Take:
        """Return a take of the chosen frames."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in FIELDS})


FIELDS = (
    *("times", "landmarks", "pose", "shape_params", "shape", "confidence", "found"),
    *("landmark_confidence", "pupils", "gaze", "vergence", "actions", "teeth", "coefficients"),
)
"""Names of the arrays of a take, which have one row per frame."""
DTYPES: dict[str, type] = {"times": np.float64, "pose": np.float64, "found": np.bool_}
"""Data types of arrays of a take; the others are float32."""


def describe(source: str, fps: float, image_size: tuple[int, int], model: str, clock: str = "media") -> dict[str, Any]:
    """Create the initial `info` of a take, with the version and the current time.

    `source` is the name of the file or the camera, `fps` its nominal rate, `image_size` width and height in pixels,
    `model` the tracker model's identifier, and `clock` the origin of the times: "media", or "monotonic" for the
    computer's.
    """
    return {
        "source": source,
        "fps": float(fps),
        "image_size": [int(side) for side in image_size],
        "model": model,
        "clock": clock,
        "facemime": version(),
        "started": datetime.now().astimezone().isoformat(timespec="seconds"),
    }


class TakeRecorder:
    """Collects results frame by frame. `finish` may be called at any time."""

    def __init__(self, info: dict[str, Any]) -> None:
        self.info = dict(info)
        self._times: list[float] = []
        self._results: list[TrackResult] = []

    def __len__(self) -> int:
        return len(self._times)

    def append(self, time: float, result: TrackResult) -> None:
        """Add the result of a frame; raises ValueError if its time in seconds does not increase from call to call."""
        check_increase(self._times[-1] if self._times else -np.inf, time)
        self._times.append(time)
        self._results.append(result)

    def finish(self) -> Take:
        """Return the take recorded so far; SourceError if there is no frame."""
        if not self._results:
            raise SourceError("Nothing was tracked, as the source has no frames. Choose another source.")

        rows = {name: [getattr(result, name) for result in self._results] for name in FIELDS[1:]}
        arrays: dict[str, Any] = {
            name: np.array(values, dtype=DTYPES.get(name, np.float32)) for name, values in rows.items()
        }
        return Take(times=np.array(self._times, dtype=np.float64), **arrays, info=dict(self.info))


def check_increase(last: float, time: float) -> None:
    """Raise a ValueError unless a frame at `time` can follow one at `last`, both in seconds."""
    if not last < time < np.inf:
        raise DataError("times must increase; got {time} after {last}", time=time, last=last)


def join(takes: Sequence[Take]) -> Take:
    """Concatenate takes that follow each other in time; `info` is that of the first."""
    return Take(
        **{name: np.concatenate([getattr(take, name) for take in takes]) for name in FIELDS}, info=dict(takes[0].info)
    )


def check_take(take: Take) -> None:
    """Raise a ValueError if the arrays of `take` are inconsistent."""
    count = len(take.times)
    shapes = {
        "times": (count,),
        "landmarks": (count, N_LANDMARKS, 2),
        "pose": (count, 6),
        "shape_params": (count, take.shape_params.shape[-1]),
        "shape": (count, N_LANDMARKS, 3),
        "confidence": (count,),
        "found": (count,),
        "landmark_confidence": (count, N_LANDMARKS),
        "pupils": (count, 2, 2),
        "gaze": (count, 2),
        "vergence": (count,),
        "actions": (count, N_ACTIONS),
        "teeth": (count,),
        "coefficients": (count, N_COEFFICIENTS),
    }
    for name, expected in shapes.items():
        if (shape := getattr(take, name).shape) != expected:
            raise DataError("{name} has the shape {shape}, not {expected}", name=name, shape=shape, expected=expected)
    if count == 0 or not np.isfinite(take.times).all() or not (np.diff(take.times) > 0).all():
        raise DataError("its times do not increase")
    found = take.found.astype(bool)
    if not np.isfinite(take.shape[found]).all() or not np.isfinite(take.pose[found]).all():
        raise DataError("frames marked as found contain no numbers")

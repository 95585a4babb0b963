"""The take: everything tracked, with the time of each frame, so that any head can be driven from it later.

It holds the pose-free 3-D landmarks themselves beside the parameters that made them, so that a take stays usable
when the tracker's model has changed.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import SourceError
from ..files import replacing
from ..landmarks import N_LANDMARKS
from ..tracking.result import TrackResult
from ..version import version

FORMAT = "facemime-take"
FORMAT_VERSION = 2
"""2 added landmark_confidence, pupils and gaze, which are NaN in a take of format 1."""


@dataclass(frozen=True)
class Take:
    """A tracked performance of N frames.

    Attributes
    ----------
    times : (N,) float64
        Seconds, strictly increasing; media time for a video.
    landmarks : (N, 66, 2) float32
        Image frame, pixels; NaN where lost.
    pose : (N, 6) float64
        `(s, pitch, yaw, roll, tx, ty)` as in `TrackResult`; NaN where lost.
    shape_params : (N, K) float32
        Coefficients of the shape model's modes; NaN where lost.
    shape : (N, 66, 3) float32
        Landmarks with the pose taken out: head frame, outer-eye distances; NaN where lost.
    confidence : (N,) float32
        0 to 1.
    found : (N,) bool
    landmark_confidence : (N, 66) float32
        0 to 1; NaN where not known.
    pupils : (N, 2, 2) float32
        Right and left, image frame, pixels; NaN where the eye is shut or the pupil not known.
    gaze : (N, 2) float32
        `(pitch, yaw)` as in `TrackResult`, radians; NaN where not known.
    info : dict
        `source` (file name), `fps` (nominal), `image_size` (width, height), `model` (checksum of the tracker's
        model), `facemime` (version), and `smoothed` where it is.
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
    info: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times)

    def result(self, frame: int) -> TrackResult:
        """The tracking result of one frame, as the tracker gave it."""
        return TrackResult(
            found=bool(self.found[frame]),
            landmarks=self.landmarks[frame].astype(np.float64),
            pose=self.pose[frame],
            shape_params=self.shape_params[frame].astype(np.float64),
            shape=self.shape[frame].astype(np.float64),
            confidence=float(self.confidence[frame]),
            landmark_confidence=self.landmark_confidence[frame].astype(np.float64),
            pupils=self.pupils[frame].astype(np.float64),
            gaze=self.gaze[frame].astype(np.float64),
        )


class TakeRecorder:
    """Collects results frame by frame; `finish` may be called at any time and gives what has come so far."""

    def __init__(self, info: dict[str, Any]) -> None:
        self.info = {**info, "facemime": version()}
        self._times: list[float] = []
        self._results: list[TrackResult] = []

    def __len__(self) -> int:
        return len(self._times)

    def append(self, time: float, result: TrackResult) -> None:
        """Add one frame at `time` seconds; times must increase."""
        if self._times and not time > self._times[-1]:
            raise ValueError(f"times must increase; got {time} after {self._times[-1]}")
        self._times.append(time)
        self._results.append(result)

    def finish(self) -> Take:
        """Return the take recorded so far; raises SourceError where no frame has come."""
        if not self._results:
            raise SourceError("Nothing was tracked: the source gave no frame.")

        def stack(name: str, dtype: type) -> Any:
            return np.array([getattr(result, name) for result in self._results], dtype=dtype)

        return Take(
            times=np.array(self._times, dtype=np.float64),
            landmarks=stack("landmarks", np.float32),
            pose=stack("pose", np.float64),
            shape_params=stack("shape_params", np.float32),
            shape=stack("shape", np.float32),
            confidence=stack("confidence", np.float32),
            found=stack("found", np.bool_),
            landmark_confidence=stack("landmark_confidence", np.float32),
            pupils=stack("pupils", np.float32),
            gaze=stack("gaze", np.float32),
            info=dict(self.info),
        )


def save_take(take: Take, path: Path) -> None:
    """Write `take` as an .npz that numpy alone reads; a failure leaves what was there before.

    Raises
    ------
    OutputError
        Where `path` cannot be written.
    """
    header = json.dumps({"format": FORMAT, "version": FORMAT_VERSION, "info": take.info})
    with replacing(Path(path)) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, header=np.array(header), **_arrays(take))


def load_take(path: Path) -> Take:
    """Read a take written by `save_take`.

    Raises
    ------
    SourceError
        Where the file is missing, damaged, foreign, or of a later format.
    """
    path = Path(path)
    if not path.is_file():
        raise SourceError(f"There is no take {path}. Make one with: facemime track VIDEO -o {path.name}")
    try:
        with np.load(path, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            if header.get("format") != FORMAT:
                raise ValueError("it is not a take")
            if header["version"] > FORMAT_VERSION:
                raise SourceError(f"{path} was written by a newer Facemime. Update Facemime to open it.")
            arrays = {name: data[name] for name in _FIELDS if name in data or header["version"] > 1}
            take = Take(**{**_unknown(len(arrays["times"])), **arrays}, info=header["info"])
        _check(take)
    except (ValueError, KeyError, TypeError, OSError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise SourceError(
            f"{path} is not a take of Facemime, or it is damaged ({error}). Track the video again."
        ) from error
    return take


_FIELDS = (
    *("times", "landmarks", "pose", "shape_params", "shape", "confidence", "found"),
    *("landmark_confidence", "pupils", "gaze"),
)


def _unknown(count: int) -> dict[str, Any]:
    """What a take of format 1 does not tell."""
    shapes = {"landmark_confidence": (count, N_LANDMARKS), "pupils": (count, 2, 2), "gaze": (count, 2)}
    return {name: np.full(shape, np.nan, np.float32) for name, shape in shapes.items()}


def _arrays(take: Take) -> dict[str, Any]:
    return {name: getattr(take, name) for name in _FIELDS}


def _check(take: Take) -> None:
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
    }
    for name, expected in shapes.items():
        if (shape := getattr(take, name).shape) != expected:
            raise ValueError(f"{name} has the shape {shape}, not {expected}")
    if count == 0 or not np.isfinite(take.times).all() or not (np.diff(take.times) > 0).all():
        raise ValueError("its times do not increase")
    found = take.found.astype(bool)
    if not np.isfinite(take.shape[found]).all() or not np.isfinite(take.pose[found]).all():
        raise ValueError("frames marked as found hold no numbers")

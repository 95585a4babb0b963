"""The performer's neutral face, from which expressions are measured (method.md, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..errors import Message, SourceError
from ..face.landmarks import MIRROR, N_LANDMARKS, mouth_aperture
from ..face.names import ACTION_MIRROR, ACTIONS, N_ACTIONS, action_indices
from ..face.rotation import euler_to_matrix
from ..files.reading import as_object, parse_json
from ..heads.regions import REGIONS, rms_extent
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .face_space import load_face_space
from .facing import facing, usual_gaze
from .rest import MAX_SHUT, expressed, frowning, median_of_known, resting_shape, shut_level, trust
from .take import Take

_MIN_OPENING = 0.12
"""Smallest opening of the mouth beyond neutral that counts, in outer-eye distances (section 4.2)."""
_WIDE_OPENING = 0.35
"""A wide opening of the mouth beyond neutral, in outer-eye distances (section 4.2)."""
_MAX_GAIN = 1.4
"""Largest gain of the mouth (section 4.2)."""
_OPTIONAL = ("gaze", "open_mouth", "vergence", "actions")
"""Values that may be NaN."""
_ADDED = {"removed": 0.0, "vergence": np.nan, "actions": [np.nan] * N_ACTIONS, "measured": 0.0, "asked": 1.0}
"""Values that files of earlier versions lack."""
_MAX_FRAMES = 300
"""Largest number of frames of a take that are searched for a neutral face."""
_MOMENT = 0.2
"""Duration of a neutral face in seconds. A second would be too long, as strong performers seldom rest that long. From
0.15 to 0.5 the results of `lab.bench.expressions` hardly change."""
_CALM = 0.08
"""Amount of expression, in eye distances, above that of the calmest frame, at which the weight of a frame is 1/e in
`rest_of`. On the clips of `lab.bench.expressions`, 0.01 to 0.08 are about as accurate; the more frames count, the
steadier the result."""
_MUCH_REMOVED = 0.35
"""Activation above which an expression that was removed is reported."""
_ACTED = 0.6
"""Activation of the brows' actions from which their height at rest counts as unknown. Where the network sees less of
any, their height is more and more the person's own. From 0.45 to 0.7 frames of strangers compare alike."""
_BROW_ACTIONS = action_indices(name for name in ACTIONS if name.startswith("brow"))
_FROWN = action_indices(name for name in ACTIONS if name.startswith("browDown"))
_MOST_AT_REST = np.array([0.35 if name.startswith("noseSneer") else 1.0 for name in ACTIONS])
"""Largest activations that may be the person's own face. Of a wrinkled nose, all of 108 portraits at rest have less,
and nine of ten of older people with shut lips, whose folds look like it."""
_MAX_VALUES = {"shape": 100.0, "gaze": 10.0, "open_mouth": 100.0, "vergence": 10.0, "actions": 100.0}
"""Largest stored values: of the shape and the mouth in outer-eye distances, of the gaze and vergence in radians."""
_MAX_VALUE = 1e7
"""Largest stored value of anything else, such as times in seconds and the position in pixels."""
_MIN_EXTENT = 1e-4
"""Smallest extent of a region of a stored shape, in outer-eye distances."""
_ROTATION_ERROR = 1e-3
"""Largest error of a stored rotation, in its product with its transpose."""
MIRROR_WIDTH = 1.0
"""Image width in pixels for which mirroring keeps x = 0 in place, as mirroring a `Neutral` does."""


@dataclass(frozen=True)
class Neutral:
    """The performer's neutral face and usual pose.

    Attributes
    ----------
    shape : (66, 3) float64
        Mean pose-free shape: head frame, outer-eye distances.
    rotation : (3, 3) float64
        Rotation at which the avatar looks straight ahead: that of the time chosen by the user, as the camera may be
        below or beside the screen; otherwise that of a head that faces the camera, as the eyes show.
    position : (3,) float64
        `(s, tx, ty)`, medians of the take, in pixels per outer-eye distance and pixels.
    start, end : float
        Span of the take that was averaged, in seconds.
    shut : float
        Opening at which the performer's eyes count as shut, as a fraction of the neutral one: small, but not 0, as
        lashes and blur keep tracked lids apart. 0 if the take shows no shut eyes.
    gaze : (2,) float64
        Gaze `(pitch, yaw)` in radians at which the avatar looks straight ahead. NaN if the take has none.
    open_mouth : float
        Aperture of the wide-open mouth in outer-eye distances; NaN if unknown.
    removed : float
        Largest activation of an expression that was removed because no moment of the take was neutral: 0 for none, 1
        for instance for a full smile.
    vergence : float
        Vergence of the face at rest in radians; NaN if unknown. Unlike a usual gaze, crossed eyes may last.
    actions : (15,) float64
        Activations of the face at rest, before they are subtracted; NaN if unknown.
    measured : bool
        Whether the shapes were measured on a mesh, so that they need none of the corrections of tracked performances.
    asked : bool
        Whether the performer was asked to rest, or the user chose the moment. If not, it was found automatically, and a
        live performance continues to look for a better one.

    Examples
    --------
    >>> from facemime import Neutral, calibrate, load_take
    >>> neutral: Neutral = calibrate(load_take("performance.facetake"))
    >>> neutral.shape.shape
    (66, 3)
    """

    shape: FloatArray
    rotation: FloatArray
    position: FloatArray
    start: float
    end: float
    shut: float = 0.0
    gaze: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    open_mouth: float = np.nan
    removed: float = 0.0
    vergence: float = np.nan
    actions: FloatArray = field(default_factory=lambda: np.full(N_ACTIONS, np.nan))
    measured: bool = False
    asked: bool = True

    @property
    def is_estimated(self) -> bool:
        """Whether even the calmest moment showed an expression, so that this face is an estimate."""
        return self.removed > _MUCH_REMOVED

    @property
    def warning(self) -> str:
        """Warning about this neutral face for the user; "" if there is none."""
        if not self.is_estimated:
            return ""
        return Message("The performer never rests in this take, so the neutral face was estimated. Check the motion.")

    @property
    def mouth_gain(self) -> float:
        """Factor of the lower face's vertical motion that turns the performer's widest opening into a wide one."""
        opened = self.open_mouth - float(mouth_aperture(self.shape))
        if not opened > _MIN_OPENING:
            return 1.0
        return float(np.clip(_WIDE_OPENING / opened, 1.0, _MAX_GAIN))

    def mirrored(self) -> Neutral:
        """Return the neutral face of the mirrored performer, in an image of the width `MIRROR_WIDTH`."""
        flip = np.array([-1.0, 1.0, 1.0])
        return replace(
            self,
            shape=(self.shape * flip)[MIRROR],
            rotation=self.rotation * np.outer(flip, flip),
            position=self.position * (1.0, -1.0, 1.0),
            gaze=self.gaze * (1.0, -1.0),
            actions=self.actions[ACTION_MIRROR],
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to lists and numbers for JSON; unknown values become None."""
        return {f.name: _plain(np.asarray(getattr(self, f.name), dtype=np.float64)) for f in fields(self)}

    @classmethod
    def from_json(cls, text: str) -> Neutral:
        """Parse the JSON of `to_dict`; SourceError as for `from_dict`."""
        try:
            return cls.from_dict(as_object(parse_json(text), "it"))
        except ValueError as error:
            raise SourceError("The stored calibration is damaged ({error}). Calibrate again.", error=error) from error

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Neutral:
        """Convert from the result of `to_dict`.

        Raises
        ------
        SourceError
            If a value is missing or impossible.
        """
        shapes = {
            "shape": (N_LANDMARKS, 3),
            "rotation": (3, 3),
            "position": (3,),
            "gaze": (2,),
            "actions": (N_ACTIONS,),
        }
        values: dict[str, Any] = {}
        for name in (f.name for f in fields(cls)):
            try:
                value = np.array(data.get(name, _ADDED[name]) if name in _ADDED else data[name], dtype=np.float64)
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise SourceError("The stored calibration is damaged ({name}). Calibrate again.", name=name) from error
            known = np.isfinite(value) | ((name in _OPTIONAL) & np.isnan(value))
            within = np.abs(np.nan_to_num(value)).max(initial=0.0) <= _MAX_VALUES.get(name, _MAX_VALUE)
            if value.shape != shapes.get(name, ()) or not known.all() or not within:
                raise SourceError("The stored calibration is damaged ({name}). Calibrate again.", name=name)
            values[name] = value if name in shapes else float(value)
        values |= {name: bool(values[name]) for name in ("measured", "asked")}
        neutral = cls(**values)
        turn = neutral.rotation
        sound = {
            "rotation": np.allclose(turn @ turn.T, np.eye(3), atol=_ROTATION_ERROR) and linalg.det(turn) > 0.0,
            "position": neutral.position[0] > 0.0,
            "shut": 0.0 <= neutral.shut < MAX_SHUT,
            "removed": neutral.removed >= 0.0,
            "shape": _is_face(neutral.shape),
        }
        if wrong := [name for name, is_sound in sound.items() if not is_sound]:
            raise SourceError("The stored calibration is damaged ({name}). Calibrate again.", name=wrong[0])
        return neutral


def _is_face(shape: FloatArray) -> bool:
    """Whether each region of a shape (66, 3) has some width and height."""
    return all(float(rms_extent(shape[region.landmarks]).min()) > _MIN_EXTENT for region in REGIONS)


def _plain(value: FloatArray) -> Any:
    if value.ndim:
        return [_plain(item) for item in value]
    return float(value) if np.isfinite(value) else None


def calibrate(take: Take, start: float | None = None, duration: float = 1.0) -> Neutral:
    """Find the performer's neutral face in a take.

    Parameters
    ----------
    take : Take
        The take.
    start : float, optional
        Start in seconds of the time to average. By default the calibration that the take contains is used; without one,
        the calmest moment is found, and any expression is removed from it (equation 4.1).
    duration : float
        Length of the time to average in seconds.

    Returns
    -------
    Neutral
        The neutral face. With `start`, the head looks straight ahead when it is as in that time; otherwise when it
        faces the camera.

    Raises
    ------
    SourceError
        If there is no face in that time, or in the whole take.

    Examples
    --------
    >>> from facemime import calibrate, load_take
    >>> take = load_take("performance.facetake")
    >>> neutral = calibrate(take)  # the calmest moment
    >>> neutral = calibrate(take, start=0.5)  # the performer was asked to relax from here on
    """
    if not take.found.any():
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    if start is None and "calibration" in take.info:
        return Neutral.from_dict(take.info["calibration"])
    return calmest(take) if start is None else _average(take, start, duration)


def _average(take: Take, start: float, duration: float) -> Neutral:
    """Return the neutral face of a given time."""
    chosen = take.found & (take.times >= start - 1e-9) & (take.times <= start + duration)
    if not chosen.any():
        raise SourceError(
            "No face was found between {start:.2f} s and {end:.2f} s. Choose another neutral.",
            start=start,
            end=start + duration,
        )
    shapes = take.shape[chosen].astype(np.float64)
    # Use the half of the frames nearest to their median, so that the beginning or end of a smile or blink is left out.
    away = np.linalg.norm(shapes - np.median(shapes, axis=0), axis=2).mean(axis=1)
    pitch, yaw, roll = (float(a) for a in np.median(take.pose[chosen, 1:4], axis=0))
    rested = np.flatnonzero(chosen)[away <= np.median(away)]
    neutral = _neutral(take, shapes[away <= np.median(away)].mean(axis=0), rested, euler_to_matrix(pitch, yaw, roll))
    return replace(neutral, start=float(take.times[chosen][0]), end=float(take.times[chosen][-1]))


def calmest(take: Take, *, prior: bool = True) -> Neutral:
    """Return the neutral face of the calmest moment, without the expression that it shows.

    Without `prior`, it is not moved towards the mean of people's faces.
    """
    found = np.flatnonzero(take.found)
    chosen = found[np.unique(np.linspace(0, len(found) - 1, min(_MAX_FRAMES, len(found))).astype(np.intp))]
    activations = load_face_space().explain(take.shape[chosen].astype(np.float64), trust(take, chosen))
    amount, strong = expressed(take, chosen, activations)
    # The moment whose calmer half shows least.
    times = take.times[chosen]
    spans = [np.arange(i, end) for i, end in enumerate(np.searchsorted(times, times + _MOMENT, side="right"))]
    calmer = [span[np.argsort(amount[span])[: (len(span) + 1) // 2]] for span in spans]
    calm = min(calmer, key=lambda span: float(amount[span].mean()))
    return _without(strong[calm], take, chosen[calm], np.full(len(calm), 1.0 / len(calm)), prior=prior)


def rest_of(take: Take, frames: IntArray, activations: FloatArray) -> Neutral:
    """Estimate the face at rest from all calm frames, without the expression of which `explain` found the activations.

    It changes little as the performance continues, unlike the calmest moment, which `calibrate` finds.
    """
    amount, strong = expressed(take, frames, activations)
    share = np.exp((amount.min() - amount) / _CALM)
    return _without(strong, take, frames, share / share.sum())


def _without(strong: FloatArray, take: Take, frames: IntArray, share: FloatArray, *, prior: bool = True) -> Neutral:
    """Return the neutral face of frames, averaged by `share` (N,), without their expressions `strong` (N, U)."""
    added = np.tensordot(share @ strong, load_face_space().units, 1)
    shape = np.tensordot(share, take.shape[frames].astype(np.float64), 1) - added
    own = np.ones(N_ACTIONS)  # share of the activations that is the person's own
    if prior and not take.info.get("measured"):
        actions = share @ take.actions[frames]
        acted = float(actions[_BROW_ACTIONS].max())  # NaN if unknown
        brows = min(acted / _ACTED, 1.0) if np.isfinite(acted) else 1.0
        knitted = frowning(shape, float(np.nan_to_num(actions[_FROWN]).min()))
        shape = resting_shape(shape, brows, mouth_aperture(take.shape[take.found].astype(np.float64)), knitted)
        own[_FROWN] -= knitted
    rested = np.sort(frames[share >= 0.5 * share.max()])
    neutral = _neutral(take, shape, rested, facing(take))
    removed = float((share @ strong).max())
    actions = np.minimum(own * neutral.actions, _MOST_AT_REST)
    return replace(neutral, actions=actions, removed=removed, asked=False)


def _neutral(take: Take, shape: FloatArray, rested: IntArray, rotation: FloatArray) -> Neutral:
    """Return the neutral face with the given shape and rotation, from the frames `rested`."""
    found = take.found
    return Neutral(
        shape=shape,
        rotation=rotation,
        position=np.median(take.pose[found][:, [0, 4, 5]], axis=0),
        start=float(take.times[rested[0]]),
        end=float(take.times[rested[-1]]),
        shut=shut_level(shape, take.shape[found].astype(np.float64)),
        gaze=usual_gaze(take, rotation),
        vergence=float(median_of_known(take.vergence[rested, None])[0]),
        actions=median_of_known(take.actions[rested]),
        measured=bool(take.info.get("measured")),
    )

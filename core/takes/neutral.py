"""The performer's neutral face, from which expressions are measured (method.md, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..errors import Message, SourceError
from ..face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    LOWER_LIPS,
    MIRROR,
    N_LANDMARKS,
    NOSE,
    UPPER_LIPS,
    eye_apertures,
    mouth_aperture,
)
from ..face.names import ACTION_MIRROR, ACTIONS, N_ACTIONS, action_indices
from ..face.rotation import euler_to_matrix
from ..files.reading import as_object, parse_json
from ..heads.regions import REGIONS, rms_extent
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray
from .face_space import load_face_space, without_similarity
from .facing import facing, usual_gaze
from .take import Take

MAX_SHUT = 0.45
"""Largest opening of the eyes, relative to the neutral one, that can count as shut."""
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
_TURNED = 0.5
"""Angle in radians, of pitch and yaw together, at which the weight of a frame is 1/e."""
_MIN_TRUST = 1e-3
"""Smallest weight of a frame."""
_CALM = 0.08
"""Amount of expression, in eye distances, above that of the calmest frame, at which the weight of a frame is 1/e in
`rest_of`. On the clips of `lab.bench.expressions`, 0.01 to 0.08 are about as accurate; the more frames count, the
steadier the result."""
_DOUBT = 0.2
"""Amount of expression, in eye distances, that a confidence of 0 counts as."""
_USUAL = 0.35
"""Largest share of a take in which brows are lower than at rest. From 0.3 to 0.35 the same moments are found."""
_LIDS = 0.5
"""Amount of expression, in eye distances, of lids that are open twice as far as usual. Lids move little, and yet
half-shut eyes are no neutral face."""
_LIDS_AT_REST = 0.1
"""Difference from the usual opening of the eyes, relative to it, that may be rest."""
_WEAK = 0.3
"""Activation up to which an expression may be the person's own face."""
_MUCH_REMOVED = 0.35
"""Activation above which an expression that was removed is reported."""
_TOWARDS_MEAN = 0.5
"""Share of the way to the mean of people's faces, as far as expressions lead there, so that one that lasts does not
pass for rest. On the strangers' clips of `lab.bench.strangers`, the more the better the frames of different people
compare, on either half; beyond 0.5 the signs of the hand-labelled clips get worse, as a person's own brows pass for
expression."""
_ACTED = 0.5
"""Activation of the brows' actions from which their height at rest counts as unknown. Where the network sees less of
any, their height is more and more the person's own. From 0.45 to 0.6 frames of strangers compare alike."""
_ALONG_EYE = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0]) / 3.0 - 0.5
"""Places of an eye's landmarks between its corners, from the middle, in iBUG's order."""
_BROW_ACTIONS = action_indices(name for name in ACTIONS if name.startswith("brow"))
_SEALED = 0.15
"""Share of a take in which the lips are at most as far apart as at rest. Chosen on one half of the strangers' clips."""
_MAX_SEALED = 0.04
"""Largest gap, in eye distances, of lips that count as shut, which lips that are seen from below, bearded or blurred
have. Chosen likewise: with 0.03 fewer shut lips are shown as such, with 0.05 fewer of those that are slightly apart."""
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
    amount, strong = _expressed(take, chosen, activations)
    # The moment whose calmer half shows least.
    times = take.times[chosen]
    spans = [np.arange(i, end) for i, end in enumerate(np.searchsorted(times, times + _MOMENT, side="right"))]
    calmer = [span[np.argsort(amount[span])[: (len(span) + 1) // 2]] for span in spans]
    calm = min(calmer, key=lambda span: float(amount[span].mean()))
    return _without(strong[calm], take, chosen[calm], np.full(len(calm), 1.0 / len(calm)), prior=prior)


def trust(take: Take, frames: IntArray) -> FloatArray:
    """Compute the frames' weights for `FaceSpace.explain`: positive, and lower for turned and uncertain faces."""
    turned = np.square(take.pose[frames, 1:3] / _TURNED).sum(axis=1)
    return np.asarray(take.confidence[frames] * np.exp(-turned) + _MIN_TRUST)


def rest_of(take: Take, frames: IntArray, activations: FloatArray) -> Neutral:
    """Estimate the face at rest from all calm frames, without the expression of which `explain` found the activations.

    It changes little as the performance continues, unlike the calmest moment, which `calibrate` finds.
    """
    amount, strong = _expressed(take, frames, activations)
    share = np.exp((amount.min() - amount) / _CALM)
    return _without(strong, take, frames, share / share.sum())


def _expressed(take: Take, frames: IntArray, activations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of frames from rest in eye distances, (N,), and the activations that are expression, (N, U)."""
    space = load_face_space()
    # The height of brows at rest differs more between people than the space covers, so it is taken from the take.
    usual = np.where(space.of_brows, np.quantile(activations, _USUAL, axis=0), 0.0)
    opening = eye_apertures(take.shape[frames].astype(np.float64)).mean(axis=1)
    amount = space.amount(activations - usual) + _DOUBT * (1.0 - take.confidence[frames])
    amount += _LIDS * np.maximum(np.abs(opening / np.median(opening) - 1.0) - _LIDS_AT_REST, 0.0)
    # Weak activations may be the person's own face; strong ones are expressions, which a face at rest would not show.
    return amount, np.maximum(activations - np.maximum(usual, _WEAK), 0.0)


def _without(strong: FloatArray, take: Take, frames: IntArray, share: FloatArray, *, prior: bool = True) -> Neutral:
    """Return the neutral face of frames, averaged by `share` (N,), without their expressions `strong` (N, U)."""
    added = np.tensordot(share @ strong, load_face_space().units, 1)
    shape = np.tensordot(share, take.shape[frames].astype(np.float64), 1) - added
    if prior and not take.info.get("measured"):
        acted = float((share @ take.actions[frames][:, _BROW_ACTIONS]).max())  # NaN if unknown
        brows = min(acted / _ACTED, 1.0) if np.isfinite(acted) else 1.0
        shape = _at_rest(shape, brows, mouth_aperture(take.shape[take.found].astype(np.float64)))
    rested = np.sort(frames[share >= 0.5 * share.max()])
    return replace(_neutral(take, shape, rested, facing(take)), removed=float((share @ strong).max()), asked=False)


def _at_rest(shape: FloatArray, brows: float, openings: FloatArray) -> FloatArray:
    """Move a shape (66, 3) towards the mean of people's faces, with lips as far apart as the take's shut ones.

    The mean keeps an expression that lasts from passing for rest. `brows` is the doubt, 0 to 1, whether these rest;
    `openings` (N,) are those of the mouth. Pose and size of the face stay.
    """
    space = load_face_space()
    away = without_similarity((shape - space.mean)[None], space.mean)[0]
    expressed = space.expressed(away)
    # Heights of brows and lids differ more between people than the space covers: all of it may be expression. The
    # sockets of the eyes and the bridge of the nose do not move, or lids would slide off the eyeballs, so lids are
    # measured from the line between the corners of their eye, and brows from its middle.
    expressed[BROWS, 1] = brows * away[BROWS, 1]
    expressed[NOSE[:4]] = 0.0
    for eye, brow in ((EYE_RIGHT, BROWS[:5]), (EYE_LEFT, BROWS[5:])):
        first, last = away[eye[[0, 3]], 1]
        expressed[eye] = 0.0
        expressed[eye, 1] = away[eye, 1] - 0.5 * (first + last) - _ALONG_EYE * (last - first)
        expressed[brow, 1] -= 0.5 * (first + last)
    rest = shape - _TOWARDS_MEAN * expressed
    # The tracker sees shut lips of one person closer together than those of another.
    gap = min(max(float(np.quantile(openings, _SEALED)), float(mouth_aperture(shape))), _MAX_SEALED)
    lacking = max(gap - float(mouth_aperture(rest)), 0.0)
    rest[UPPER_LIPS, 1] -= lacking / 2.0
    rest[LOWER_LIPS, 1] += lacking / 2.0
    return np.asarray(rest)


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
        vergence=float(_usual(take.vergence[rested, None])[0]),
        actions=_usual(take.actions[rested]),
        measured=bool(take.info.get("measured")),
    )


def shut_level(neutral: FloatArray, shapes: FloatArray) -> float:
    """Estimate `Neutral.shut`: how much of the opening remains when the eyes are most closed; 0 if they never shut.

    The third smallest opening of the shapes (N, 66, 3) is used, as a blink lasts several frames at any usual rate, a
    misplaced lid one or two.
    """
    opening = eye_apertures(shapes).mean(axis=1)
    at_rest = float(eye_apertures(neutral).mean())
    least = np.sort(opening)[min(2, len(opening) - 1)]
    left = float(np.clip(least / max(at_rest, 1e-9), 0.0, 1.0))
    return left if left < MAX_SHUT else 0.0


def _usual(values: FloatArray) -> FloatArray:
    """Median over frames (N, D), (D,); NaN if none is known."""
    known = values[np.isfinite(values).all(axis=1)].astype(np.float64)
    return np.median(known, axis=0) if len(known) else np.full(values.shape[1], np.nan)

"""ARKit's 52 coefficients of a take (method.md, section 9.3).

They serve other programs, tables and key mappings; a head that is driven directly does not need them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..drive.actions import ActionDriver
from ..drive.drive_settings import DriveSettings, PosingSettings
from ..drive.posing import EyeDriver, measured_eyes
from ..drive.retarget import retargeter_for
from ..errors import SourceError
from ..face.landmarks import outer_eye_distance
from ..face.names import ACTIONS, COEFFICIENT_INDEX, COEFFICIENTS, EXCLUSIVE, FITTED, action_indices
from ..face.rotation import euler_to_matrix, limit_rotation
from ..heads.built_in import LOOKS, landmarks_at_rest, load_head, looks_of
from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply
from ..takes.face_space import without_similarity
from ..takes.neutral import MIRROR_WIDTH, Neutral
from ..takes.take import Take
from ..tracking.result import TrackResult, mirror_result
from .coefficients import CLOSES, LIP_GAP, OPENS, CoefficientSolver, has_actions, load_coefficient_model
from .fit import fit_keys
from .likeness import alike
from .own_keys import BLINKS

__all__ = ["COEFFICIENTS", "FrameCoefficients", "arkit_coefficients", "coefficients_of"]


class Observer:
    """Observes the face of a performer as that of the built-in head.

    The options are strength, mirror, the limits of the eyes, and whether only landmarks count. Depths are always used,
    although they are hardly known.
    """

    def __init__(self, neutral: Neutral, options: DriveSettings) -> None:
        landmarks = landmarks_at_rest()
        self._unit, self._own = outer_eye_distance(landmarks), _own_motion()
        self.options = options
        self.neutral = neutral.mirrored() if options.mirror else neutral
        self._retargeter = retargeter_for(self.neutral, landmarks, strength=options.strength, fitted=True)
        self._avatar = retargeter_for(self.neutral, landmarks, strength=options.strength)
        self._actions = ActionDriver(self.neutral.actions, self.neutral.shape, options.strength)
        self._gains = _gains(options)
        self._eyes = EyeDriver(self.neutral.gaze, self.neutral.vergence)

    def mirrored(self, result: TrackResult) -> TrackResult:
        """Return the result as the other methods expect it, flipped left to right if the settings say so."""
        return mirror_result(result, MIRROR_WIDTH) if self.options.mirror else result

    def displacements(self, result: TrackResult) -> FloatArray:
        """Return the displacements of the built-in head's landmarks, (66, 3), in its unit, as the model knows them."""
        return self._retargeter.displacements(result.shape, result.teeth)

    def driven(self, result: TrackResult) -> FloatArray:
        """Return those of the driven head, (198,), in outer-eye distances."""
        return np.asarray((self._avatar.displacements(result.shape, result.teeth) / self._unit).ravel())

    def face(self, result: TrackResult) -> FloatArray:
        """Return the observation of a frame, (213,).

        It contains the displacements without those of the whole head, in outer-eye distances, and the activations above
        rest, which are NaN if they are unknown or ignored.
        """
        own = multiply((self.displacements(result) / self._unit).ravel(), self._own)
        above = np.full(len(ACTIONS), np.nan)
        if not self.options.only_landmarks:
            above = self._actions.above_rest(result.actions, result.shape) * self._actions.gains
        return np.concatenate([own, above])

    def stated(self, result: TrackResult) -> FloatArray:
        """Return the coefficients stated by the source, (52,), times the strength of their region; NaN without any."""
        return np.asarray(np.clip(result.coefficients * self._gains, 0.0, 1.0))

    def shown(self, result: TrackResult) -> FloatArray:
        """Return the activations that an avatar would show (equation 4.6), (15,)."""
        if self.options.only_landmarks:
            return np.zeros(len(ACTIONS))
        return self._actions.activations(result.actions, result.shape)

    def gaze(self, result: TrackResult) -> FloatArray:
        """Return the rotations of the right and left eyeball, (2, 3, 3). Frames have to be passed in order."""
        posing = self.options.posing
        turned = euler_to_matrix(*result.pose[1:4]) @ self.neutral.rotation.T
        if self.neutral.measured and np.isfinite(result.gaze).all():
            eyes = measured_eyes(result.gaze - self.neutral.gaze, result.vergence - self.neutral.vergence)
        else:
            eyes = self._eyes.rotations(result.gaze, result.vergence, turned)
        return np.stack([limit_rotation(eye, posing.eyes_strength, posing.eyes_limit) for eye in eyes])


def _gains(options: DriveSettings) -> FloatArray:
    """Strength of each coefficient, (52,), which is that of its region or of the eyes' direction."""
    upper, middle, lower = options.strength

    def gain(name: str) -> float:
        if name.startswith("eyeLook"):
            return options.posing.eyes_strength
        if name.startswith(("brow", "eye")):
            return upper
        return middle if name.startswith(("cheek", "nose")) else lower

    return np.array([gain(name) for name in COEFFICIENTS])


@lru_cache(maxsize=1)
def _own_motion() -> FloatArray:
    """Projection, (198, 198), whose rows map coordinates to what remains without the motion of the whole head.

    Removing a similarity is linear.
    """
    landmarks = landmarks_at_rest()
    every = np.eye(landmarks.size).reshape(-1, *landmarks.shape)
    return without_similarity(every, landmarks / outer_eye_distance(landmarks)).reshape(len(every), -1)


_DEFAULTS = DriveSettings()
_PAIRS = [(int(one), int(other)) for one, other in np.searchsorted(FITTED, EXCLUSIVE)]
"""Pairs of the coefficients `FITTED` that exclude each other."""
_MEASURED = {
    "tongueOut": action_indices(["tongueOut"]),
    "cheekPuff": action_indices(["cheekPuffRight", "cheekPuffLeft"]),
    "browDownLeft": action_indices(["browDownLeft"]),
    "browDownRight": action_indices(["browDownRight"]),
}
"""Coefficients that landmarks hardly show, or swallow, and the actions whose mean is the least value of each."""
_SLOPES = {"browInnerUp": 0.54, "browOuterUpLeft": 0.72, "browOuterUpRight": 0.72}
"""Slopes of coefficients against those of the model near rest: the brows of ICT-FaceKit, on which it was trained, rise
by 7.1 and 9.7 % of the eye distance, and those that phones mean by 13.1 and 13.5 %."""

_SHUT = 0.03
"""Gap of the lips, in outer-eye distances, up to which they count as shut, as in `lab.bench.strangers`."""
_PARTED = 0.08
"""Gap from which they count as parted."""


def arkit_coefficients(
    take: Take,
    neutral: Neutral,
    options: DriveSettings = _DEFAULTS,
    looks: FloatArray | None = None,
    lids: FloatArray | None = None,
) -> FloatArray:
    """Compute ARKit's coefficients of a take.

    Parameters
    ----------
    take : Take
        The take.
    neutral : Neutral
        The performer's neutral face.
    options : DriveSettings
        Strength, mirror, the settings of the eyes, and whether only landmarks count; other settings are not used.
    looks : (8,) float64, optional
        Factors of the eyes' directions, from `look_factors`, for the keys of a head; by default those of a phone.
    lids : (2,) float64, optional
        Factors of the left and the right blink, from `lid_factors`, which are above 1 if keys leave eyes open at 1. The
        result then contains blinks above 1.

    Returns
    -------
    (N, 52) float64
        Coefficients, 0 to 1, of the frames with a face. Those of the eyes' direction come from the gaze; the others are
        fitted to the landmarks and the measured actions. Landmarks that were measured on a mesh are taken as exact, so
        that weights of the built-in head's units are recovered within about 2 %. Coefficients stated by the source are
        used as they are, times the strength of their region.

    Raises
    ------
    SourceError
        If no frame has a face.

    Examples
    --------
    >>> from facemime import COEFFICIENTS, arkit_coefficients, calibrate, load_take
    >>> take = load_take("performance.facetake")
    >>> values = arkit_coefficients(take, calibrate(take))
    >>> jaw = values[:, COEFFICIENTS.index("jawOpen")]
    >>> values.shape, jaw.shape  # of frames with a face
    ((59, 52), (59,))
    """
    posing = PosingSettings(eyes_strength=options.posing.eyes_strength, eyes_limit=options.posing.eyes_limit)
    observer = Observer(neutral, replace(options, posing=posing))
    results = [observer.mirrored(take.result(int(frame))) for frame in np.flatnonzero(take.found)]
    if not results:
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    stated = np.array([observer.stated(result) for result in results])
    known = np.isfinite(stated).all(axis=1)
    if not known.all():
        found = _found(observer, results)
        stated[~known] = _scaled(found[~known], looks, lids)
    return stated


def _found(observer: Observer, results: Sequence[TrackResult]) -> FloatArray:
    """Fit coefficients, (N, 52), to the tracked or measured results of a take."""
    gaze = np.array([observer.gaze(result) for result in results])
    if observer.neutral.measured:
        moved = np.array([observer.displacements(result) for result in results])
        return _with_looks(_fitted(moved), gaze)
    return coefficients_of(
        np.array([observer.face(result) for result in results]),
        np.array([observer.driven(result) for result in results]),
        gaze,
        np.array([observer.shown(result) for result in results]),
        np.array([result.teeth for result in results]),
    )


class FrameCoefficients:
    """Finds the coefficients of single frames, as in a live performance; the options are as for `arkit_coefficients`.

    The neutral face is the performer's, not mirrored.
    """

    def __init__(
        self,
        neutral: Neutral,
        options: DriveSettings,
        looks: FloatArray | None = None,
        lids: FloatArray | None = None,
    ) -> None:
        posing = PosingSettings(eyes_strength=options.posing.eyes_strength, eyes_limit=options.posing.eyes_limit)
        self._looks, self._lids = looks, lids
        self._observer = Observer(neutral, replace(options, posing=posing))
        self._measured = neutral.measured
        self._near = np.zeros((1, len(FITTED)))

    def of(self, result: TrackResult) -> FloatArray:
        """Return the coefficients, (52,), of a frame with a face. Frames have to be passed in order."""
        result = self._observer.mirrored(result)
        stated = self._observer.stated(result)
        if np.isfinite(stated).all():
            return stated
        return np.asarray(_scaled(self._found(result), self._looks, self._lids)[0])

    def _found(self, result: TrackResult) -> FloatArray:
        """Fit the coefficients (1, 52) of a frame."""
        gaze = self._observer.gaze(result)[None]
        if self._measured:
            return _with_looks(_fitted(self._observer.displacements(result)[None]), gaze)
        observed = self._observer.face(result)[None]
        actions = bool(has_actions(observed)[0])
        fitted = _solver(actions).frames(observed, self._near)
        driven, shown = self._observer.driven(result)[None], self._observer.shown(result)[None]
        return _completed(fitted, driven, gaze, shown, np.array([result.teeth]))


def _scaled(coefficients: FloatArray, looks: FloatArray | None, lids: FloatArray | None) -> FloatArray:
    """Scale the directions of the eyes and the blinks in coefficients (N, 52), in place."""
    if looks is not None:
        coefficients[:, LOOKS] = np.clip(coefficients[:, LOOKS] * looks, 0.0, 1.0)
    if lids is not None:
        coefficients[:, BLINKS] *= lids
    return coefficients


def coefficients_of(
    observed: FloatArray,
    driven: FloatArray,
    gaze: FloatArray,
    shown: FloatArray,
    teeth: FloatArray | None = None,
) -> FloatArray:
    """Find the coefficients (N, 52), 0 to 1, of frames of one performer from what `Observer` gives.

    These are observations (N, 213), displacements of the driven head (N, 198), rotations (N, 2, 3, 3) of the right and
    left eyeball, and activations (N, 15) of `ACTIONS`; `teeth` (N,) are as in `TrackResult`.
    """
    fitted = np.zeros((len(observed), len(FITTED)))
    complete = has_actions(observed)
    for actions in set(complete.tolist()):
        rows = np.flatnonzero(complete == actions)
        fitted[rows] = _solver(actions).take(observed[rows])
    return _completed(fitted, driven, gaze, shown, teeth)


def _completed(
    fitted: FloatArray, driven: FloatArray, gaze: FloatArray, shown: FloatArray, teeth: FloatArray | None
) -> FloatArray:
    """Turn the coefficients `FITTED` of the model, (N, 44), into all, (N, 52), that look as the driven head does."""
    found = alike(_with_measured(_with_looks(_as_phones(fitted), gaze), shown), driven, teeth)
    found[:, FITTED] = _sealed(found[:, FITTED], driven)
    return found


def _sealed(fitted: FloatArray, driven: FloatArray) -> FloatArray:
    """Shut the lips in coefficients (N, 44) where those of the driven head, (N, 198), are shut, in place.

    What is left of many small coefficients would open them: the lips are shut by mouthClose as far as the jaw is open,
    and then by less of what opens them.
    """
    gaps, opens = _lip_gaps()
    seen = driven @ LIP_GAP
    shut = np.clip((_PARTED - seen) / (_PARTED - _SHUT), 0.0, 1.0)
    excess = shut * np.maximum(fitted @ gaps - np.maximum(seen, 0.0), 0.0)
    closes = np.minimum(excess / -gaps[CLOSES], np.maximum(fitted[:, OPENS] - fitted[:, CLOSES], 0.0))
    fitted[:, CLOSES] += closes
    excess += closes * gaps[CLOSES]
    share = np.clip(excess / np.maximum(fitted[:, opens] @ gaps[opens], 1e-9), 0.0, 1.0)
    fitted[:, opens] *= 1.0 - share[:, None]
    return fitted


@lru_cache(maxsize=1)
def _lip_gaps() -> tuple[FloatArray, NDArray[np.intp]]:
    """Return how far coefficients `FITTED` open the lips of the built-in head at 1, (44,), in outer-eye distances, and
    the positions of those that do, except for the jaw.
    """
    head, unit = load_head(), outer_eye_distance(landmarks_at_rest())
    units = head.units[FITTED][:, head.landmarks].astype(np.float64) / unit
    gaps = np.asarray(units.reshape(len(FITTED), -1) @ LIP_GAP)
    return gaps, np.setdiff1d(np.flatnonzero(gaps > 0.0), [OPENS])


def _as_phones(fitted: FloatArray) -> FloatArray:
    """Give the coefficients `FITTED` of the model, (N, 44), the amplitude that phones mean, ``a (s + (1 - s) a)``.

    A brow that is raised in full stays so, as the model states 1 for all higher ones.
    """
    slopes = np.array([_SLOPES.get(COEFFICIENTS[column], 1.0) for column in FITTED])
    return np.asarray(fitted * (slopes + (1.0 - slopes) * fitted))


@lru_cache(maxsize=2)
def _solver(actions: bool) -> CoefficientSolver:
    return CoefficientSolver(load_coefficient_model(), actions=actions)


def _with_measured(coefficients: FloatArray, shown: FloatArray) -> FloatArray:
    """Raise `coefficients` (N, 52) that landmarks hardly show to the values of their actions, in place."""
    for name, columns in _MEASURED.items():
        column = coefficients[:, COEFFICIENT_INDEX[name]]
        np.maximum(column, shown[:, columns].mean(axis=1).clip(0.0, 1.0), out=column)
    return coefficients


def _fitted(moved: FloatArray) -> FloatArray:
    """Fit the coefficients `FITTED`, (N, 44), to exact displacements (N, 66, 3) of the built-in head's landmarks."""
    head = load_head()
    units = head.units[FITTED][:, head.landmarks]
    return fit_keys(moved, units, np.zeros(len(FITTED)), np.ones(len(FITTED)), _PAIRS).weights


def _with_looks(fitted: FloatArray, gaze: FloatArray) -> FloatArray:
    """Combine the 44 coefficients `FITTED` with those of the eyes' directions, (N, 52)."""
    coefficients = np.zeros((len(fitted), len(COEFFICIENTS)))
    coefficients[:, FITTED] = fitted
    coefficients[:, LOOKS] = looks_of(gaze)
    return coefficients

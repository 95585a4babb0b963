"""ARKit's 52 coefficients of a take, by fitting the built-in head, which has these units (docs/method.md, section 9.3).

Other programs and tables describe a face by them; a head that is driven directly does not need them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..actions import ACTIONS, action_indices
from ..arrays import FloatArray
from ..drive.driver import HeadDriver
from ..drive.motion import HeadMotion, drive_take
from ..drive.settings import DriveSettings, PosingSettings
from ..heads.built_in import load_head
from ..heads.rig import built_in_rig
from ..rotation import fit_rotation
from ..takes.neutral import Neutral
from ..takes.take import Take
from .fit import fit_keys

_SIDED = (
    *("browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp"),
    *("eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown", "mouthPress", "mouthSmile"),
    *("mouthStretch", "mouthUpperUp", "noseSneer"),
)
_SINGLE = (
    *("browInnerUp", "cheekPuff", "jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose", "mouthFunnel"),
    *("mouthLeft", "mouthPucker", "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower"),
    *("mouthShrugUpper", "tongueOut"),
)
COEFFICIENTS = tuple(sorted([*_SINGLE, *(name + side for name in _SIDED for side in ("Left", "Right"))]))
"""Names of the 52 coefficients, alphabetically; left and right are the performer's own."""
_DEFAULTS = DriveSettings()
_ACTED = {
    "tongueOut": action_indices(["tongueOut"]),
    "cheekPuff": action_indices(["cheekPuffRight", "cheekPuffLeft"]),
    **{name: action_indices([name]) for name in ACTIONS if name.startswith(("mouth", "nose", "cheekSquint"))},
}
"""Coefficients that the tracker measures itself, and the actions whose mean each is."""
_LOOKS = ("In", "Out", "Up", "Down")


def arkit_coefficients(take: Take, neutral: Neutral, options: DriveSettings = _DEFAULTS) -> FloatArray:
    """Compute ARKit's coefficients of a take.

    Parameters
    ----------
    take : Take
        The take.
    neutral : Neutral
        The performer's neutral face.
    options : DriveSettings
        Mode, strength, mirror and the settings of the eyes are used; those of the pose are not.

    Returns
    -------
    (N, 52) float64
        Coefficients from 0 to 1 of the frames with a face. Those of the eyes' direction come from the gaze; the
        others are fitted to the remaining motion.

    Raises
    ------
    SourceError
        If no frame has a face.
    """
    posing = PosingSettings(eyes_strength=options.posing.eyes_strength, eyes_limit=options.posing.eyes_limit)
    options = replace(options, posing=posing, incremental=False)
    return coefficients_of(drive_take(HeadDriver(built_in_rig(), neutral, options), take))


def coefficients_of(motion: HeadMotion) -> FloatArray:
    """(N, 52) coefficients of a motion of the built-in head."""
    head = load_head()
    known, coefficients = _look_columns(), np.zeros((len(motion.times), len(head.unit_names)))
    coefficients[:, known] = _looks(motion.gaze)
    if motion.actions.any():
        for name, columns in _ACTED.items():
            coefficients[:, COEFFICIENTS.index(name)] = motion.actions[:, columns].mean(axis=1).clip(0.0, 1.0)
        known = [*known, *(COEFFICIENTS.index(name) for name in _ACTED)]
    others = [i for i in range(len(head.unit_names)) if i not in known]
    # Gaze and actions decide their coefficients; what these do to the skin is not fitted again.
    explained = np.tensordot(coefficients[:, known].astype(np.float32), head.units[known], axes=1)
    bounds = np.zeros(len(others)), np.ones(len(others))
    coefficients[:, others] = fit_keys(motion.vertices - explained, head.units[others], *bounds).weights
    return coefficients


def _look_columns() -> list[int]:
    return [COEFFICIENTS.index(f"eyeLook{way}{side}") for side in ("Left", "Right") for way in _LOOKS]


def _looks(gaze: FloatArray) -> FloatArray:
    """(N, 8) coefficients of `_look_columns` for rotations (N, 2, 3, 3) of the eyeballs, as shares of each unit's."""
    forward = -gaze[..., 2]
    turned = {
        "x": np.arctan2(forward[..., 0], -forward[..., 2]),
        "y": np.arctan2(forward[..., 1], -forward[..., 2]),
    }
    columns = []
    for side, axis, reach in _look_reaches():
        columns.append(np.clip(turned[axis][:, side] / reach, 0.0, 1.0))
    return np.column_stack(columns)


@lru_cache(maxsize=1)
def _look_reaches() -> list[tuple[int, str, float]]:
    """For each of `_look_columns`, 0 for the right eye and 1 for the left, the axis along which it looks, and its
    signed angle at coefficient 1.
    """
    head = load_head()
    reaches = []
    for column in _look_columns():
        name = head.unit_names[column]
        eye = next(part for part in head.parts if part.name == ("eye_left" if "Left" in name else "eye_right"))
        rest: NDArray[np.float64] = (eye.vertices - eye.pivot).astype(np.float64)
        forward = -fit_rotation(rest, rest + eye.units[column])[:, 2]
        axis = 0 if "In" in name or "Out" in name else 1
        reaches.append((int("Left" in name), "xy"[axis], float(np.arctan2(forward[axis], -forward[2]))))
    return reaches

"""What each of ARKit's units is in terms of MakeHuman's: how far it moves, and which of them it consists of.

The amplitude of a unit is what a phone means by a coefficient of 1. It was compared with three independent sets of
ARKit's keys, A and B scanned or captured, C by an artist, and with ICT-FaceKit's expressions; the factors are those
by which MakeHuman's unit fits a set best. The middle one counts where the sets agree, and a smaller step where one
points the other way. The sets and ICT-FaceKit give these weights only; all shapes are MakeHuman's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_SIDES = ("Left", "Right")
_WHOLE = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
"""Units that are named after a direction and move both sides."""

MIXTURES: dict[str, dict[str, float]] = {
    "browInnerUp": {"browInnerUp": 2.3},  # A 2.3, B 2.2, C 3.4
    # A 2.3, B 2.3 and C 1.5 of MakeHuman's; softened, which lowers its peak by half, that is 3.4, 3.4 and 2.1. The
    # largest motion is then 11.5 % of the eye distance; A's is 13.5 %, ICT-FaceKit's 9.7 %.
    "browOuterUp": {"browOuterUp": 3.3},
    "browDown": {"browDown": 0.8},  # ICT-FaceKit 0.68
    "eyeSquint": {"eyeSquint": 0.75},  # ICT-FaceKit 0.53
    "eyeWide": {"eyeWide": 0.51},  # A 0.51, B 0.47, C 0.70
    # The upper lid rises with the gaze as in a wide eye: the error relative to ICT-FaceKit's falls from 0.81 to 0.43.
    "eyeLookUp": {"eyeLookUp": 0.6, "eyeWide": 0.42},  # A 0.45, B 0.43, C 0.70
    "eyeLookIn": {"eyeLookIn": 2.7},  # A 2.8, B 2.7, C 2.0
    "eyeLookOut": {"eyeLookOut": 2.2},  # A 2.2, B 2.2, C 2.0
    # The upper lip rises a little from the teeth, and returns to them where the lips close over an open jaw.
    "jawOpen": {"jawOpen": 1.0, "mouthUpperUp": 0.45},
    "mouthClose": {"mouthClose": 1.0, "mouthUpperUp": -0.45},
    # MakeHuman's move one side of the jaw or mouth further than the opposite unit moves the other; half of the
    # difference of both moves them alike. Errors relative to ICT-FaceKit's fall from 0.56 to 0.29, and 0.58 to 0.53.
    "jawLeft": {"jawLeft": 0.6, "jawRight": -0.5},
    "jawRight": {"jawRight": 0.6, "jawLeft": -0.5},
    "mouthLeft": {"mouthLeft": 0.75, "mouthRight": -0.4},
    "mouthRight": {"mouthRight": 0.75, "mouthLeft": -0.4},
    # MakeHuman's funnel is a diamond between corners that stay; all sets draw the corners in to an O. A 1.7, B 1.8 and
    # C 1.3 of the diamond; the error relative to ICT-FaceKit's falls from 0.85 to 0.5.
    "mouthFunnel": {"mouthFunnel": 0.45, "mouthPucker": 0.7, "mouthUpperUp": 0.6, "mouthLowerDown": 0.8},
    "mouthPucker": {"mouthPucker": 1.2},  # ICT-FaceKit 1.22; largest motion of A 13.1 %, of MakeHuman's 10.2 %
    "mouthUpperUp": {"mouthUpperUp": 1.3},  # ICT-FaceKit 1.46; largest motion of A 10.8 %, of MakeHuman's 6.9 %
    "mouthStretch": {"mouthStretch": 1.3},  # A 1.7, B 1.7, C 0.9
    "mouthRollLower": {"mouthRollLower": 1.25},  # A 1.7, B 1.6, C 0.7
    "mouthShrugLower": {"mouthShrugLower": 1.15},  # A 1.7, B 1.6, C 0.7
    # The cheek rises and takes the lower lid along. Error relative to ICT-FaceKit's: 0.66 to 0.6.
    "mouthSmile": {"mouthSmile": 0.92, "cheekSquint": 0.4, "mouthDimple": 0.4, "mouthPress": -0.2},
    "mouthFrown": {"mouthFrown": 0.6, "mouthStretch": 0.3, "mouthPress": -0.1},  # ICT-FaceKit: 0.68 to 0.55
    "mouthDimple": {"mouthDimple": 0.7, "mouthPress": -0.45, "mouthSmile": 0.3},  # ICT-FaceKit: 0.99 to 0.85
    "mouthPress": {"mouthPress": 0.6},  # ICT-FaceKit 0.15; MakeHuman's lifts the corner like a smirk
}
"""Weights of MakeHuman's units in those that differ from them, by name. Names without a side stand for those of the
same side, or of both sides in a unit that has none. All weights refer to MakeHuman's own units."""


SOFTENED = {"browOuterUp": 0.008}
"""Radius in metres over which MakeHuman's unit is averaged, by name: the tail of the brow would fold. Of 4, 7, 10 and
14 mm, 7 and 10 fit ICT-FaceKit's best."""


def softened(
    name: str, unit: NDArray[np.float64], points: NDArray[np.float64], skin: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """A unit (N, 3) averaged over the `skin` (N,) around each of its `points` (N, 3), if it is one of `SOFTENED`."""
    radius = SOFTENED.get(_base(name)[0])
    if radius is None:
        return unit
    moved = skin & unit.any(axis=1)
    tree = cKDTree(points[skin])
    near = np.flatnonzero(skin)[cKDTree(points[moved]).query(points[skin])[0] < 2.0 * radius]
    out, own = unit.copy(), unit[skin]
    for row in near:
        rows = tree.query_ball_point(points[row], 3.0 * radius)
        weights = np.exp(-0.5 * np.square(tree.data[rows] - points[row]).sum(axis=1) / radius**2)
        out[row] = weights @ own[rows] / weights.sum()
    return out


def mixed(names: tuple[str, ...], units: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """ARKit's units, from MakeHuman's of the same `names`."""
    known = dict(zip(names, units, strict=True))
    return [sum((w * known[part] for part, w in _parts(name, known)), np.zeros_like(units[0])) for name in names]


def _parts(name: str, known: dict[str, NDArray[np.float64]]) -> list[tuple[str, float]]:
    """MakeHuman's units in a unit, and their weights."""
    base, sides = _base(name)
    parts = []
    for part, weight in MIXTURES.get(base, {name: 1.0}).items():
        parts += [(one, weight) for one in ([part] if part in known else [part + side for side in sides])]
    return parts


def _base(name: str) -> tuple[str, tuple[str, ...]]:
    """A unit's name without its side, and the sides that it moves."""
    side = next((side for side in _SIDES if name.endswith(side) and name not in _WHOLE), "")
    return name.removesuffix(side), (side,) if side else _SIDES

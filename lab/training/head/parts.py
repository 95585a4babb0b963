"""Eyeballs, teeth and tongue: new shapes in the places of the base mesh's crude helpers.

The helpers' motion under the face units is rigid (eyes in their sockets, lower teeth about the jaw's hinge), so it is
fitted once for each unit and applied to the new shapes. Only the tongue keeps its helper's vertices, and moves with the
lower teeth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facemime.core.face.names import COEFFICIENTS
from facemime.core.face.rotation import fit_rotation
from facemime.core.heads.built_in import LOOKS

from .anatomy import UPPER_LIP_BORDER, UPPER_LIP_LINE
from .source import BaseMesh

EYE_RADIUS_SHARE = 0.985
IRIS_RADIUS = 0.0058
"""Metres."""

_EYE_RINGS, _EYE_SEGMENTS = 15, 28
TEETH = 14
_EYE_TURN = np.radians((24.0, 33.0))
"""Pitch and yaw of an eye in a unit: sideways as a phone means; up and down as avatars' keys, as the lids of the units
would hide the iris at a phone's 35 degrees."""
_STILL = 2e-5
_TONGUE_SIZE = np.array([0.70, 0.60, 0.66])
_TONGUE_PLACE = np.array([0.0, 0.0070, 0.0080])
"""Size relative to the helper's tongue, whose middle fills the mouth, and shift of its tip in metres: the new one lies
between the lower teeth, below their edges, and behind them."""
_TONGUE_ROOT = 0.0090
"""Metres by which the root dips into the throat, so that the mouth is dark above it."""
_TONGUE_REACH, _TONGUE_LIFT, _TONGUE_DROOP, _TONGUE_TAPER = 0.017, 0.0185, 0.0045, 0.35
"""Metres by which a tongue that is out reaches in front of the lips, rises over the lower teeth and the lip, and droops
at the tip; share of its width that the tip loses."""

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """`vertices` (n, 3), `faces` (f, 4), `uv` (f, 4, 2), `pivot` (3,), `units` (U, n, 3), in the head frame, metres."""

    name: str
    vertices: Points
    faces: NDArray[np.int64]
    uv: NDArray[np.float64]
    pivot: Points
    units: Points


def jaw_hinge(base: BaseMesh, points: Points, jaw_open: Points) -> Points:
    """Point on the axis about which the lower teeth turn when the jaw opens, (3,)."""
    rows = _group(base, "helper-lower-teeth")
    rotation, shift = _rigid(points[rows], jaw_open[rows])
    return np.asarray(np.linalg.lstsq(np.eye(3) - rotation, shift, rcond=None)[0])


def build_parts(
    base: BaseMesh,
    points: Points,
    units: list[Points],
    tongue_out: int,
    hinge: Points,
    names: list[str],
    looks: list[Points],
) -> tuple[Part, ...]:
    """All parts of the head with base vertices `points` and face units `units`, each (N, 3) offsets; number
    `tongue_out` puts the tongue out. Eyes turn in the directions of the units `looks`, by the angles of a phone.
    """
    parts = [_eye(base, points, dict(zip(names, looks, strict=True)), side) for side in ("left", "right")]
    lip_line = float(points[UPPER_LIP_LINE[0], 1])
    upper, lower = _group(base, "helper-upper-teeth"), _group(base, "helper-lower-teeth")
    parts.append(_teeth("teeth_upper", points[upper], +1.0, lip_line, hinge, _rigid_units(points, units, upper)))
    jaw = _rigid_units(points, units, lower)
    parts.append(_teeth("teeth_lower", points[lower], -1.0, lip_line, hinge, jaw))
    parts.append(_tongue(base, points, tongue_out, hinge, jaw))
    return tuple(parts)


def _group(base: BaseMesh, name: str) -> NDArray[np.int64]:
    return np.unique(base.faces[base.groups == name])


def _rigid(rest: Points, offsets: Points) -> tuple[Points, Points]:
    """Rotation and translation that best move `rest` to `rest + offsets`."""
    moved = rest + offsets
    rotation = fit_rotation(rest - rest.mean(axis=0), moved - moved.mean(axis=0))
    return rotation, moved.mean(axis=0) - rotation @ rest.mean(axis=0)


Motion = Callable[[Points], Points]


def _rigid_units(points: Points, units: list[Points], rows: NDArray[np.int64]) -> Motion:
    """Return a function that gives vertices (n, 3) their offsets (U, n, 3), after the rigid motion of `rows`."""

    def offsets(vertices: Points) -> Points:
        out = np.zeros((len(units), *vertices.shape))
        for row, unit in zip(out, units, strict=True):
            if np.abs(unit[rows]).max() > _STILL:
                rotation, shift = _rigid(points[rows], unit[rows])
                row[:] = vertices @ rotation.T + shift - vertices
        return out

    return offsets


def _eye(base: BaseMesh, points: Points, units: dict[str, Points], side: str) -> Part:
    rows = _group(base, f"helper-{side[0]}-eye")
    centre, radius = _sphere(points[rows])
    vertices, faces, uv = _globe(radius * EYE_RADIUS_SHARE)
    placed = vertices + centre
    offsets = np.zeros((len(units), *placed.shape))
    for column in LOOKS.tolist():
        name = COEFFICIENTS[column]
        if name.endswith(side.title()):
            turned = Rotation.from_matrix(_rigid(points[rows], units[name][rows])[0]).as_rotvec()
            axis = int(np.abs(turned[:2]).argmax())  # x for pitch, y for yaw
            angle = np.copysign(_EYE_TURN[axis], turned[axis]) * np.eye(3)[axis]
            offsets[column] = vertices @ Rotation.from_rotvec(angle).as_matrix().T - vertices
    return Part(f"eye_{side}", placed, faces, uv, centre, offsets)


def _sphere(points: Points) -> tuple[Points, float]:
    """Centre and radius of the sphere through `points`, by linear least squares."""
    system = np.c_[2.0 * points, np.ones(len(points))]
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    centre = solution[:3]
    return centre, float(np.sqrt(solution[3] + centre @ centre))


def _globe(radius: float) -> tuple[Points, NDArray[np.int64], NDArray[np.float64]]:
    """A sphere that looks along -z, with dense rings at the iris and a slight cornea; uv centred on the pupil."""
    iris = np.arcsin(IRIS_RADIUS / radius)
    front = np.linspace(0.0, iris, 5)[1:]
    theta = np.concatenate([front, iris + (np.pi - iris) * np.linspace(0, 1, _EYE_RINGS - 3)[1:-1] ** 1.1])
    phi = 2.0 * np.pi * np.arange(_EYE_SEGMENTS) / _EYE_SEGMENTS
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    t, p = np.concatenate([[0.0], t, [np.pi]]), np.concatenate([[0.0], p, [0.0]])
    bulge = radius * (1.0 + 0.022 * np.clip(1.0 - (t / (1.15 * iris)) ** 2, 0.0, None))
    vertices = np.c_[bulge * np.sin(t) * np.cos(p), bulge * np.sin(t) * np.sin(p), -bulge * np.cos(t)]
    n, s = len(theta), _EYE_SEGMENTS

    def ring(i: int, j: int) -> int:
        return 1 + i * s + j % s

    faces = [[0, ring(0, j + 1), ring(0, j), -1] for j in range(s)]
    faces += [[ring(i, j), ring(i, j + 1), ring(i + 1, j + 1), ring(i + 1, j)] for i in range(n - 1) for j in range(s)]
    faces += [[1 + n * s, ring(n - 1, j), ring(n - 1, j + 1), -1] for j in range(s)]
    distance = eye_uv_radius(t)
    place = 0.5 + distance[:, None] * np.c_[np.cos(p), -np.sin(p)]
    rows = np.array(faces)
    return vertices, rows, np.where(rows[..., None] < 0, 0.0, place[rows])


def eye_uv_radius(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from the middle of the eye's texture for the angle from the line of sight: even to 90 degrees."""
    front = 0.44 * np.minimum(theta, np.pi / 2) / (np.pi / 2)
    return np.asarray(front + 0.055 * np.maximum(theta / (np.pi / 2) - 1.0, 0.0))


def _teeth(name: str, helper: Points, down: float, lip_line: float, hinge: Points, motion: Motion) -> Part:
    """An arch of fourteen teeth with a gum, placed by the helper and by `lip_line`, the height where the lips meet.

    `down` is +1 for the upper teeth, whose edges point down (+y), and -1 for the lower.
    """
    front = helper[:, 2].min() + (0.0012 if down > 0 else 0.0040)
    edge = lip_line + (0.0005 if down > 0 else 0.0036)
    columns = 6 * TEETH + 1
    s = np.linspace(-1.0, 1.0, columns)
    width, depth = (0.0265, 0.040) if down > 0 else (0.0245, 0.038)
    angle = s * 1.35
    arch = np.c_[width * np.sin(angle) / np.sin(1.35), depth * (1.0 - np.cos(angle)) / (1.0 - np.cos(1.35))]
    across = (s * TEETH / 2.0) % 1.0
    bulge = 0.0011 * np.sin(np.pi * across) ** 0.6
    molar = np.abs(s) ** 3
    profile = [
        (-0.0030, 0.0165),
        (0.0002, 0.0100),
        (0.0009, 0.0055),
        (0.0003, 0.0006),
        (-0.0022, 0.0),
        (-0.0060, 0.009),
    ]
    rows = []
    for out, up in profile:
        outward = out + bulge * (up < 0.009) - 0.004 * molar * (out < -0.001)
        normal = np.c_[np.sin(angle), -np.cos(angle)]
        xz = arch + outward[:, None] * normal
        scallop = 0.0007 * (1.0 - np.sin(np.pi * across)) * (0.0 < up < 0.004) * 1.0
        lift = (up + scallop) * (1.0 - 0.25 * molar)
        rows.append(np.c_[xz[:, 0], edge - down * lift, front + xz[:, 1]])
    vertices = np.concatenate(rows)
    faces, uv = _grid(len(profile), columns, flip=down < 0)
    uv[..., 1] = 0.5 + 0.5 * uv[..., 1] if down > 0 else 0.5 - 0.5 * uv[..., 1]
    return Part(name, vertices, faces, uv, hinge, motion(vertices))


def _grid(rows: int, columns: int, *, flip: bool) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Quads of a grid, rows downwards, and their uv, v up."""
    i, j = (a.ravel() for a in np.mgrid[: rows - 1, : columns - 1])
    faces = np.stack([i * columns + j, (i + 1) * columns + j, (i + 1) * columns + j + 1, i * columns + j + 1], axis=1)
    if flip:
        faces = faces[:, ::-1]
    return faces, np.stack([faces % columns / (columns - 1), 1.0 - faces // columns / (rows - 1)], axis=-1)


def _tongue(base: BaseMesh, points: Points, tongue_out: int, hinge: Points, motion: Motion) -> Part:
    chosen = base.groups == "helper-tongue"
    rows = np.unique(base.faces[chosen])
    number = np.full(len(points), -1)
    number[rows] = np.arange(len(rows))
    uv = base.uv[base.face_uv[chosen]]
    low, high = uv.reshape(-1, 2).min(axis=0), uv.reshape(-1, 2).max(axis=0)
    tip = np.array([0.0, points[rows, 1].max(), points[rows, 2].min()])
    vertices = tip + (points[rows] - tip) * _TONGUE_SIZE + _TONGUE_PLACE
    # From the root, 0, to the tip, 1.
    along = (vertices[:, 2].max() - vertices[:, 2]) / np.ptp(vertices[:, 2])
    vertices[:, 1] += _TONGUE_ROOT * (1.0 - along) ** 2
    moved = motion(vertices)
    reach = vertices[:, 2].min() - (points[UPPER_LIP_BORDER[0], 2] - _TONGUE_REACH)
    moved[tongue_out] = np.column_stack(
        [
            -_TONGUE_TAPER * vertices[:, 0] * along**6,
            _TONGUE_DROOP * along**4 - _TONGUE_LIFT * along,
            -reach * along**1.5,
        ]
    )
    return Part("tongue", vertices, number[base.faces[chosen]], (uv - low) / (high - low), hinge, moved)

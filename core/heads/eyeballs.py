"""The almond between the corners of an eye (method.md, section 7.4), and contact between lids and eyeballs (section
5.8).

A lid that closes along a straight line would cut through the eyeball, which would show through the skin. Vertices
near an eyeball are therefore kept outside its surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import EYE_LEFT, EYE_RIGHT
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

LID_THICKNESS = 0.03
"""Gap between an eye that was cut out of the skin and the sphere of its lids, as a share of the radius."""
_REACH = 1.8
"""Distance from the centre of an eyeball, in radii, within which vertices are kept outside."""
_ROBUST_STEPS = 4
"""Number of fits of an eyeball."""
_ROBUST_SHARE = 0.8
"""Share of the vertices that each fit uses: those nearest to the last sphere, as a cornea bulges."""
_MAX_BULGE = 1.2
"""Largest distance of the cornea's apex from the centre of the eye, in radii; anything farther out is not a cornea."""
_OUTSIDE = 0.93
"""Distance in radii from which a vertex at rest belongs to the outside of a lid; the skin behind it is deeper."""
_COARSE = 1.05
"""Distance in radii from which the faces of lids count as coarse; nearly all of the built-in heads are finer."""
_FARTHEST = 1.25
"""Largest distance in radii that the vertices of coarse lids keep; beyond it, lids would bulge."""
_MOVED = 0.4
"""Motion in radii beyond which they keep it in full."""
_SLACK = 1e-5
"""Share of the squared distance that a vertex may lose to rounding without having moved."""


EYES = EYE_RIGHT, EYE_LEFT[[3, 2, 1, 0, 5, 4]]
"""Landmarks of the right and left eye: outer corner, upper lid, inner corner, lower lid. The two are mirror images."""
_LIDS = (1, 2, 4, 5)
_USUAL = np.array([0.76, -0.48, 0.0])
"""Usual bows and lean of an `EyeOutline`, close to those of labelled scans."""
_TRUST = 0.03
"""Ridge towards the usual shape, which then has about a quarter of the weight of two landmarks of a lid."""
_SHARE_RANGE = (0.2, 0.8)
"""Range of positions of landmarks along the eye, as shares of its width. Like the following two, it limits the effect
of misplaced landmarks."""
_MIN_BOW = 0.5
"""Smallest bow of a lid, as a share of the usual one."""
_MAX_LEAN = 0.2
"""Largest lean of an `EyeOutline`, to either side."""
_MAX_SLOPE = 0.9
"""Sine of the angle of the line between the corners above which one corner counts as above the other."""


@dataclass(frozen=True)
class EyeOutline:
    """The almond of an eye (equation 7.2).

    Attributes
    ----------
    corner : (3,) float
        The outer corner.
    axes : (3, 3) float
        Rows: unit vectors towards the inner corner, up, and towards the viewer.
    width : float
        Distance between the corners.
    bows : (2,) float
        Bow of the upper and of the lower lid.
    lean : float
        Common lean of both lids. At the share s of the way to the inner corner, the height of a lid above the line
        between the corners is ``s (1 - s) (bow + lean (2 s - 1))`` widths. As in people, a common lean lets the lids
        meet everywhere when they shut.
    """

    corner: FloatArray
    axes: FloatArray
    width: float
    bows: FloatArray
    lean: float

    def to_local(self, points: FloatArray) -> FloatArray:
        """Convert (..., 3) points to the frame of the eye: widths to the inner corner, up, and towards the viewer."""
        return np.asarray((points - self.corner) @ self.axes.T / self.width)

    def from_local(self, local: FloatArray) -> FloatArray:
        """Convert (..., 3) points from the frame of the eye to that of the mesh."""
        return np.asarray(self.corner + self.width * local @ self.axes)

    def lids(self, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Heights of the upper and the lower lid, (...), in widths, at shares (...) of the way to the inner corner."""
        upper, lower = (along * (1.0 - along) * (bow + self.lean * (2.0 * along - 1.0)) for bow in self.bows)
        return upper, lower

    def depth_within(self, local: FloatArray) -> FloatArray:
        """Vertical depth of points within the almond, (...), in widths; negative outside."""
        up = local[..., 1]
        upper, lower = self.lids(local[..., 0])
        return np.asarray(np.minimum(upper - up, up - lower))


def eye_outline(vertices: FloatArray, landmarks: IntArray, eye: IntArray) -> EyeOutline:
    """Fit an almond to the landmarks of an eye, one of `EYES`; vertices and landmarks are as in `HeadRig`.

    The almond meets both corners. The landmarks of the lids, which are imprecise on a mesh without rims, are met as far
    as they agree with the usual shape of eyes. Raises HeadError if the corners coincide, or one lies above the other.
    """
    points = np.asarray(vertices, dtype=np.float64)[landmarks[eye]]
    width = float(np.linalg.norm(points[3] - points[0]))
    along = (points[3] - points[0]) / max(width, np.finfo(float).tiny)
    if width == 0.0 or abs(along[1]) > _MAX_SLOPE:
        raise HeadError("One corner of an eye lies above the other. Find the face again, or mark the corners.")
    # Axes of the eye: along its width, up (the head's up direction made orthogonal to the first), towards the viewer.
    up = along * along[1] - (0.0, 1.0, 0.0)
    up /= np.linalg.norm(up)
    towards = np.cross(along, up)
    axes = np.stack([along, up, towards if towards[2] < 0.0 else -towards])
    local = (points - points[0]) @ axes.T / width
    *bows, lean = _bows(local)
    return EyeOutline(points[0], axes, width, np.array(bows), float(lean))


def _bows(points: FloatArray) -> FloatArray:
    """Fit `bows` and `lean`, (3,), to landmarks (6, 3) in the frame of an eye: least squares with a ridge."""
    share = np.clip(points[_LIDS, 0], *_SHARE_RANGE)
    bow = share * (1.0 - share)
    upper = np.arange(len(_LIDS)) < 2
    # Equation 7.2 is linear in the bows and the lean.
    terms = np.column_stack([bow * upper, bow * ~upper, bow * (2.0 * share - 1.0)])
    pull = _TRUST * np.eye(3)
    fitted = linalg.solve(terms.T @ terms + pull, terms.T @ points[_LIDS, 1] + pull @ _USUAL)
    upper_bow, lower_bow = _USUAL[:2] * np.maximum(fitted[:2] / _USUAL[:2], _MIN_BOW)
    return np.array([upper_bow, lower_bow, np.clip(fitted[2], -_MAX_LEAN, _MAX_LEAN)])


def fit_eyeball(points: FloatArray) -> FloatArray:
    """Fit the sphere of the lids to the vertices (N, 3) of an eye that was cut out; return centre and radius, (4,).

    The fit is a least-squares solution of ``|p|^2 = 2 c p + (r^2 - |c|^2)``, which is linear in c and in the bracket.
    """
    middle = points.mean(axis=0)
    about = points - middle
    *half, rest = linalg.lstsq(np.column_stack([about, np.ones(len(about))]), (about**2).sum(axis=1))[0]
    centre = np.array(half) / 2.0
    return np.array([*(middle + centre), np.sqrt(rest + centre @ centre) / (1.0 - LID_THICKNESS)])


def part_eyeball(points: FloatArray) -> tuple[FloatArray, bool]:
    """Fit a sphere to a separate eye, and return its centre and radius (4,), and whether lids can slide over it.

    The points (N, 3) are the vertices of an eyeball, or of its front, possibly with a bulging cornea and an iris
    inside, in the head frame. Lids can slide over it if these lie on the sphere. For a flat eye, as cartoon characters
    have, the sphere lies behind it.
    """
    points = np.asarray(points, dtype=np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    half = float((high - low)[:2].max()) / 2.0
    sphere = fit_eyeball(points) * np.array([1.0, 1.0, 1.0, 1.0 - LID_THICKNESS])
    # Trimmed fits: the cornea and an iris inside lie off the sphere of the white.
    for _ in range(_ROBUST_STEPS):
        off = np.abs(np.linalg.norm(points - sphere[:3], axis=1) - sphere[3])
        sphere = fit_eyeball(points[off <= np.quantile(off, _ROBUST_SHARE)])
        sphere[3] *= 1.0 - LID_THICKNESS
    if 0.8 * half < sphere[3] < 1.6 * half:
        return sphere, True
    middle = (low + high) / 2.0
    return np.array([middle[0], middle[1], low[2] + half, half]), False


def sphere_of_lids(points: FloatArray) -> FloatArray | None:
    """Return the centre and radius (4,) of the sphere over which the lids of a separate eye slide.

    The points are as in `part_eyeball`. The sphere takes in the apex of the cornea, which would otherwise show through
    a closed lid. It is None for an eye that is not round.
    """
    sphere, is_round = part_eyeball(points)
    if not is_round:
        return None
    apex = float(np.linalg.norm(points - sphere[:3], axis=1).max())
    return np.array([*sphere[:3], min(apex, _MAX_BULGE * sphere[3])])


class EyeballContact:
    """Keeps the skin outside the eyeballs.

    Parameters
    ----------
    rest : (V, 3) array
        Vertices at rest.
    weights : (V,) array
        Sum of the region weights. Vertices of weight 0 do not move and are ignored.
    eyeballs : (E, 4) array
        Centre and radius of each eyeball, in the frame and unit of `rest`.
    faces : (F, K) array of int, optional
        Vertices of each face, padded with -1.

    Notes
    -----
    Vertices that are inside an eyeball at rest (the inner rim of a lid) may stay as close to its centre as they were.
    Those on the outside of coarse lids may not where they have moved over the eyeball: there they keep a distance at
    which the faces between them are outside, too.
    """

    def __init__(
        self, rest: FloatArray, weights: FloatArray, eyeballs: FloatArray, faces: IntArray | None = None
    ) -> None:
        rows, centres, nearest, farthest = [], [], [], []
        places = np.asarray(rest, dtype=np.float64)
        sizes = None if faces is None else _face_sizes(places, np.asarray(faces))
        for x, y, z, radius in np.asarray(eyeballs, dtype=np.float64).reshape(-1, 4):
            distance = np.linalg.norm(rest - (x, y, z), axis=1)
            near = np.flatnonzero((weights > 0) & (distance < _REACH * radius))
            rows.append(near)
            centres.append(np.tile([x, y, z], (len(near), 1)))
            nearest.append(np.minimum(distance[near], radius))
            farthest.append(nearest[-1].copy())
            if sizes is None:
                continue
            chord = np.hypot(radius, 0.5 * sizes[near])
            coarse = (distance[near] > _OUTSIDE * radius) & (chord > _COARSE * radius)
            farthest[-1][coarse] = np.minimum(chord[coarse], _FARTHEST * radius)
        self._rows: NDArray[np.intp] = np.concatenate([np.empty(0, dtype=np.intp), *rows])
        self._centres = np.concatenate([np.empty((0, 3)), *centres]).astype(np.float32)
        self._nearest = np.concatenate([np.empty(0), *nearest]).astype(np.float32)
        self._squared = np.square(self._nearest) * (1.0 - _SLACK)
        wider = np.concatenate([np.empty(0), *farthest]).astype(np.float32) - self._nearest
        self._wide = np.flatnonzero(wider > 0.0)
        self._wider = wider[self._wide]
        self._rest = places[self._rows[self._wide]].astype(np.float32)
        self._outward = np.empty_like(self._centres)
        self._products = np.empty_like(self._centres)
        self._ones = np.ones(3, dtype=np.float32)

    def spheres(self, count: int) -> NDArray[np.float32]:
        """Sphere outside which each of `count` vertices stays, (count, 4): centre and radius; 0 if there is none."""
        table = np.zeros((count, 4), dtype=np.float32)
        table[self._rows] = np.column_stack([self._centres, self._nearest])
        return table

    def resolve(self, vertices: NDArray[np.float32]) -> None:
        """Push `vertices`, (V, 3) float32, that are too deep outwards, in place."""
        outward = vertices.take(self._rows, axis=0, out=self._outward, mode="clip")
        np.subtract(outward, self._centres, out=outward)
        squared = np.multiply(outward, outward, out=self._products) @ self._ones
        nearest, least = self._nearest, self._squared
        if len(self._wide):
            moved = np.linalg.norm(vertices[self._rows[self._wide]] - self._rest, axis=1)
            share = np.clip(moved / (_MOVED * nearest[self._wide]), 0.0, 1.0)
            nearest = nearest.copy()
            nearest[self._wide] += self._wider * share * share * (3.0 - 2.0 * share)
            least = np.square(nearest) * np.float32(1.0 - _SLACK)
        deep = (squared < least).nonzero()[0]
        if len(deep):
            vertices[self._rows[deep]] = self._centres[deep] + _pushed(outward[deep], nearest[deep])


def _face_sizes(places: FloatArray, faces: IntArray) -> FloatArray:
    """Return the largest distance from each vertex to another one of its faces, (V,)."""
    farthest = np.zeros(len(places))
    for shift in range(1, faces.shape[1]):
        other = np.roll(faces, shift, axis=1)
        ends = np.stack([faces, other], axis=-1)[(faces >= 0) & (other >= 0)]
        away = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1)
        np.maximum.at(farthest, ends[:, 0], away)
    return farthest


def _pushed(outward: NDArray[np.float32], least: NDArray[np.float32]) -> NDArray[np.float32]:
    """Push points (N, 3), relative to the centres of eyeballs, to distances (N,) that exceed theirs.

    Lids that meet have to stay together, so a point in front of the eyeball keeps its height: it moves along (x, u y,
    z), where u = (y / least)^2, which is the radius for points above and below.
    """
    along = outward.copy()
    along[:, 1] *= np.square(outward[:, 1] / least)
    # |outward + t along| = least
    square, dot = ((along * other).sum(axis=1) for other in (along, outward))
    lacking = np.square(least) - np.square(outward).sum(axis=1)
    step = lacking / (dot + np.sqrt(np.square(dot) + square * lacking) + np.finfo(np.float32).tiny)
    return np.asarray(outward + step[:, None] * along, dtype=np.float32)

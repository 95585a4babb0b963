"""The almond between the corners of an eye, fitted to the landmarks of its lids (method.md, section 7.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import HeadError
from ..face.landmarks import EYE_LEFT, EYE_RIGHT
from ..numeric import linalg
from ..numeric.arrays import FloatArray, IntArray

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

    def depth_within(self, local: FloatArray) -> FloatArray:
        """Vertical depth of points within the almond, (...), in widths; negative outside."""
        along, up = local[..., 0], local[..., 1]
        upper, lower = (along * (1.0 - along) * (bow + self.lean * (2.0 * along - 1.0)) for bow in self.bows)
        return np.asarray(np.minimum(upper - up, up - lower))


def eye_outline(vertices: FloatArray, landmarks: IntArray, eye: IntArray) -> EyeOutline:
    """Fit an almond to the landmarks of an eye.

    Parameters
    ----------
    vertices, landmarks : (V, 3), (66,) array
        As in `HeadRig`.
    eye : (6,) array of int
        One of `EYES`.

    Returns
    -------
    EyeOutline
        An almond that meets both corners. The landmarks of the lids, which are imprecise on a mesh without rims, are
        met as far as they agree with the usual shape of eyes.

    Raises
    ------
    HeadError
        If the corners coincide, or one lies above the other.
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

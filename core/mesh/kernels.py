"""Kernels: how far, and how smoothly, a control point moves its surroundings (method.md, section 5.2); warps of space,
by which given points move to others (section 7.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..numeric import linalg
from ..numeric.arrays import FloatArray, as_points

_WIDE = 3.0
"""Sigma of the wide Gaussian over that of the narrow one. Like the spacings in `KERNELS`, tuned on ICT-FaceKit and the
built-in head (docs/accuracy/deformation.md)."""
_NARROW_SHARE = 0.46
"""Share of the narrow Gaussian, tuned on the same heads."""
_CHUNK = 4_000


@dataclass(frozen=True)
class Kernel:
    """A function of distance r and width sigma that is 1 at r = 0.

    Attributes
    ----------
    name : str
        Key in `KERNELS`.
    phi : callable
        ``phi(distances, sigma)`` returns values of the same shape.
    spacing : float
        Sigma over the spacing of the control points, before the factor of a region. 0 if the kernel has no width; sigma
        is then twice the extent of the control points.
    """

    name: str
    phi: Callable[[FloatArray, float], FloatArray]
    spacing: float

    def width(self, between: FloatArray, factor: float) -> float:
        """Choose sigma from the distances (P, P) between control points, in their unit, and `Region.spacing_factor`.

        The spacing is the median distance to the third nearest neighbour. The distance to the nearest would be
        dominated by pairs on opposite lips.
        """
        if len(between) == 1:
            return 1.0
        if self.spacing == 0.0:
            return 2.0 * float(between.max())
        rank = min(3, len(between) - 1)
        return self.spacing * factor * float(np.median(np.sort(between, axis=1)[:, rank]))


def gaussian(distance: FloatArray, sigma: float) -> FloatArray:
    """Gaussian kernel, ``exp(-r^2 / (2 sigma^2))``: equation 2 of Yao et al. 2019."""
    return np.asarray(np.exp(np.square(distance) * (-0.5 / (sigma * sigma))))


def multiscale(distance: FloatArray, sigma: float) -> FloatArray:
    """Sum of a Gaussian and one three times as wide: detail near the landmarks, and no gap where they are far apart.

    Landmarks are dense on lids and lips and sparse on the cheeks. A single Gaussian that suits lids and lips leaves the
    middle of the cheek behind. A sum of Gaussians is positive definite because its terms are (Opfer 2006; Luethi et al.
    2018).
    """
    return _NARROW_SHARE * gaussian(distance, sigma) + (1.0 - _NARROW_SHARE) * gaussian(distance, _WIDE * sigma)


def wendland(distance: FloatArray, sigma: float) -> FloatArray:
    """Wendland's C2 function, ``(1 - r / R)^4 (4 r / R + 1)`` below ``R = 4 sigma`` and 0 beyond.

    Wendland 1995; compactly supported, and positive definite in three dimensions.
    """
    r = np.minimum(distance / (4.0 * sigma), 1.0)
    return np.asarray(np.square(np.square(1.0 - r)) * (4.0 * r + 1.0))


def biharmonic(distance: FloatArray, sigma: float) -> FloatArray:
    """Biharmonic kernel of three dimensions, -r, as ``1 - r / sigma``; sigma exceeds the extent of the control points.

    -r is conditionally positive definite; shifted by the constant it is positive definite on the control points
    (Micchelli 1986).
    """
    return np.asarray(1.0 - distance / sigma)


KERNELS: dict[str, Kernel] = {
    kernel.name: kernel
    for kernel in (
        Kernel("gaussian", gaussian, 1.0),
        Kernel("multiscale", multiscale, 0.77),
        Kernel("wendland", wendland, 1.0),
        Kernel("biharmonic", biharmonic, 0.0),
    )
}


def get_kernel(name: str) -> Kernel:
    """Return a kernel by name; HeadError if the name is unknown."""
    if name not in KERNELS:
        raise HeadError("There is no kernel {name!r}. Choose one of {known}.", name=name, known=", ".join(KERNELS))
    return KERNELS[name]


def distances(a: FloatArray, b: FloatArray) -> NDArray[np.float64]:
    """Compute the distances (N, M) between points (N, 3) and points (M, 3), in their unit."""
    return np.asarray(linalg.part("spatial.distance").cdist(a, b))


class Warp:
    """The smoothest map of space that takes the `source` points to the `target` points.

    Parameters
    ----------
    source, target : (P, 3) array
        Corresponding points.
    smoothing : float or (P,) array
        Added to the diagonal, as a share of the extent of the source, so that points may be missed; 0 meets all.

    Raises
    ------
    HeadError
        If the source points lie in one plane.

    Notes
    -----
    A biharmonic spline in three dimensions (equation 7.1): kernel -r and an affine map (Duchon 1977; Bookstein 1989).
    """

    def __init__(self, source: FloatArray, target: FloatArray, smoothing: float | FloatArray = 1e-3) -> None:
        known = as_points(source, "source", error=HeadError)
        goal = as_points(target, "target", count=len(known), error=HeadError)
        smoothing = np.multiply(smoothing, np.linalg.norm(np.ptp(known, axis=0)))
        spline = linalg.part("interpolate").RBFInterpolator
        try:
            self._spline = spline(known, goal, smoothing=smoothing, kernel="linear", degree=1)
        except np.linalg.LinAlgError as error:
            raise HeadError("The landmarks lie in one plane. Bind them again.") from error

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return the warped `points`, (N, 3)."""
        return np.asarray(self._spline(points))

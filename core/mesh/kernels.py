"""Kernels of distance by name: how far, and how smoothly, a control point carries its surroundings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import HeadError

_FAR, _NEAR_SHARE = 3.0, 0.46
"""The wider Gaussian's sigma over the narrower one's, and the narrower one's share of the sum."""


@dataclass(frozen=True)
class Kernel:
    """A function of distance r and width sigma, 1 at r = 0.

    Attributes
    ----------
    name : str
    phi : callable
        (distances, sigma) -> values, of the same shape.
    spacing : float
        Sigma over the spacing of a region's control points that suits the kernel, before the region's own factor;
        0 where the kernel knows no width: sigma is then twice the extent of the control points.
    """

    name: str
    phi: Callable[[FloatArray, float], FloatArray]
    spacing: float

    def width(self, between: FloatArray, factor: float) -> float:
        """Sigma for control points at the distances `between`, (P, P): their spacing times `factor`.

        Their spacing is the median distance to the third nearest neighbour: to the nearest alone, the pairs on
        opposite lips would count.
        """
        if len(between) == 1:
            return 1.0
        if self.spacing == 0.0:
            return 2.0 * float(between.max())
        rank = min(3, len(between) - 1)
        return self.spacing * factor * float(np.median(np.sort(between, axis=1)[:, rank]))


def gaussian(distance: FloatArray, sigma: float) -> FloatArray:
    """phi(r) = exp(-r^2 / (2 sigma^2)), equation (2) of Yao et al. 2019."""
    return np.asarray(np.exp(np.square(distance) * (-0.5 / (sigma * sigma))))


def multiscale(distance: FloatArray, sigma: float) -> FloatArray:
    """A Gaussian on top of one three times as wide: detail near the landmarks, no hole where they are far apart.

    Landmarks lie close on lids and lips and far apart over the cheeks. One Gaussian that suits the former leaves the
    middle of the cheek behind. A sum of Gaussians is positive definite as they are (Opfer 2006; Luethi et al. 2018).
    """
    return _NEAR_SHARE * gaussian(distance, sigma) + (1.0 - _NEAR_SHARE) * gaussian(distance, _FAR * sigma)


def wendland(distance: FloatArray, sigma: float) -> FloatArray:
    """phi(r) = (1 - r / R)^4 (4 r / R + 1) below the radius R = 4 sigma, 0 beyond: C2 and compact (Wendland 1995)."""
    r = np.minimum(distance / (4.0 * sigma), 1.0)
    return np.asarray((1.0 - r) ** 4 * (4.0 * r + 1.0))


def biharmonic(distance: FloatArray, sigma: float) -> FloatArray:
    """phi(r) = 1 - r / sigma: the biharmonic -r of three dimensions, shifted so that it is positive definite.

    It is so for a sigma that exceeds the extent of the control points (Micchelli 1986).
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


def kernel_named(name: str) -> Kernel:
    """The kernel of that name; HeadError where there is none."""
    if name not in KERNELS:
        raise HeadError(f"There is no kernel {name!r}. Choose one of {', '.join(KERNELS)}.")
    return KERNELS[name]


def distances(a: FloatArray, b: FloatArray) -> NDArray[np.float64]:
    """(N, M) distances between (N, 3) and (M, 3) points."""
    squared = np.asarray(a @ (-2.0 * b.T))
    squared += (a * a).sum(axis=1)[:, None]
    squared += (b * b).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0, out=squared), out=squared))

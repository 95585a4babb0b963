"""The deformer of a head: its regions, its control points, and the kernel that knows faces."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..heads.regions import DEFAULT_KERNEL, membership, region_sigmas
from ..heads.rig import HeadRig
from ..mesh.kernels import kernel_named
from .expressions import ExpressionModel, learnt_covariance, shipped_expressions
from .follow import following
from .rbf import IncrementalDeformer, RBFDeformer

INFORMED = "informed"
"""The kernel that knows faces, by default; any name of `kernels.KERNELS` is one that knows distance alone."""


def head_deformer(
    rig: HeadRig,
    kernel: str = INFORMED,
    *,
    incremental: bool = False,
    expressions: tuple[ExpressionModel, ...] | None = None,
) -> RBFDeformer | IncrementalDeformer:
    """What moves the vertices of `rig` by the displacements of its 66 landmarks; `kernel` and `incremental` as for
    `DriveSettings`.

    `expressions` are what the informed kernel knows of faces, by default what ships.
    """
    places = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    plain = DEFAULT_KERNEL if kernel == INFORMED else kernel
    sigma = region_sigmas(places, kernel_named(plain))
    follow = None
    if rig.control_points is not None:
        follow = following(places, rig.control_points, rig.covariance, kernel_named(plain), sigma)
    fit = partial(
        IncrementalDeformer if incremental else RBFDeformer,
        rig.vertices,
        places,
        rig.region_weights,
        membership(),
        kernel=plain,
        sigma=sigma,
        follow=follow,
    )
    if kernel != INFORMED or rig.faces is None or incremental:
        return fit()
    known = shipped_expressions() if expressions is None else expressions
    return fit(skin=learnt_covariance(known, rig.vertices, rig.faces, rig.landmarks, rig.region_weights))

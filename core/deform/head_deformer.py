"""The deformer of a head, from its regions, control points and kernel (method.md, section 5.6)."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..heads.regions import DEFAULT_KERNEL, membership, region_sigmas
from ..heads.rig import HeadRig
from ..mesh.kernels import get_kernel
from .covariance import REGULARISATION, follow_matrix
from .expressions import ExpressionModel, learnt_covariance, shipped_expressions
from .lid_rims import lid_rims
from .rbf import IncrementalDeformer, RBFDeformer

INFORMED = "informed"
"""The default kernel, which combines distance with the skin and learnt motion. `KERNELS` use distance alone."""


def head_deformer(
    rig: HeadRig,
    kernel: str = INFORMED,
    *,
    incremental: bool = False,
    exact: bool = False,
    expressions: ExpressionModel | None = None,
) -> RBFDeformer | IncrementalDeformer:
    """Prepare the deformer of a head.

    Parameters
    ----------
    rig : HeadRig
        The head.
    kernel : str
        As in `DriveSettings`.
    incremental, exact : bool
        As in `DriveSettings`.
    expressions : ExpressionModel, optional
        Correlation of motion on known heads for the informed kernel; by default the shipped one.

    Returns
    -------
    RBFDeformer or IncrementalDeformer
        Moves the vertices by the displacements of the 66 landmarks. Without faces, or if incremental, the informed
        kernel is reduced to its distance part.

    Examples
    --------
    >>> from facemime import built_in_head, head_deformer
    >>> deformer = head_deformer(built_in_head())
    >>> displacements = np.zeros((66, 3))
    >>> displacements[8, 1] = 0.01  # the chin, down by 1 cm
    >>> lowered = deformer.deform(displacements)[:, 1] - deformer.rest[:, 1]
    >>> round(float(lowered.max()), 3)
    0.01
    """
    places = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    plain = DEFAULT_KERNEL if kernel == INFORMED else kernel
    sigma = region_sigmas(places, get_kernel(plain))
    regularisation = 0.0 if exact else REGULARISATION
    follow, members = None, membership()
    if rig.control_points is not None and incremental and rig.covariance is None:
        members &= rig.control_points.any(axis=0)
    elif rig.control_points is not None:
        follow = follow_matrix(places, rig.control_points, rig.covariance, get_kernel(plain), sigma, regularisation)
    fit = partial(
        IncrementalDeformer if incremental else RBFDeformer,
        rig.vertices,
        places,
        rig.region_weights,
        members,
        kernel=plain,
        sigma=sigma,
        regularisation=regularisation,
        follow=follow,
    )
    if kernel != INFORMED or rig.faces is None or incremental:
        return fit()
    known = shipped_expressions() if expressions is None else expressions
    mesh = rig.vertices, rig.faces, rig.landmarks, rig.region_weights
    return fit(skin=learnt_covariance(known, *mesh), rims=lid_rims(*mesh))

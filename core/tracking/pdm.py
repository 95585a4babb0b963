"""The 3-D point distribution model: 66 landmarks as a mean and modes, under weak perspective.

See method.md, section 3.1. Euler angles are updated by addition. They degenerate at 90 degrees of yaw, where no
landmark detector of this kind works; in return, iterations keep no state but the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin

import numpy as np

from ..face.landmarks import MIRROR
from ..face.rotation import euler_to_matrix
from ..numeric.arrays import FloatArray
from ..numeric.linalg import multiply, solve_definite

N_POSE = 6
"""`(s, pitch, yaw, roll, tx, ty)`, as in `TrackResult.pose`."""


@dataclass(frozen=True)
class FittedShape:
    """A fitted face: `pose` (6,), as in `TrackResult`, and `shape_params` (K,)."""

    pose: FloatArray
    shape_params: FloatArray


@dataclass(frozen=True)
class PointDistributionModel:
    """``x_i = s R (m_i + B_i q) + t``, first two rows, with ``q ~ N(0, diag(lambda))`` (equation 3.1).

    Parameters
    ----------
    mean_shape : (N, 3) float64
        Mean shape in the head frame, in its own outer-eye distances.
    basis : (N, 3, K) float64
        Modes. They need not be orthonormal; their coefficients are uncorrelated.
    eigenvalues : (K,) float64
        Variances of the coefficients.
    """

    mean_shape: FloatArray
    basis: FloatArray
    eigenvalues: FloatArray

    @property
    def n_modes(self) -> int:
        """Number of modes K."""
        return len(self.eigenvalues)

    @cached_property
    def _flat_basis(self) -> FloatArray:
        """Modes as (3, N * (6 + K)), so that a single product rotates all; the columns of the pose are 0."""
        modes = self.basis.transpose(1, 0, 2)
        flat: FloatArray = np.concatenate([np.zeros((*modes.shape[:2], N_POSE)), modes], axis=2).reshape(3, -1)
        return flat

    @cached_property
    def _shape_basis(self) -> FloatArray:
        return np.ascontiguousarray(self.basis).reshape(-1, self.n_modes)

    @cached_property
    def _deviations(self) -> FloatArray:
        return np.sqrt(self.eigenvalues)

    @cached_property
    def mirror_signs(self) -> FloatArray:
        """Factors that mirror the shape parameters, (K,): 1 for a symmetric mode, -1 for an antisymmetric one.

        NaN for modes that are neither, in a model that was not learnt from faces and their mirror images.
        """
        flipped = self.basis[MIRROR] * np.array([-1.0, 1.0, 1.0])[:, None]
        size = np.square(self.basis).sum(axis=(0, 1))
        signs = np.sign((flipped * self.basis).sum(axis=(0, 1)))
        pure = np.square(flipped - signs * self.basis).sum(axis=(0, 1)) <= 1e-12 * size
        return np.where(pure, signs, np.nan)

    def shape(self, shape_params: FloatArray) -> FloatArray:
        """Return the landmarks in the head frame, (N, 3), for coefficients (K,)."""
        out = multiply(self._shape_basis, shape_params).reshape(-1, 3)
        out += self.mean_shape
        return out

    def project(self, pose: FloatArray, shape_params: FloatArray) -> FloatArray:
        """Project the landmarks to pixels, (N, 2), by a pose as in `TrackResult` and coefficients (equation 3.1)."""
        scale, pitch, yaw, roll, *_ = pose.tolist()
        projected: FloatArray = self.shape(shape_params) @ (scale * euler_to_matrix(pitch, yaw, roll)[:2]).T
        projected += pose[4:6]
        return projected

    def jacobian(self, pose: FloatArray, shape_params: FloatArray) -> FloatArray:
        """Differentiate the projected landmarks: x and y with respect to pose and coefficients, (2, N, 6 + K)."""
        scale, pitch, yaw, roll, *_ = pose.tolist()
        rotation = scale * euler_to_matrix(pitch, yaw, roll)
        x, y, z = rotation.tolist()
        c, s = cos(roll), sin(roll)
        # Derivatives of R = Rz Ry Rx: pitch turns its second column into the third, yaw its rows along the third.
        by_pose = np.array(
            [
                [[v / scale for v in x], [0.0, x[2], -x[1]], [c * v for v in z], [-v for v in y]],
                [[v / scale for v in y], [0.0, y[2], -y[1]], [s * v for v in z], x],
            ]
        )
        out: FloatArray = (rotation[:2] @ self._flat_basis).reshape(2, len(self.mean_shape), -1)
        out[:, :, :4] = self.shape(shape_params) @ by_pose.transpose(0, 2, 1)
        out[0, :, 4] = out[1, :, 5] = 1.0
        return out

    def clamp(self, shape_params: FloatArray, limit: float = 5.0) -> FloatArray:
        """Clamp coefficients (K,) to `limit` standard deviations."""
        bound = limit * self._deviations
        clamped: FloatArray = np.minimum(np.maximum(shape_params, -bound), bound)
        return clamped

    def step(self, pose: FloatArray, shape_params: FloatArray, delta: FloatArray) -> FittedShape:
        """Add an update (6 + K,) to pose and coefficients.

        The result has a positive scale, angles from -pi to pi, and coefficients within five standard deviations.
        """
        moved = pose + delta[:N_POSE]
        # A step may at most halve the scale, which keeps it positive.
        moved[0] = max(moved[0], 0.5 * pose[0])
        moved[1:4] = (moved[1:4] + pi) % (2 * pi) - pi
        return FittedShape(moved, self.clamp(shape_params + delta[N_POSE:]))

    def frontal_pose(self, landmarks: FloatArray, weights: FloatArray | None = None) -> FloatArray:
        """Fit a pose (6,) without pitch and yaw to landmarks (N, 2) in pixels, with relative weights (N,).

        It is the similarity that takes the mean shape closest to them.
        """
        weights = np.ones(len(landmarks)) if weights is None else weights
        share = (weights / weights.sum())[:, None]
        mean_2d = self.mean_shape[:, :2]
        centre_model, centre_image = (share * mean_2d).sum(0), (share * landmarks).sum(0)
        # Similarity as a complex factor: the least-squares fit of b = z a (Umeyama 1991).
        a, b = mean_2d - centre_model, landmarks - centre_image
        norm = (share * a * a).sum()
        real = (share * a * b).sum() / norm
        imaginary = (share[:, 0] * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum() / norm
        turn = np.array([[real, -imaginary], [imaginary, real]])
        translation = centre_image - turn @ centre_model
        return np.array([np.hypot(real, imaginary), 0.0, 0.0, np.arctan2(imaginary, real), *translation])

    def fit(
        self,
        landmarks: FloatArray,
        weights: FloatArray | None = None,
        *,
        noise: float = 0.01,
        iterations: int = 15,
        start: FloatArray | None = None,
    ) -> FittedShape:
        """Fit the most probable pose and coefficients to landmarks, by Gauss-Newton.

        Parameters
        ----------
        landmarks : (N, 2) float64
            Positions in pixels.
        weights : (N,) float64, optional
            Relative weight of each landmark; 0 ignores it.
        noise : float
            Standard deviation of a landmark of weight 1, in outer-eye distances. 0 disables the prior, which requires
            more landmarks than parameters.
        iterations : int
            Number of Gauss-Newton steps.
        start : (6,) float64, optional
            Initial pose; by default `frontal_pose`.

        Returns
        -------
        FittedShape
            The fit, in the image frame.
        """
        weights = np.ones(len(landmarks)) if weights is None else weights
        pose = self.frontal_pose(landmarks, weights) if start is None else start
        shape_params = np.zeros(self.n_modes)
        for _ in range(iterations):
            # Equation 3.4, where v is the residual and r the variance of the noise in pixels.
            residual = (landmarks - self.project(pose, shape_params)).T
            jacobian = self.jacobian(pose, shape_params)
            prior = np.concatenate([np.zeros(N_POSE), (noise * pose[0]) ** 2 / self.eigenvalues])
            delta = solve_update(jacobian, residual, weights, prior, shape_params)
            pose, shape_params = (fitted := self.step(pose, shape_params, delta)).pose, fitted.shape_params
        return FittedShape(pose, shape_params)


def solve_update(
    jacobian: FloatArray, shift: FloatArray, weights: FloatArray, prior: FloatArray, shape_params: FloatArray
) -> FloatArray:
    """Solve for an update (P,) of pose and coefficients, ``-(r L + J^T W J)^-1 (r L p - J^T W v)`` (equation 3.4).

    `jacobian` (2, N, P) is `J`; `shift` (2, N) is `v`, by which each landmark is pulled, in pixels; `weights` (N,) and
    `prior` (P,) are the diagonals of `W` and `r L`; `shape_params` (K,) is the shape part of `p`. The pose part is not
    needed, as `L` is 0 there (Saragih et al. 2011, equation 22).
    """
    flat = jacobian.reshape(-1, jacobian.shape[2])
    of_rows = np.concatenate([weights, weights])
    right = multiply(of_rows * shift.reshape(-1), flat)
    right[N_POSE:] -= prior[N_POSE:] * shape_params
    return solve_definite(normal_matrix(flat, of_rows, prior), right)


def normal_matrix(flat: FloatArray, weights: FloatArray, prior: FloatArray) -> FloatArray:
    """Return ``r L + J^T W J``, (P, P), for `J` (M, P) and the diagonals of `W`, (M,), and of `r L`, (P,)."""
    normal = multiply(flat.T, flat * weights[:, None])
    # If all weights are 0, the pose is undetermined; a small diagonal keeps the system solvable, with a step of 0.
    normal.reshape(-1)[:: len(prior) + 1] += prior + 1e-9
    return normal

"""Who somebody is and what they show: identity and expression as linear spaces (docs/method.md, section 4.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..archives import open_shipped
from ..arrays import FloatArray
from ..assets import ASSETS
from ..landmarks import BROWS, JAW, N_LANDMARKS

FORMAT = "facemime-face-space-1"
FACE_SPACE_FILE = ASSETS / "expressions" / "face_space.npz"

_NOISE = 0.012
"""Standard deviation of tracked landmarks about the model, eye distances."""
_UNIQUE = 0.01
"""Standard deviation of what is unlike anybody in the modes, in each coordinate of a person's face, eye distances."""
_SPARSITY, _RIDGE, _LARGEST = 1.0, 0.5, 2.0
"""Weights of the sum and of half the sum of squares of the activations in equation 4.1, and the largest activation."""
_INDEPENDENT = 12.0
"""Frames that count as independent at most: neighbouring ones err alike, so more would outvote the prior."""
_CALM = 0.1
"""Amount of expression, in eye distances over all landmarks, below which frames count alike."""
_ROUNDS, _SWEEPS = 12, 25
_DEPTH, _CONTOUR = 0.3, 0.3
"""Weights of the depths, which a camera hardly sees, and of the jaw line, whose points slide along it."""


@dataclass(frozen=True)
class FaceSpace:
    """``s = m + I a + E b`` with ``a ~ N(0, 1)`` of a person, and ``b >= 0`` of a moment, mostly 0.

    Expressions only push: no unit takes a neutral face to a less than neutral one. That, and that a person stays the
    same from frame to frame, is what tells a broad mouth from a smile.

    Attributes
    ----------
    mean : (66, 3) float64
        Neutral face: head frame, outer-eye distances.
    identity : (K, 66, 3) float64
        One standard deviation of each mode.
    units : (U, 66, 3) float64
        Expressions at full activation. Like the modes, they leave position, rotation and size of the whole unchanged.
    """

    mean: FloatArray
    identity: FloatArray
    units: FloatArray

    def explain(self, shapes: FloatArray, weights: FloatArray) -> FloatArray:
        """Find the activations of the units in frames of one person (equation 4.1).

        Parameters
        ----------
        shapes : (N, 66, 3) float64
            Pose-free shapes: head frame, outer-eye distances.
        weights : (N,) float64
            Relative trust in the frames, positive.

        Returns
        -------
        (N, U) float64
            Activations, at least 0.

        Notes
        -----
        Takes 0.3 s for 300 frames.
        """
        *_, activations = self.sweeps(shapes, weights)
        return activations

    def sweeps(self, shapes: FloatArray, weights: FloatArray) -> Iterator[FloatArray]:
        """Yield the activations (N, U) of `explain` after each sweep, all in one array; the last ones are the result.

        Notes
        -----
        Alternates between the identity, a ridge regression, and the activations, by coordinate descent over all frames
        at once (Friedman et al. 2010). A sweep takes 1 ms.
        """
        away = without_similarity(shapes - self.mean, self.mean).reshape(len(shapes), -1) * _TRUST / _NOISE
        own, shown = self._scaled
        outer = own @ own.T
        gram, activations = shown @ shown.T, np.zeros((len(shapes), len(shown)))
        person = np.zeros(len(own))
        for _ in range(_ROUNDS):
            pull = (away - person @ own) @ shown.T
            for _ in range(_SWEEPS):
                for unit, size in enumerate(gram.diagonal()):
                    # The gradient without this unit's own part gives its best value in closed form.
                    left = pull[:, unit] - activations @ gram[unit] + activations[:, unit] * size
                    np.clip((left - _SPARSITY) / (size + _RIDGE), 0.0, _LARGEST, out=activations[:, unit])
                yield activations
            # Calm frames say most about the person: there, least hangs on how well the units match the expression.
            share = weights / (_CALM**2 + np.square(self.amount(activations)))
            share *= min(_INDEPENDENT, len(shapes)) / share.sum()
            precision = share.sum() * outer + np.eye(len(own))
            person = np.linalg.solve(precision, own @ (share @ (away - activations @ shown)))

    def amount(self, activations: FloatArray) -> FloatArray:
        """(N,) amount of expression of activations (N, U): length of all displacements in x and y, eye distances."""
        across = self.units[..., :2].reshape(len(self.units), -1)
        return np.asarray(np.sqrt(np.square(activations @ across).sum(axis=1)))

    @cached_property
    def of_brows(self) -> NDArray[np.bool_]:
        """(U,) whether a unit moves the brows more than all else."""
        moved = np.square(self.units).sum(axis=2)
        return np.asarray(moved[:, BROWS].sum(axis=1) > 0.5 * moved.sum(axis=1))

    @cached_property
    def _scaled(self) -> tuple[FloatArray, FloatArray]:
        """Modes and units as rows of weighted coordinates in standard deviations of the noise."""
        own, shown = (x.reshape(len(x), -1) for x in (self.identity, self.units))
        own = np.concatenate([own, _UNIQUE * np.eye(own.shape[1])])
        return own * _TRUST / _NOISE, shown * _TRUST / _NOISE


def without_similarity(displacements: FloatArray, mean: FloatArray) -> FloatArray:
    """Remove the part of displacements that moves, turns or scales the whole face.

    Parameters
    ----------
    displacements : (N, 66, 3) float64
        Displacements from `mean`.
    mean : (66, 3) float64
        Face about which they are linearised.

    Returns
    -------
    (N, 66, 3) float64
        What is left, by weighted least squares.
    """
    whole = np.stack(list(_similarities(mean))).reshape(7, -1)
    flat = displacements.reshape(len(displacements), -1)
    moved, *_ = np.linalg.lstsq((whole * _TRUST).T, (flat * _TRUST).T, rcond=None)
    return np.asarray(flat - moved.T @ whole).reshape(displacements.shape)


def _similarities(mean: FloatArray) -> Iterator[FloatArray]:
    """The seven directions (66, 3) in which a face grows, moves and turns."""
    centred = mean - mean.mean(axis=0)
    yield centred
    for axis in np.eye(3):
        yield np.broadcast_to(axis, centred.shape)
        yield np.cross(axis, centred)


def _trust() -> FloatArray:
    trust = np.ones((N_LANDMARKS, 3))
    trust[:, 2] = _DEPTH
    trust[JAW] *= _CONTOUR
    return trust.reshape(-1)


_TRUST = _trust()


@lru_cache(maxsize=1)
def load_face_space() -> FaceSpace:
    """Read the spaces that are shipped.

    Raises
    ------
    ModelError
        If the file is missing, damaged, or of another version.
    """
    with open_shipped(FACE_SPACE_FILE, FORMAT) as archive:
        return FaceSpace(
            mean=archive.floats("mean", (N_LANDMARKS, 3)),
            identity=archive.floats("identity", (None, N_LANDMARKS, 3)),
            units=archive.floats("units", (None, N_LANDMARKS, 3)),
        )

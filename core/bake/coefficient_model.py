"""What the tracker shows of each ARKit coefficient, learnt by `lab.training.coefficients` (method.md, section
9.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..face.actions import N_ACTIONS
from ..face.coefficient_names import FITTED
from ..face.landmarks import N_LANDMARKS
from ..files.archives import Archive, open_shipped
from ..files.assets import ASSETS
from ..numeric.arrays import FloatArray

FORMAT = "facemime-coefficients-2"
COEFFICIENT_FILE = ASSETS / "expressions" / "coefficients.npz"
N_OBSERVED = 3 * N_LANDMARKS + N_ACTIONS
"""Size of an observation: 66 displacements in the built-in head's outer-eye distances, and 15 activations."""
HIDDEN = (256, 128)
"""Widths of the hidden layers of the network that corrects the fit."""


@dataclass(frozen=True)
class Spread:
    """A covariance ``F^T F + diag(s)^2``.

    Attributes
    ----------
    modes : (K, 213) float64
        F, the directions of most of the variance.
    rest : (213,) float64
        s, standard deviations of the remainder.
    """

    modes: FloatArray
    rest: FloatArray

    def matrix(self) -> FloatArray:
        """Return the covariance matrix, (213, 213) float64."""
        return np.asarray(self.modes.T @ self.modes + np.diag(np.square(self.rest)))


@dataclass(frozen=True)
class Layer:
    """A layer of a network, ``y = x W + b``.

    Attributes
    ----------
    weights : (I, O) float64
        W.
    offsets : (O,) float64
        b.
    """

    weights: FloatArray
    offsets: FloatArray


@dataclass(frozen=True)
class CoefficientModel:
    """Model of observations, ``x = a R + e + n``, of coefficients a with the errors of a frame and of the neutral face.

    Attributes
    ----------
    responses : (44, 213) float64
        R, the observation of each of the coefficients `FITTED` at value 1.
    frame : Spread
        Covariance of e, which differs from frame to frame: the tracker's noise, and differences between people.
    neutral : Spread
        Covariance of n, which is the same for a whole take.
    together : (44, 44) float64
        P, the inverse of the mean product of any two coefficients: how they go together.
    gains : (44,) float64
        Factors that compensate for the shrinkage of the amplitudes by the prior.
    correction : tuple of Layer
        A network from an observation and its fitted coefficients, (213 + 44,), to what the fit lacks, (44,), with ramps
        between its layers. If it has no layers, the fit is not corrected.
    """

    responses: FloatArray
    frame: Spread
    neutral: Spread
    together: FloatArray
    gains: FloatArray
    correction: tuple[Layer, ...] = ()


@lru_cache(maxsize=1)
def load_coefficient_model(path: Path = COEFFICIENT_FILE) -> CoefficientModel:
    """Read the shipped model, once.

    Raises
    ------
    ModelError
        If the file is missing, damaged, or of a different version.
    """
    count = len(FITTED)
    with open_shipped(path, FORMAT) as archive:
        return CoefficientModel(
            responses=archive.floats("responses", (count, N_OBSERVED)),
            frame=_spread(archive, "frame"),
            neutral=_spread(archive, "neutral"),
            together=archive.floats("together", (count, count)),
            gains=archive.floats("gains", (count,)),
            correction=_correction(archive, (N_OBSERVED + count, *HIDDEN, count)),
        )


def _correction(archive: Archive, widths: tuple[int, ...]) -> tuple[Layer, ...]:
    return tuple(
        Layer(archive.floats(f"correction.{i}.weights", shape), archive.floats(f"correction.{i}.offsets", shape[1:]))
        for i, shape in enumerate(pairwise(widths))
    )


def _spread(archive: Archive, name: str) -> Spread:
    return Spread(archive.floats(f"{name}.modes", (None, N_OBSERVED)), archive.floats(f"{name}.rest", (N_OBSERVED,)))

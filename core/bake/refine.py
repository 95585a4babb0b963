"""Expression keys refined by takes, so that coefficients move a head as its performer does (method, section 9.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..drive.driver import HeadDriver
from ..face.coefficient_names import COEFFICIENTS
from ..heads.rig import HeadRig
from ..numeric import linalg
from ..takes.neutral import calibrate
from ..takes.take import Take
from .arkit import arkit_coefficients

_FRAMES = 150
"""Largest number of frames of a take that count."""
_LOYALTY = 0.03
"""Weight of the keys as they were, per frame. On clips of strangers, the error of refined keys on another clip is about
the same from 0.01 to 0.1; that on the same clip grows from 0.03 to 0.3."""
_EXACT = ("eyeBlink", "eyeLook", "mouthClose")
"""Beginnings of the names of keys that have to meet something, and so stay as they were."""


def refined_keys(
    skin: HeadRig,
    names: Sequence[str],
    motions: NDArray[np.float32],
    takes: Sequence[Take],
    progress: Callable[[float], None] = lambda share: None,
) -> NDArray[np.float32]:
    """Refine ARKit's keys of a head by what takes do to it (equation 9.8).

    Parameters
    ----------
    skin : HeadRig
        The head without its parts.
    names : sequence of str
        Names of the keys, (K,), of ARKit's coefficients.
    motions : (K, V, 3) float32
        Their displacements of the vertices: head frame, unit of the mesh.
    takes : sequence of Take
        Takes, each with a face.
    progress : callable, optional
        Is called with the share of the frames that are done, 0 to 1.

    Returns
    -------
    (K, V, 3) float32
        The refined displacements. Keys that the takes do not show, or that are still, stay as they were, and so do
        those of blinks, gaze and closed lips.

    Raises
    ------
    SourceError
        If a take has no face.
    """
    columns = [COEFFICIENTS.index(name) for name in names]
    keys = motions.reshape(len(motions), -1)
    together, shown = np.zeros((len(names), len(names))), np.zeros(keys.shape, dtype=np.float32)
    driver: HeadDriver | None = None
    count = 0
    for done, take in enumerate(takes):
        neutral = calibrate(take)
        found = np.flatnonzero(take.found)
        chosen = np.zeros(len(take), dtype=bool)
        chosen[found[np.linspace(0, len(found) - 1, min(_FRAMES, len(found))).round().astype(np.intp)]] = True
        sample = take.part(chosen)
        # Sums of the normal equations of 9.8 over frames: C^T C and C^T X, so that no motion has to be kept.
        amounts = arkit_coefficients(sample, neutral)[:, columns]
        driver = HeadDriver(skin, neutral, reuse=driver)
        together += amounts.T @ amounts
        count += len(amounts)
        for number, amount in enumerate(amounts.astype(np.float32)):
            moved = (driver.frame(sample.result(number)).vertices - driver.rest).reshape(-1)
            shown += np.outer(amount, moved)
            progress((done + (number + 1) / len(amounts)) / len(takes))
    # X = (C^T C + l n 1)^-1 (C^T M + l n K) for keys X near the former K; solved for the change X - K, which is 0 for
    # keys that the takes do not show.
    loyal = together + _LOYALTY * max(count, 1) * np.eye(len(names))
    change = linalg.solve(loyal, shown - together.astype(np.float32) @ keys)
    still = ~motions.any(axis=(1, 2))
    change[still | [name.startswith(_EXACT) for name in names]] = 0.0
    return np.asarray((keys + change).reshape(motions.shape), dtype=np.float32)

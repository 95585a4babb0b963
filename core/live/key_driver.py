"""A head that is driven live by its own shape keys, as a bake by a key mapping would drive it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..bake.arkit import FrameCoefficients
from ..bake.key_map import KeyMap
from ..drive.driver import HeadDriver, HeadFrame
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult


@dataclass(frozen=True, eq=False)
class LiveKeys:
    """Shape keys of a head, and the mapping that drives them.

    Attributes
    ----------
    table : KeyMap
        The key mapping.
    offsets : dict of str to (A, 3) float32
        Displacements at value 1 of the vertices in `HeadRig.all_vertices`: head frame, unit of the mesh.
    ranges : dict of str to (float, float)
        Smallest and largest value of each key.
    """

    table: KeyMap
    offsets: dict[str, NDArray[np.float32]]
    ranges: dict[str, tuple[float, float]]


class KeyDriver:
    """Drives a head by its shape keys; the pose comes from a `HeadDriver`.

    Parameters
    ----------
    head : HeadDriver
        Driver of the pose.
    neutral : Neutral
        Neutral face of `head`, not mirrored.
    keys : LiveKeys
        The shape keys.

    Attributes
    ----------
    head : HeadDriver
        As given.
    keys : LiveKeys
        As given.

    Attributes
    ----------
    head : HeadDriver
    keys : LiveKeys
    """

    def __init__(self, head: HeadDriver, neutral: Neutral, keys: LiveKeys) -> None:
        self.head, self.keys = head, keys
        self._coefficients = FrameCoefficients(neutral, head.options)

    def frame(self, result: TrackResult) -> HeadFrame:
        """Compute the head for a tracking result with a face."""
        posed = self.head.frame(result)
        values = self.keys.table.apply(self._coefficients.of(result)[None], self.keys.ranges)
        vertices = np.array(self.head.rest, dtype=np.float32)
        for name, (value,) in values.items():
            if value != 0.0:
                vertices += np.float32(value) * self.keys.offsets[name]
        amounts = np.array([float(values[name][0]) if name in values else 0.0 for name in self.keys.offsets])
        return replace(posed, vertices=vertices, keys=amounts)

"""The choice: which of several faces is the performer's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .identity import Identity, portrait
from .pdm import FittedShape
from .search import Candidate, largest

_REMEMBERED, _BEHIND = 25, 75
"""Frames for which a lost face is waited for where it was before another one is taken: after a cut, or where it left,
and while a bystander is in front of it."""
LEFTMOST, RIGHTMOST = (-1e6, 0.0), (1e6, 0.0)
"""Places for `FaceTracker.choose`: far out to either side."""


class FaceChoice:
    """The face that the user named; otherwise the one that was lost, while it is waited for; otherwise the largest.

    Attributes
    ----------
    misses : int
        Frames since the face was last found.
    """

    def __init__(self) -> None:
        self.misses = 0
        self._named: FloatArray | None = None
        self._lost: FittedShape | None = None

    @property
    def waiting(self) -> bool:
        """Whether a certain face is waited for, not just any."""
        return self._named is not None or self._lost is not None

    def name(self, x: float, y: float) -> None:
        """Take the face nearest to the place (x, y), pixels, when one is found."""
        self._named = np.array([x, y], np.float64)

    def lose(self, last: FittedShape) -> None:
        """Wait for the face that was here a frame ago."""
        self._lost = last

    def settle(self) -> None:
        """A face was chosen."""
        self._named = self._lost = None
        self.misses = 0

    def pick(self, grey: NDArray[np.uint8], candidates: Sequence[Candidate], identity: Identity) -> Candidate | None:
        """The face to track of those in view, or None; `identity` starts again where it may be anybody's.

        Parameters
        ----------
        grey : (H, W) uint8
            The image in which they were found.
        candidates : sequence of Candidate
        identity : Identity
            Of the performer who was lost.
        """
        if self._named is not None and candidates:
            x, y = self._named
            return min(candidates, key=lambda c: c.distance(x, y))
        if self._lost is None or self.misses >= (_BEHIND if identity.crowded else _REMEMBERED):
            identity.reset()
            return largest(candidates)
        poses = [c.pose for c in candidates]
        own = identity.candidates([portrait(grey, pose) for pose in poses], poses)
        return largest([candidates[i] for i in own if self._in_reach(candidates[i])])

    def _in_reach(self, candidate: Candidate) -> bool:
        """Whether a face may be the one that was lost so many frames ago: near enough, and about as large."""
        assert self._lost is not None
        pose, reach = self._lost.pose, 1.5 + 0.2 * self.misses
        near = candidate.distance(pose[4], pose[5]) < reach * pose[0]
        return near and 0.6 < float(candidate.pose[0] / pose[0]) < 1.7

"""Choice of the performer's face among several (method.md, section 3.7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .identity import PerformerIdentity, describe_face
from .pdm import FittedShape
from .search import Candidate, largest

_WAIT_FRAMES = 25
"""Frames for which a lost face is awaited before another one is taken."""
_WAIT_CROWDED_FRAMES = 75
"""Frames for which it is awaited while a bystander may hide it."""
LEFTMOST, RIGHTMOST = (-1e6, 0.0), (1e6, 0.0)
"""Positions in pixels for `FaceTracker.choose`, far to the left and right of any image."""


class FaceChoice:
    """Chooses the requested face; else the lost face, while it is awaited; else the largest.

    Attributes
    ----------
    misses : int
        Frames since the face was last found.
    """

    def __init__(self) -> None:
        self.misses = 0
        self._requested: FloatArray | None = None
        self._lost: FittedShape | None = None

    @property
    def waiting(self) -> bool:
        """Whether a particular face is awaited, rather than any."""
        return self._requested is not None or self._lost is not None

    def request(self, x: float, y: float) -> None:
        """Choose the face nearest to a point as soon as one is found.

        Parameters
        ----------
        x, y : float
            Position in pixels.
        """
        self._requested = np.array([x, y], np.float64)

    def wait_for(self, last: FittedShape) -> None:
        """Wait for the face that was last seen at the fit `last`."""
        self._lost = last

    def settle(self) -> None:
        """Note that a face was found, so that none is awaited any more."""
        self._requested = self._lost = None
        self.misses = 0

    def pick(
        self, grey: NDArray[np.uint8], candidates: Sequence[Candidate], identity: PerformerIdentity
    ) -> Candidate | None:
        """Choose the face to track. Resets `identity` if that may be anybody's.

        Parameters
        ----------
        grey : (H, W) uint8
            The image in which the candidates were found.
        candidates : sequence of Candidate
            The faces in view.
        identity : PerformerIdentity
            Identity of the lost performer.

        Returns
        -------
        Candidate or None
            The face; None if no candidate qualifies.
        """
        if self._requested is not None and candidates:
            x, y = self._requested
            return min(candidates, key=lambda c: c.distance(x, y))
        if self._lost is None or self.misses >= (_WAIT_CROWDED_FRAMES if identity.crowded else _WAIT_FRAMES):
            identity.reset()
            return largest(candidates)
        poses = [c.pose for c in candidates]
        own = identity.candidates([describe_face(grey, pose) for pose in poses], poses)
        return largest([candidates[i] for i in own if self._in_reach(candidates[i])])

    def _in_reach(self, candidate: Candidate) -> bool:
        """Whether a face can be the lost one, given the time since: near enough, and of about the same size."""
        assert self._lost is not None
        pose, reach = self._lost.pose, 1.5 + 0.2 * self.misses
        near = candidate.distance(pose[4], pose[5]) < reach * pose[0]
        return near and 0.6 < float(candidate.pose[0] / pose[0]) < 1.7

"""Which of several faces performs: a picture of a face does not move (method.md, section 3.7).

Clips of reenactment, reactions and news show a portrait beside the performer, often larger, and posters hang behind
people. A video of one person is never as still as a picture, not even for a second.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .grey import Grey
from .reference import warp_to_reference

_SIDE = 40
"""Side in pixels of the crop that is compared."""
_SCALE = 26.0
"""Pixels of the crop per outer-eye distance."""
_STILL = 0.03
"""Largest change of a face that is a picture, relative to the contrast of the crop. Within a second, the pictures in
five clips of strangers change by 0.016 at most, on the half it was chosen on by 0.009, and the faces of 39 others by
0.1 or more."""
_ALIVE = 0.1
"""Change above which a face performs."""
_AS_LARGE = 0.8
"""Size, relative to the largest one, of faces that are about as large."""
WATCHED = 25
"""Frames after which it is judged who performs."""


class Rivals:
    """Faces that may be the performer's, watched where they were first seen in a grey image.

    `tracked` is the pose (6,) of the face that was chosen, `others` are those of further faces, the surest first, in
    the image frame.
    """

    def __init__(self, grey: Grey, tracked: FloatArray, others: Sequence[FloatArray]) -> None:
        self.poses = [tracked]
        self._looks = [_look(grey, tracked)]
        self._changes = [0.0]
        self._frames = 0
        self.add(grey, others)

    def add(self, grey: Grey, others: Sequence[FloatArray]) -> None:
        """Watch further faces as well, at poses (6,) in a grey image, unless one is watched there already."""
        for pose in others:
            if all(float(np.hypot(*(pose[4:6] - known[4:6]))) > known[0] for known in self.poses):
                self.poses.append(pose)
                self._looks.append(_look(grey, pose))
                self._changes.append(0.0)

    def watch(self, grey: Grey) -> None:
        """Compare the next image."""
        self._frames += 1
        for i, (pose, look) in enumerate(zip(self.poses, self._looks, strict=True)):
            change = np.abs(_look(grey, pose) - look).mean() / max(float(look.std()), 1.0)
            self._changes[i] = max(self._changes[i], float(change))

    @property
    def alone(self) -> bool:
        """Whether no other face is watched."""
        return len(self.poses) == 1

    @property
    def settled(self) -> bool:
        """Whether the tracked face has moved, so that it is no picture."""
        return self._changes[0] > _STILL

    @property
    def due(self) -> bool:
        """Whether to judge after this image."""
        return self._frames % WATCHED == 0

    def performing(self) -> FloatArray | None:
        """Return the pose (6,) of the largest other face that has moved, where it was first seen; None if none has.

        Of faces about as large, such as a performer and the animation of a portrait, it is the surest one's.
        """
        moving = [pose for pose, change in zip(self.poses[1:], self._changes[1:], strict=True) if change > _ALIVE]
        least = _AS_LARGE * max((float(pose[0]) for pose in moving), default=0.0)
        return next((pose for pose in moving if pose[0] >= least), None)


def _look(grey: Grey, pose: FloatArray) -> NDArray[np.float32]:
    """Crop of a face, (40, 40)."""
    return warp_to_reference(grey, pose, _SCALE, (_SIDE, _SIDE)).pixels.astype(np.float32)

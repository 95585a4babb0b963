"""Whose face it is: the performer's, told from those of bystanders who pass in front of it.

Where two people cross, the landmarks of the one behind slip onto the one in front, who is a perfectly good face. What
gives the change away is the look of the face, little as a small picture says of who somebody is: it is compared with
what was seen of the two a moment ago, in the same light, not with people in general. Nothing of it is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .reference import warp_to_reference

_SIDE, _SCALE, _CELLS = 40, 26.0, 10
"""Side of a portrait in pixels, pixels an outer-eye distance in it, cells a side of its description."""
_CENTRE, _RADII = (19.5, 21.0), (15.0, 18.0)
"""The oval from brows to chin that counts, in the portrait's pixels."""
_FLOOR = 16.0
"""Added to the squared contrast of a cell: flat skin says nothing."""
_SAME, _SIMILAR = 0.85, 0.8
"""Likeness above which a face surely is the one followed, and above which two looks are of one other person."""
_MORE, _LESS = 0.06, 0.1
"""By how much a face must be liker somebody before it counts as theirs, and by how much less like the one that was lost
it may be where nobody else was."""
_LEARNT, _IN_DOUBT, _OF_OTHERS = 0.2, 0.05, 0.3
"""Share of the newest look in what is remembered: of the face followed, of the same while something is odd about it
(a hand, a new light: what lasts two seconds is got used to), and of others."""
_AT_ONCE = 6
"""Odd looks in a row from which on it is searched for others at every sixth only."""
_MOST = 4
"""Others who are remembered at once."""
_STEP, _STRAY = 0.25, 0.08
"""Eye distances that a face may be from where it was a frame ago, and more with every further frame."""
_FORGOTTEN, _LATELY = 12, 50
"""Frames after which a place says nothing any more, and after which somebody is not there any more."""


def portrait(grey: NDArray[np.uint8], pose: FloatArray) -> NDArray[np.float32]:
    """(400,) of length 1: how a face of a grey image (H, W) looks at its fitted pose (6,).

    Slopes of the picture, up, down, left and right, averaged over cells and scaled to equal contrast in each (a coarse
    histogram of gradients: Dalal & Triggs 2005); 0.04 ms. The product of two portraits is their likeness: some 0.97
    from second to second of one person, 0.85 where the expression changes, 0.7 between people.
    """
    picture = warp_to_reference(grey, pose, _SCALE, (_SIDE, _SIDE)).pixels
    across = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    slopes = np.stack([across, -across, down, -down], axis=-1)
    np.maximum(slopes, 0.0, out=slopes)
    slopes *= _OVAL
    cells = cv2.resize(slopes, (_CELLS, _CELLS), interpolation=cv2.INTER_AREA)
    cells /= np.sqrt(np.square(cells).sum(axis=-1, keepdims=True) + np.float32(_FLOOR))
    return _unit(cells.reshape(-1) - cells.mean())


def _oval() -> NDArray[np.float32]:
    y, x = np.mgrid[0:_SIDE, 0:_SIDE]
    inside = ((x - _CENTRE[0]) / _RADII[0]) ** 2 + ((y - _CENTRE[1]) / _RADII[1]) ** 2 <= 1.0
    out: NDArray[np.float32] = inside.astype(np.float32)[..., None]
    return out


def _unit(look: NDArray[np.float32]) -> NDArray[np.float32]:
    out: NDArray[np.float32] = look / max(float(np.linalg.norm(look)), 1e-6)
    return out


def _blended(old: NDArray[np.float32], new: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    return _unit(old + np.float32(share) * (new - old))


@dataclass
class _Bystander:
    """Somebody else: appearance, and where (6,) and in which frame last seen."""

    look: NDArray[np.float32]
    pose: FloatArray
    frame: int

    def continues(self, pose: FloatArray, frame: int) -> bool:
        """Whether a face at `pose` (6,) is where this one may have gone since."""
        age = frame - self.frame
        away = float(np.hypot(*(pose[4:6] - self.pose[4:6]))) / self.pose[0]
        return age < _FORGOTTEN and away < _STEP + _STRAY * age and 0.75 < pose[0] / self.pose[0] < 1.33


@dataclass
class Identity:
    """What is remembered of the performer's face, and of bystanders'.

    Attributes
    ----------
    frame : int
        Number of the present frame; whoever owns this counts it up.
    """

    frame: int = 0
    _own: NDArray[np.float32] | None = None
    _doubts: int = 0
    _bystanders: list[_Bystander] = field(default_factory=list)

    @property
    def crowded(self) -> bool:
        """Whether a bystander was seen lately."""
        return any(self.frame - other.frame < _LATELY for other in self._bystanders)

    @property
    def search_due(self) -> bool:
        """Whether to search for bystanders, as the tracked face looks odd: at once, and less often while it lasts."""
        return self._doubts < _AT_ONCE or self._doubts % _AT_ONCE == 0

    def reset(self) -> None:
        """Start again with another performer."""
        self._own, self._doubts = None, 0
        self._bystanders = []

    def recognises(self, look: NDArray[np.float32]) -> bool:
        """Whether this portrait is certainly the performer's; if so, it is remembered."""
        if self._own is None:
            self._own = look
            return True
        if float(self._own @ look) < _SAME:
            return False
        self._own, self._doubts = _blended(self._own, look, _LEARNT), 0
        return True

    def is_bystander(self, look: NDArray[np.float32]) -> bool:
        """Whether this portrait is closer to a bystander's."""
        return self._margin(look) < -_MORE

    def adapt(self, look: NDArray[np.float32]) -> None:
        """Remember a little of a portrait that may be the performer's."""
        assert self._own is not None
        self._own = _blended(self._own, look, _IN_DOUBT)
        self._doubts += 1

    def update_bystander(self, look: NDArray[np.float32], pose: FloatArray) -> None:
        """Remember a face at `pose` (6,) as a bystander's: one who was there, one who looks alike, or a new one."""
        there = [other for other in self._bystanders if other.continues(pose, self.frame)]
        alike = [other for other in self._bystanders if float(other.look @ look) > _SIMILAR]
        if there or alike:
            other = max(there or alike, key=lambda o: float(o.look @ look))
            other.look, other.pose, other.frame = _blended(other.look, look, _OF_OTHERS), pose, self.frame
        else:
            self._bystanders = [*self._bystanders, _Bystander(look, pose, self.frame)][-_MOST:]

    def candidates(self, looks: Sequence[NDArray[np.float32]], poses: Sequence[FloatArray]) -> list[int]:
        """Indices of the faces in view that may be the performer's; bystanders who are still there are updated.

        Such a face looks more like the performer than like anybody else, or is where nobody was and looks about as
        much like either.
        """
        own = []
        for i, (look, pose) in enumerate(zip(looks, poses, strict=True)):
            margin = self._margin(look)
            somebody = any(other.continues(pose, self.frame) for other in self._bystanders)
            if margin > _MORE or (margin > -_LESS and not somebody):
                own.append(i)
            elif somebody:
                self.update_bystander(look, pose)
        return own

    def _margin(self, look: NDArray[np.float32]) -> float:
        """By how much a portrait is closer to the performer's than to any bystander's."""
        if self._own is None or not self._bystanders:
            return 1.0
        return float(self._own @ look) - max(float(other.look @ look) for other in self._bystanders)


_OVAL = _oval()

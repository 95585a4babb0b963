"""Choice of the performer's face among several, and its distinction from those of bystanders (method.md, section 3.7).

When two people cross, the landmarks of the one behind slip onto the one in front, which is a perfectly good face.
The appearance reveals the change. A coarse description suffices, as it is compared with how the two looked a moment
ago in the same light, not with people in general. Nothing is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numeric.arrays import FloatArray
from .grey import Grey
from .pdm import FittedShape
from .reference import warp_to_reference
from .search import CERTAIN, Candidate, largest

_SIDE = 40
"""Side in pixels of the crop that is described."""
_SCALE = 26.0
"""Pixels of the crop per outer-eye distance."""
_CELLS = 10
"""Cells per side of the crop."""
_CENTRE = (19.5, 21.0)
"""Centre of the oval from brows to chin that is described, in pixels of the crop."""
_RADII = (15.0, 18.0)
"""Half of the width and of the height of that oval, in pixels of the crop."""
_CONTRAST_FLOOR = 16.0
"""Added to the squared contrast of a cell, so that flat skin contributes little."""
_SAME = 0.85
"""Similarity above which a face is certainly the tracked one."""
_SAME_BYSTANDER = 0.8
"""Similarity above which two faces are the same bystander."""
_MARGIN = 0.06
"""How much more similar to one person than to another a face has to be to count as theirs."""
_TOLERANCE = 0.1
"""How much less similar to the lost person than to another a face may be if nobody else was seen there."""
_ALIKE = 0.8
"""Similarity above which a face away from the place where the performer's was lost may be theirs. Chosen on every
second of 51 clips of strangers: 94 % of the frames of the same person are, half a second to two seconds later, and
3.5 % of other people's; on the other clips 89 and 3 %. At 0.75 these are 96 and 12 %, and 92 and 12 %."""
_ALIKE_ALONE = 0.7
"""The same where nobody else was seen yet, as performers who are alone may come back in another light: 97 % of the same
person's frames exceed it, and 93 % on the other clips, in strong light from aside 85 and 82 %; other people's 25 and
23 %."""
_NEARBY = 1.5
"""Distance in eye distances from that place within which it may be theirs whatever it looks like: hands, light and
jump cuts change looks at once, and faces side by side are farther apart."""
_LEARNING_RATE = 0.2
"""Share of the newest descriptor in the remembered one of the tracked face."""
_UNSURE_RATE = 0.05
"""The same share while the tracked face looks unusual: a hand or a new light is accepted after about two seconds."""
_BYSTANDER_RATE = 0.3
"""The same share for a bystander."""
_PROMPT_SEARCHES = 6
"""Number of consecutive unusual checks that each search for bystanders; after that, only every sixth does."""
_MAX_BYSTANDERS = 4
"""Largest number of bystanders that are remembered."""
_STEP = 0.25
"""Distance, in eye distances, between a face and where a bystander was last seen within which it may be theirs."""
_DRIFT = 0.08
"""Distance, in eye distances, by which that grows with each frame since then."""
_POSITION_FRAMES = 12
"""Frames for which the position of a bystander stays valid."""
_PRESENCE_FRAMES = 50
"""Frames for which a bystander who is not seen counts as present."""
_WAIT_FRAMES = 25
"""Frames for which a lost face is awaited before another one is taken."""
_WAIT_CROWDED_FRAMES = 75
"""Frames for which it is awaited while a bystander may hide it."""
LEFTMOST, RIGHTMOST = (-1e6, 0.0), (1e6, 0.0)
"""Positions in pixels for `FaceTracker.choose`, far to the left and right of any image."""


def describe_face(grey: Grey, pose: FloatArray) -> NDArray[np.float32]:
    """Describe the appearance of a face at `pose` (6,) by a vector (400,) of length 1, to compare it within one video.

    The inner product of two descriptors is their similarity: about 0.97 from one second to the next for one person,
    0.85 across a change of expression, 0.7 between people. It is a coarse histogram of gradients (Dalal & Triggs 2005):
    slopes up, down, left and right, averaged over cells and normalised per cell. It takes 0.04 ms.
    """
    # Slopes in four directions within the oval.
    crop = warp_to_reference(grey, pose, _SCALE, (_SIDE, _SIDE)).pixels
    across = cv2.Sobel(crop, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(crop, cv2.CV_32F, 0, 1)
    slopes = np.stack([across, -across, down, -down], axis=-1)
    np.maximum(slopes, 0.0, out=slopes)
    slopes *= _OVAL
    cells = cv2.resize(slopes, (_CELLS, _CELLS), interpolation=cv2.INTER_AREA)
    # Normalise the contrast per cell, then the total length, which makes descriptors independent of the light.
    cells /= np.sqrt(np.square(cells).sum(axis=-1, keepdims=True) + np.float32(_CONTRAST_FLOOR))
    return _normalise(cells.reshape(-1) - cells.mean())


def are_same(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Return whether two descriptors (400,) are certainly of the same face in the same light."""
    return float(one @ other) >= _SAME


def _oval() -> NDArray[np.float32]:
    y, x = np.mgrid[0:_SIDE, 0:_SIDE]
    inside = ((x - _CENTRE[0]) / _RADII[0]) ** 2 + ((y - _CENTRE[1]) / _RADII[1]) ** 2 <= 1.0
    out: NDArray[np.float32] = inside.astype(np.float32)[..., None]
    return out


def _normalise(descriptor: NDArray[np.float32]) -> NDArray[np.float32]:
    out: NDArray[np.float32] = descriptor / max(float(np.linalg.norm(descriptor)), 1e-6)
    return out


def blended(old: NDArray[np.float32], new: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Mix a share of a new descriptor (400,) into an old one."""
    return _normalise(old + np.float32(share) * (new - old))


@dataclass
class _Bystander:
    """Another person.

    Attributes
    ----------
    descriptor : (400,) float32
        Appearance, as returned by `describe_face`.
    pose : (6,) float64
        Pose when last seen, in the image frame.
    frame : int
        Number of the frame when last seen.
    """

    descriptor: NDArray[np.float32]
    pose: FloatArray
    frame: int

    def continues(self, pose: FloatArray, frame: int) -> bool:
        """Whether this person can have moved to `pose` (6,) by `frame`."""
        age = frame - self.frame
        away = float(np.hypot(*(pose[4:6] - self.pose[4:6]))) / self.pose[0]
        return age < _POSITION_FRAMES and away < _STEP + _DRIFT * age and 0.75 < pose[0] / self.pose[0] < 1.33


@dataclass
class PerformerIdentity:
    """Appearance of the performer and of bystanders; the owner increments `frame`, the number of the current frame."""

    frame: int = 0
    _own: NDArray[np.float32] | None = None
    _unusual: int = 0
    _bystanders: list[_Bystander] = field(default_factory=list)

    @property
    def crowded(self) -> bool:
        """Whether a bystander was seen recently."""
        return any(self.frame - other.frame < _PRESENCE_FRAMES for other in self._bystanders)

    @property
    def search_due(self) -> bool:
        """Whether to search for bystanders when the tracked face looks unusual: often at first, then less often."""
        return self._unusual < _PROMPT_SEARCHES or self._unusual % _PROMPT_SEARCHES == 0

    def reset(self) -> None:
        """Forget everybody, so that anybody may be the performer."""
        self._own, self._unusual = None, 0
        self._bystanders = []

    def recognises(self, descriptor: NDArray[np.float32]) -> bool:
        """Return whether a descriptor is certainly the performer's; if so, it is learnt."""
        if self._own is None:
            self._own = descriptor
            return True
        if float(self._own @ descriptor) < _SAME:
            return False
        self._own, self._unusual = blended(self._own, descriptor, _LEARNING_RATE), 0
        return True

    def is_bystander(self, descriptor: NDArray[np.float32]) -> bool:
        """Return whether a descriptor is more similar to a bystander than to the performer."""
        return self._margin(descriptor) < -_MARGIN

    def adapt(self, descriptor: NDArray[np.float32]) -> None:
        """Adapt slowly to a descriptor that may be the performer's."""
        assert self._own is not None
        self._own = blended(self._own, descriptor, _UNSURE_RATE)
        self._unusual += 1

    def update_bystander(self, descriptor: NDArray[np.float32], pose: FloatArray) -> None:
        """Remember a face as that of the bystander at `pose` (6,), else of one who looks alike, else of a new one."""
        # Place before looks: a bystander who turns away looks different, but does not jump.
        there = [other for other in self._bystanders if other.continues(pose, self.frame)]
        alike = [other for other in self._bystanders if float(other.descriptor @ descriptor) > _SAME_BYSTANDER]
        if there or alike:
            other = max(there or alike, key=lambda o: float(o.descriptor @ descriptor))
            other.descriptor = blended(other.descriptor, descriptor, _BYSTANDER_RATE)
            other.pose, other.frame = pose, self.frame
        else:
            self._bystanders = [*self._bystanders, _Bystander(descriptor, pose, self.frame)][-_MAX_BYSTANDERS:]

    def candidates(
        self, descriptors: Sequence[NDArray[np.float32]], poses: Sequence[FloatArray], nearby: Sequence[bool]
    ) -> list[int]:
        """Return the indices of faces in view that may be the performer's, and update bystanders who are present.

        Such a face is more similar to the performer than to anybody else, or about as similar and in a place where
        nobody else was. It is also `nearby`, where the performer was lost, or certainly similar. Any other face away
        from there is a bystander's. Poses (6,) are in the image frame.
        """
        own = []
        for i, (descriptor, pose, near) in enumerate(zip(descriptors, poses, nearby, strict=True)):
            margin = self._margin(descriptor)
            somebody = any(other.continues(pose, self.frame) for other in self._bystanders)
            # Neighbours who look alike are even more similar to how they themselves looked before.
            least = _ALIKE if self._bystanders else _ALIKE_ALONE
            alike = self._own is None or (float(self._own @ descriptor) > least and margin > 0.0)
            if (near or alike) and (margin > _MARGIN or (margin > -_TOLERANCE and not somebody)):
                own.append(i)
            elif somebody or not near:
                self.update_bystander(descriptor, pose)
        return own

    def _margin(self, descriptor: NDArray[np.float32]) -> float:
        """How much more similar a descriptor is to the performer than to any bystander."""
        if self._own is None or not self._bystanders:
            return 1.0
        return float(self._own @ descriptor) - max(float(other.descriptor @ descriptor) for other in self._bystanders)


_OVAL = _oval()


class FaceChoice:
    """Chooses the requested face; else the lost face, while it is awaited; else the largest.

    `misses` are the frames since the face was last found, `anybody` is whether the last `pick` could take any face.
    """

    def __init__(self) -> None:
        self.misses = 0
        self.anybody = False
        self._asked: FloatArray | None = None
        self._requested: FloatArray | None = None
        self._lost: FittedShape | None = None
        self._was_certain = False

    @property
    def waiting(self) -> bool:
        """Whether a particular face is awaited, rather than any."""
        return self._requested is not None or self._lost is not None

    def request(self, x: float, y: float) -> None:
        """Choose the face nearest to a point, in pixels, as soon as one is found."""
        self._asked = self._requested = np.array([x, y], np.float64)

    def lose(self, last: FittedShape) -> None:
        """Wait for the face that was last seen at the fit `last`, unless it never was a face for certain.

        A print on a shirt may be the largest face in view, and is soon lost.
        """
        if self._was_certain or self._asked is not None:
            self._lost = last

    def end_wait(self) -> None:
        """Take the requested face, or else any, as the scene of the lost one has ended."""
        self._requested, self._lost = self._asked, None

    def settle(self, *, certain: bool) -> None:
        """Note that a face was found, so that none is awaited any more, and whether it is one for certain."""
        self._was_certain = certain or (self._was_certain and not self.anybody)
        self.anybody = False
        self._requested = self._lost = None
        self.misses = 0

    def pick(self, grey: Grey, candidates: Sequence[Candidate], identity: PerformerIdentity) -> Candidate | None:
        """Choose the face to track among those found in an image; None if none qualifies.

        Resets `identity`, which is that of the lost performer, if the face may be anybody's.
        """
        self.anybody = False
        if self._requested is not None and candidates:
            x, y = self._requested
            return _beside_others(grey, min(candidates, key=lambda c: c.distance(x, y)), candidates, identity)
        if self._lost is None or self.misses >= (_WAIT_CROWDED_FRAMES if identity.crowded else _WAIT_FRAMES):
            identity.reset()
            self.anybody = True
            return _beside_others(grey, largest(candidates), candidates, identity)
        poses = [c.pose for c in candidates]
        nearby = [_away(c, self._lost.pose) < _NEARBY for c in candidates]
        own = identity.candidates([describe_face(grey, pose) for pose in poses], poses, nearby)
        return largest([candidates[i] for i in own if self._in_reach(candidates[i])])

    def _in_reach(self, candidate: Candidate) -> bool:
        """Whether a face can be the lost one, given the time since: near enough, and of about the same size."""
        assert self._lost is not None
        near = _away(candidate, self._lost.pose) < _NEARBY + 0.2 * self.misses
        return near and 0.6 < float(candidate.pose[0] / self._lost.pose[0]) < 1.7


def _away(candidate: Candidate, pose: FloatArray) -> float:
    """Distance of a face from that at `pose` (6,), in eye distances of the latter."""
    return candidate.distance(pose[4], pose[5]) / float(pose[0])


def _beside_others(
    grey: Grey, chosen: Candidate | None, candidates: Sequence[Candidate], identity: PerformerIdentity
) -> Candidate | None:
    """Remember the faces beside the chosen one as bystanders', and return it."""
    # If the chosen one is no face after all, the performer is among the others.
    if chosen is not None and chosen.confidence >= CERTAIN:
        own = describe_face(grey, chosen.pose)
        for other in candidates:
            if other.confidence >= CERTAIN and _away(other, chosen.pose) > _NEARBY:
                descriptor = describe_face(grey, other.pose)
                if float(own @ descriptor) < _ALIKE:  # pictures of performers would be taken for them as they change
                    identity.update_bystander(descriptor, other.pose)
    return chosen

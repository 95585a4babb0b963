"""Everybody in view: several faces, kept apart through crossings and cuts (method.md, section 3.7), and which of them
drives which head.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numeric.arrays import FloatArray
from .cuts import CutDetector
from .grey import Grey, whole
from .identity import blended, describe_face
from .pdm import FittedShape
from .result import HiddenMouth, TrackResult
from .search import Candidate, largest
from .tracker import FaceTracker

_INTERVAL = 10
"""Frames from one search for people who come into view to the next, while nobody is missing."""
_MISSING = 2
"""The same while somebody is missing."""
_AWAITED = 75
"""Frames for which somebody counts as missing."""
_CHECKED = 3
"""Frames from one check of who is who to the next."""
_ALIKE = 0.85
"""Similarity above which a face that appears may be that of somebody who was lost elsewhere, or before a cut. Of
the frames of 24 clips of strangers, 90 % are more similar than 0.89 to how that person usually looks, and 97 % of the
others' are less; of 23 further clips, 95 % and 99 %. One person in two takes is mended more easily than two in one."""
_CERTAIN = 0.85
"""Confidence above which a face beside known ones is somebody new: maps and pictures on a wall can have 0.7."""
_NEARBY = 0.6
"""The same near the place where they were lost a moment ago."""
_MARGIN = 0.06
"""How much more similar to one person than to another a face has to be to count as theirs."""
_REACH = 1.5
"""Distance in eye distances from the place where a face was lost that counts as near."""
_MOMENT = 25
"""Frames for which that place counts."""
_LEARNING_RATE = 0.2
"""Share of the newest descriptor in the remembered one."""
_SAME_FACE = 1.0
"""Distance in eye distances within which two fits are of one face. Faces side by side are 1.5 apart or more."""
_MOST = 8
"""Largest number of people who are followed at a time."""
_HELD = 5.0
"""Seconds for which a head waits for its person before somebody else may drive it."""


@dataclass
class _Person:
    """Somebody who was seen.

    Attributes
    ----------
    number : int
        Number in order of appearance, from 0.
    descriptor : (400,) float32
        Appearance, as returned by `describe_face`.
    last : FittedShape or None
        Fit in the previous frame; None while the face is lost.
    pose : (6,) float64
        Pose when last seen, in the image frame.
    frame : int
        Number of the frame when last seen.
    """

    number: int
    descriptor: NDArray[np.float32]
    last: FittedShape | None
    pose: FloatArray
    frame: int
    mouth: HiddenMouth = field(default_factory=HiddenMouth)

    def like(self, descriptor: NDArray[np.float32]) -> float:
        """Similarity to a descriptor (400,)."""
        return float(self.descriptor @ descriptor)


class PeopleTracker:
    """Follows all faces in view, which `tracker` finds and fits; it must not track anything itself meanwhile.

    Each further face costs its own fit, but no search of its own: one search for all is made when nobody is followed,
    every other frame while somebody is missing, and otherwise every tenth.
    """

    def __init__(self, tracker: FaceTracker) -> None:
        self._tracker = tracker
        self._people: list[_Person] = []
        self._frame = -1
        self._misses = 0
        self._cut = -1
        self._cuts = CutDetector()

    @property
    def n_modes(self) -> int:
        """Number of modes of the shape model."""
        return self._tracker.pdm.n_modes

    @property
    def model_id(self) -> str:
        """First digits of the model file's checksum."""
        return self._tracker.model_id

    def track(self, image: ArrayLike) -> dict[int, TrackResult]:
        """Track everybody in the next frame of a video, an image as for `FaceTracker.track`.

        Returns the faces in view, by the number of the person in order of appearance, from 0.
        """
        grey = self._tracker.begin(image)
        self._frame += 1
        if self._cuts.is_cut(whole(grey)):  # nobody stays where they were
            self._cut, self._misses = self._frame, 0
            for person in self._people:
                person.last = None
        followed = self._followed(grey)
        self._tell_apart(grey, followed)
        if self._is_search_due(followed):
            self._meet(grey, followed)
        self._misses = 0 if followed else self._misses + 1
        results = {}
        for person in self._people:
            candidate = followed.get(person.number)
            if candidate is None:
                person.last = None
                person.mouth.reset()
                continue
            person.pose, person.frame = candidate.pose, self._frame
            results[person.number] = result = self._tracker.read(grey, candidate, person.mouth)
            person.last = FittedShape(result.pose, result.shape_params)
        return results

    def _followed(self, grey: Grey) -> dict[int, Candidate]:
        """Fits near those of the previous frame that are faces, by the number of the person."""
        followed = {}
        for person in self._people:
            if person.last is not None:
                candidate = self._tracker.search.follow(grey, person.last)
                if candidate.confidence >= self._tracker.lost_below:
                    followed[person.number] = candidate
        return followed

    def _tell_apart(self, grey: Grey, followed: dict[int, Candidate]) -> None:
        """Remove fits that are of somebody else's face, and learn how the others look."""
        contested = {
            number
            for number, one in followed.items()
            if any(other is not one and _overlap(one, other) for other in followed.values())
        }
        if self._frame % _CHECKED and not contested:
            return
        looks = {number: describe_face(grey, candidate.pose) for number, candidate in followed.items()}
        for number in sorted(looks, key=lambda n: -self._people[n].like(looks[n])):
            person, descriptor = self._people[number], looks[number]
            own = person.like(descriptor)
            # Of two fits of one face, that which looks less like its person is dropped (section 3.7).
            taken = any(
                other != number and _overlap(followed[number], followed[other])
                for other in contested
                if other in followed and self._people[other].like(looks[other]) > own
            )
            others = max((p.like(descriptor) for p in self._people if p is not person), default=-1.0)
            if taken or others > max(own + _MARGIN, _ALIKE):
                del followed[number]
            elif number not in contested and own > _ALIKE:
                person.descriptor = blended(person.descriptor, descriptor, _LEARNING_RATE)

    def _is_search_due(self, followed: dict[int, Candidate]) -> bool:
        if not followed:
            return True
        if len(followed) >= _MOST:
            return False
        missing = any(p.number not in followed and self._frame - p.frame < _AWAITED for p in self._people)
        return self._frame % (_MISSING if missing else _INTERVAL) == 0

    def _meet(self, grey: Grey, followed: dict[int, Candidate]) -> None:
        """Search for faces, and add them to `followed` as those of people who were lost, or of new ones."""
        search = self._tracker.search
        if followed:
            found = search.others(grey, [candidate.pose for candidate in followed.values()], small=True)
        else:
            found = search.detect(grey, search.steps(self._misses), small=True, brief=self._misses > 0)
        found = [face for face in found if not any(_overlap(face, other) for other in followed.values())]
        while len(followed) < _MOST and (candidate := largest(found)) is not None:
            found = [other for other in found if not _overlap(candidate, other)]
            descriptor = describe_face(grey, candidate.pose)
            person = self._recognised(candidate, descriptor, followed)
            if person is None:
                if self._people and candidate.confidence < _CERTAIN:
                    continue
                person = _Person(len(self._people), descriptor, None, candidate.pose, self._frame)
                self._people.append(person)
            followed[person.number] = candidate

    def _recognised(
        self, candidate: Candidate, descriptor: NDArray[np.float32], followed: dict[int, Candidate]
    ) -> _Person | None:
        """Return who of those that are lost has a face; None for somebody new."""
        lost = [person for person in self._people if person.number not in followed]
        lost.sort(key=lambda person: -person.like(descriptor))
        for person in lost:
            near = candidate.distance(*person.pose[4:6]) < _REACH * person.pose[0]
            recent = person.frame >= max(self._cut, self._frame - _MOMENT)
            least = _NEARBY if near and recent else _ALIKE
            if person.like(descriptor) > least:
                return person
        return None


def _overlap(one: Candidate, other: Candidate) -> bool:
    """Whether two fits are of one face."""
    apart = one.distance(float(other.pose[4]), float(other.pose[5]))
    return apart < _SAME_FACE * float(max(one.pose[0], other.pose[0]))


class PeopleRoles:
    """Assigns people to heads: those that were chosen, and otherwise whoever appears first and drives no head yet.

    Examples
    --------
    >>> from facemime.core.tracking.people import PeopleRoles
    >>> roles = PeopleRoles()
    >>> roles.assign((0, 0), {0}, 0.0), roles.assign((0, 0), {0, 1}, 0.1)
    ({0: (0,)}, {0: (0,), 1: (1,)})
    >>> roles.assign((2, 0), {0, 1}, 0.2)  # the first head follows the second person
    {1: (0,), 0: (1,)}
    """

    def __init__(self) -> None:
        self._roles: dict[int, int] = {}
        self._seen: dict[int, float] = {}

    def assign(self, wanted: Sequence[int], in_view: Collection[int], time: float) -> dict[int, tuple[int, ...]]:
        """Assign the people in view, and return the heads of each person who drives some, whether in view or not.

        For each head, `wanted` is the number of its person from 1, or 0 for anybody; `in_view` are numbers from 0. Time
        is in seconds.
        """
        self._seen.update(dict.fromkeys(in_view, time))
        chosen = {head: person - 1 for head, person in enumerate(wanted) if person > 0}
        kept = {
            head: person
            for head, person in self._roles.items()
            if head < len(wanted) and person not in chosen.values() and time - self._seen.get(person, -_HELD) < _HELD
        }
        self._roles = kept | chosen
        free = sorted(set(in_view) - set(self._roles.values()))
        for head in range(len(wanted)):
            if head not in self._roles and free:
                self._roles[head] = free.pop(0)
        heads: dict[int, tuple[int, ...]] = {}
        for head, person in sorted(self._roles.items()):
            heads[person] = (*heads.get(person, ()), head)
        return heads

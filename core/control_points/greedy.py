"""Which landmarks are needed as control points: chosen greedily over a whole take (METHOD section 7).

Fewer points make a frame cheaper and let less of the tracker's noise through. The paper looks at one frame; here the
error is the worst of all frames, so that an expression that comes once is not forgotten.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray, as_points
from ..deform.follow import follow_in_region, landmark_covariance
from ..errors import HeadError
from ..heads.regions import DEFAULT_KERNEL, REGIONS, membership, region_sigmas
from ..landmarks import N_LANDMARKS, from_ibug
from ..mesh.kernels import distances, kernel_named
from .difference import SkinDifference

DEFAULT_TOLERANCE = 0.01
_FACE_SIDES = from_ibug((0, 16))
_DROPPED = 8
"""Points, the least needed, that an exchange tries to give up."""
_LEAST_GAIN = 1e-4
"""Of the difference, below which an exchange is none."""

START: tuple[Mapping[int, str], ...] = (
    {
        **{36: "orbicularis oculi, outer corner", 45: "orbicularis oculi, outer corner"},
        **{39: "orbicularis oculi, inner corner", 42: "orbicularis oculi, inner corner"},
        **{38: "upper orbicularis oculi", 43: "upper orbicularis oculi"},
        **{21: "corrugator and procerus", 22: "corrugator and procerus"},
        **{19: "frontalis, middle", 24: "frontalis, middle", 17: "frontalis, outer", 26: "frontalis, outer"},
    },
    {
        **{48: "zygomaticus", 54: "zygomaticus", 51: "upper orbicularis oris"},
        **{41: "lower orbicularis oculi", 46: "lower orbicularis oculi"},
        **{31: "nasalis and levator labii", 35: "nasalis and levator labii"},
        **{36: "orbicularis oculi, outer corner", 45: "orbicularis oculi, outer corner"},
        **{39: "orbicularis oculi, inner corner", 42: "orbicularis oculi, inner corner"},
        **{2: "origin of the zygomaticus", 14: "origin of the zygomaticus"},
    },
    {
        **{48: "depressor anguli oris", 54: "depressor anguli oris", 57: "lower orbicularis oris", 8: "mentalis"},
        **{66: "depressor labii", 5: "platysma", 11: "platysma"},
    },
)
"""For each region, the iBUG landmarks to start from and the muscle that each stands for, the most needed first."""


@dataclass(frozen=True)
class GreedyStep:
    """One change of the selection, and where the worst error is after it.

    Attributes
    ----------
    action : {"start", "add", "drop"}
    landmark, region : int
        Position in the 66, row of `REGIONS`.
    reason : str
        A muscle, or the error that the point takes away.
    points : int
        Control points after the step.
    error : float
        Largest distance of any landmark in any frame from where it was, as a fraction of the face's width.
    frame, worst : int
        The frame and the landmark where that is.
    """

    action: str
    landmark: int
    region: int
    reason: str
    points: int
    error: float
    frame: int
    worst: int


@dataclass(frozen=True)
class GreedySelection:
    """The control points that were chosen.

    Attributes
    ----------
    membership : (3, 66) bool
        Which landmark controls which region.
    steps : tuple of GreedyStep
        In order; the curve of `error` over `points` is what the user sees.
    tolerance : float
        As a fraction of the face's width.
    reached : bool
        Whether the error fell to the tolerance before the points ran out.
    covariance : (66, 66) float, optional
        Of the landmarks' displacements in the take, from which the others know how to follow.
    """

    membership: NDArray[np.bool_]
    steps: tuple[GreedyStep, ...]
    tolerance: float
    reached: bool
    covariance: FloatArray | None = None

    @property
    def landmarks(self) -> NDArray[np.intp]:
        """(P,) the landmarks that control any region, ascending."""
        return np.flatnonzero(self.membership.any(axis=0))

    def reason(self, landmark: int) -> str:
        """Why `landmark` was chosen; empty where it was not."""
        chosen = [step for step in self.steps if step.landmark == landmark and self.membership[step.region, landmark]]
        return "; ".join(dict.fromkeys(step.reason for step in chosen if step.action != "drop"))


def greedy_select(
    landmarks: FloatArray,
    displacements: FloatArray,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    max_points: int = N_LANDMARKS,
    always: Iterable[int] = (),
    never: Iterable[int] = (),
    kernel: str = DEFAULT_KERNEL,
    skin: tuple[FloatArray, FloatArray] | None = None,
) -> GreedySelection:
    """Choose control points among the landmarks of a head for the motion of a take.

    Parameters
    ----------
    landmarks : (66, 3) array
        Rest positions.
    displacements : (N, 66, 3) array
        Of the landmarks in each frame, frame and unit of `landmarks`.
    tolerance : float
        Accepted distance of a landmark that is no control point from where it was, as a fraction of the face's width
        (landmarks 0 to 16).
    max_points : int
        Landmarks at most.
    always, never : iterable of int
        Landmarks (positions in the 66) that the user adds or removes by hand.
    skin : tuple of (V, 3) array and (3, V) array, optional
        The vertices and their region weights, over which an exchange of points is judged; the landmarks by default.

    Raises
    ------
    HeadError
        Where less than one point a region is allowed, or the user removed all of a region.

    Notes
    -----
    1. Start from the muscles' own points. 2. Predict the others from the points chosen so far (`follow`). 3. Add the
    landmark with the largest error over all frames to the region where it errs; repeat until all are within the
    tolerance. Where the points run out before, exchange one for another as long as the skin comes nearer to the one
    that all landmarks would move (`SkinDifference`). 4. Drop points, the least needed first, as long as all stay
    within the tolerance. Ties go to the lower number, so that the same take gives the same points.

    References
    ----------
    Yao et al. 2019, section 4.2, equation (6); Rendall & Allen 2010.
    """
    points = as_points(landmarks, "landmarks", count=N_LANDMARKS, error=HeadError)
    motion = np.asarray(displacements, dtype=np.float64)
    if motion.ndim != 3 or motion.shape[1:] != (N_LANDMARKS, 3) or not len(motion) or not np.isfinite(motion).all():
        raise HeadError(f"displacements must be finite and (N, {N_LANDMARKS}, 3); got {motion.shape}.")
    if max_points < len(REGIONS):
        raise HeadError(f"At least {len(REGIONS)} control points are needed, one a region; got {max_points}.")
    search = _Search(points, motion, kernel, frozenset(always), frozenset(never))
    at_landmarks = points, membership().astype(np.float64)
    difference = SkinDifference(points, search.kernel, search.sigmas, motion, *(skin or at_landmarks))
    search.start(max_points)
    while search.worst() > tolerance and search.grow(max_points):
        pass
    while search.worst() > tolerance and search.exchange(difference):
        pass
    reached = search.worst() <= tolerance
    while reached and search.shrink(tolerance):
        pass
    return GreedySelection(search.members, tuple(search.steps), tolerance, reached, search.covariance)


class _Search:
    """The selection while it grows: `members` (3, 66), and the `error` (3, 66) and `frame` of each landmark's worst."""

    def __init__(
        self, points: FloatArray, motion: FloatArray, kernel: str, always: frozenset[int], never: frozenset[int]
    ) -> None:
        self.kernel = kernel_named(kernel)
        self.motion = np.ascontiguousarray(motion.transpose(1, 0, 2))
        self.width = float(np.linalg.norm(np.subtract(*points[_FACE_SIDES])))
        self.sigmas = region_sigmas(points, self.kernel)
        self.covariance = landmark_covariance(motion)
        own = [region.landmarks for region in REGIONS]
        self.phi = [
            self.kernel.phi(distances(points[each], points[each]), sigma)
            for each, sigma in zip(own, self.sigmas.tolist(), strict=True)
        ]
        self.alike = [self.covariance[np.ix_(each, each)] for each in own]
        self.candidates = membership()
        self.candidates[:, sorted(never)] = False
        self.always = always - never
        if not self.candidates.any(axis=1).all():
            raise HeadError("A region lost all its landmarks. Leave at least one of each region.")
        self.members = np.zeros_like(self.candidates)
        none = self.members.any(axis=0)
        at_rest = [self._errors(row, none) for row in range(len(REGIONS))]
        self.error, self.frame = (np.stack(each) for each in zip(*at_rest, strict=True))
        self.steps: list[GreedyStep] = []

    def start(self, max_points: int) -> None:
        """The user's own points and the muscles', in turn over the regions, so that each has some."""
        queues = []
        for region, muscles in enumerate(START):
            own = [(i, "added by hand") for i in sorted(self.always) if self.candidates[region, i]]
            queue = own + [(int(from_ibug([n])[0]), muscle) for n, muscle in muscles.items()]
            rest = [(int(i), "first of its region") for i in np.flatnonzero(self.candidates[region])]
            allowed = [(i, why) for i, why in queue if self.candidates[region, i]]
            queues.append(allowed or rest[:1])
        for turn in range(max(map(len, queues))):
            for region, queue in enumerate(queues):
                if turn < len(queue) and not self.members[region, queue[turn][0]]:
                    self._change("start", region, *queue[turn], max_points)

    def worst(self) -> float:
        """The largest error, as a fraction of the face's width."""
        return float(self.error.max())

    def grow(self, max_points: int) -> bool:
        """Add the landmark with the largest error; whether one could be added."""
        open_ = self.candidates & ~self.members
        if self.members.any(axis=0).sum() >= max_points:
            open_ &= self.members.any(axis=0)
        if not open_.any():
            return False
        error = np.where(open_, self.error, -1.0)
        region, landmark = np.unravel_index(int(np.argmax(error)), error.shape)
        reason = f"was off by {100 * error.max():.2f} % in frame {self.frame[region, landmark]}"
        return self._change("add", int(region), int(landmark), reason, max_points)

    def exchange(self, difference: SkinDifference) -> bool:
        """Give up a point for the landmark that lessens `difference` most; whether one was."""
        now = difference(self.members)
        used = self.members.any(axis=0)
        free = np.flatnonzero(self.candidates.any(axis=0) & ~used).tolist()
        without = {i: self._replaced(i, i) for i in np.flatnonzero(used).tolist() if i not in self.always}
        losses = {landmark: difference(members) for landmark, members in without.items()}
        for old in sorted(losses, key=lambda landmark: losses[landmark])[:_DROPPED]:
            left = {new: difference(self._replaced(old, new)) for new in free}
            new = min(left, key=lambda landmark: left[landmark], default=old)
            if new != old and left[new] < now * (1.0 - _LEAST_GAIN):
                self._swap(old, new, f"takes the skin {100 * (1.0 - left[new] / now):.0f} % nearer to that of all")
                return True
        return False

    def _replaced(self, old: int, new: int) -> NDArray[np.bool_]:
        """The control points with `new` in all its regions and without `old`; without it alone where both are one."""
        members = self.members.copy()
        members[:, new] = self.candidates[:, new]
        members[:, old] = False
        return members

    def _swap(self, old: int, new: int, reason: str) -> None:
        members = self._replaced(old, new)
        self._drop(old, "exchanged for one that is needed more")
        for region in np.flatnonzero(members[:, new]).tolist():
            self.members[region, new] = True
            self._note("add", region, new, reason)

    def shrink(self, tolerance: float) -> bool:
        """Drop the point whose loss costs least, where all stay within `tolerance`; whether one was dropped."""
        best: tuple[float, int] | None = None
        for landmark in np.flatnonzero(self.members.any(axis=0)).tolist():
            last = self.members[:, landmark] & (self.members.sum(axis=1) == 1)
            if landmark in self.always or last.any():
                continue
            error = self._worst_without(landmark)
            if error <= tolerance and (best is None or error < best[0]):
                best = (error, landmark)
        if best is None:
            return False
        self._drop(best[1], f"superfluous: without it {100 * best[0]:.2f} %")
        return True

    def _drop(self, landmark: int, reason: str) -> None:
        for region in np.flatnonzero(self.members[:, landmark]).tolist():
            self.members[region, landmark] = False
            self._note("drop", region, landmark, reason)

    def _change(self, action: str, region: int, landmark: int, reason: str, max_points: int) -> bool:
        used = self.members.any(axis=0)
        if not used[landmark] and used.sum() >= max_points:
            return False
        self.members[region, landmark] = True
        self._note(action, region, landmark, reason)
        return True

    def _note(self, action: str, region: int, landmark: int, reason: str) -> None:
        known = self.members.any(axis=0)
        for row in np.flatnonzero(self.candidates[:, landmark]).tolist():
            self.error[row], self.frame[row] = self._errors(row, known)
        place = np.unravel_index(int(np.argmax(self.error)), self.error.shape)
        self.steps.append(
            GreedyStep(
                action,
                landmark,
                region,
                reason,
                int(self.members.any(axis=0).sum()),
                float(self.error[place]),
                int(self.frame[place]),
                int(place[1]),
            )
        )

    def _worst_without(self, landmark: int) -> float:
        """The largest error, as a fraction of the face's width, if `landmark` were no control point."""
        known = self.members.any(axis=0)
        known[landmark] = False
        touched = self.candidates[:, landmark]
        again = [float(self._errors(row, known)[0].max()) for row in np.flatnonzero(touched).tolist()]
        return max([*again, float(self.error[~touched].max(initial=0.0))])

    def _errors(self, row: int, known: NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
        """(66,) worst error of each landmark of a region, fraction of the face's width, and its frame.

        `known` (66,) are the control points, of whichever region.
        """
        own = REGIONS[row].landmarks
        chosen = np.flatnonzero(known[own])
        matrix = follow_in_region(self.phi[row], self.alike[row], chosen)
        motion = self.motion[own]
        off = np.tensordot(matrix, motion[chosen], axes=1) - motion
        squared = np.einsum("pnk,pnk->pn", off, off)
        error, frame = np.zeros(N_LANDMARKS), np.zeros(N_LANDMARKS, dtype=np.intp)
        error[own], frame[own] = np.sqrt(squared.max(axis=1)) / self.width, squared.argmax(axis=1)
        return error, frame

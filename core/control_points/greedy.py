"""Greedy selection of control points for a whole take (method.md, section 6.2).

Fewer points let less of the tracker's noise through. The paper considers a single frame. Here the error is that of the
worst frame, so that an expression that occurs once is not forgotten.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..deform.covariance import REGULARISATION, follow_in_region, landmark_covariance
from ..errors import HeadError, Message, messages
from ..face.landmarks import N_LANDMARKS, from_ibug
from ..heads.regions import DEFAULT_KERNEL, REGIONS, membership, region_sigmas
from ..mesh.kernels import distances, get_kernel
from ..numeric.arrays import FloatArray, IntArray, as_points
from .difference import SkinDifference
from .selection import GreedySelection, GreedyStep, Search, SelectionSettings

_FACE_SIDES = from_ibug((0, 16))
_EXCHANGE_CANDIDATES = 8
"""Number of the least needed points, which exchanges try to give up. With exchanges, half the points raised the error
by 12 instead of 17 % on ICT-FaceKit."""
_MIN_GAIN = 1e-4
"""Smallest share of the difference by which an exchange has to lower it."""

KERNEL_OF: Mapping[Search, str] = {"take": DEFAULT_KERNEL, "paper": "gaussian"}
"""Default kernel of each search."""

START: tuple[Mapping[int, str], ...] = (
    messages(
        {
            **{36: "orbicularis oculi, outer corner", 45: "orbicularis oculi, outer corner"},
            **{39: "orbicularis oculi, inner corner", 42: "orbicularis oculi, inner corner"},
            **{38: "upper orbicularis oculi", 43: "upper orbicularis oculi"},
            **{21: "corrugator and procerus", 22: "corrugator and procerus"},
            **{19: "frontalis, middle", 24: "frontalis, middle", 17: "frontalis, outer", 26: "frontalis, outer"},
        }
    ),
    messages(
        {
            **{48: "zygomaticus", 54: "zygomaticus", 51: "upper orbicularis oris"},
            **{41: "lower orbicularis oculi", 46: "lower orbicularis oculi"},
            **{31: "nasalis and levator labii", 35: "nasalis and levator labii"},
            **{36: "orbicularis oculi, outer corner", 45: "orbicularis oculi, outer corner"},
            **{39: "orbicularis oculi, inner corner", 42: "orbicularis oculi, inner corner"},
            **{2: "origin of the zygomaticus", 14: "origin of the zygomaticus"},
        }
    ),
    messages(
        {
            **{48: "depressor anguli oris", 54: "depressor anguli oris", 57: "lower orbicularis oris", 8: "mentalis"},
            **{66: "depressor labii", 5: "platysma", 11: "platysma"},
        }
    ),
)
"""For each region, the initial landmarks by iBUG number and the muscle that each stands for, the most important
first."""
WAS_OFF = "was off by {error} % in frame {frame}"
"""Template of the reason for a landmark that was added for its error."""


def greedy_select(
    landmarks: FloatArray,
    displacements: FloatArray,
    *,
    tolerance: float = SelectionSettings.tolerance,
    max_points: int = N_LANDMARKS,
    always: Iterable[int] = (),
    never: Iterable[int] = (),
    search: Search = SelectionSettings.search,
    kernel: str | None = None,
    skin: tuple[FloatArray, FloatArray] | None = None,
) -> GreedySelection:
    """Select control points among the landmarks of a head for the motion in a take.

    Parameters
    ----------
    landmarks : (66, 3) array
        Rest positions.
    displacements : (N, 66, 3) array
        Displacements of the landmarks in each frame, in the frame and unit of `landmarks`.
    tolerance : float
        Error allowed at landmarks that are not control points, as a fraction of the face's width (landmarks 0 to
        16).
    always, never : iterable of int
        Landmarks (positions in the 66) that the user requires or excludes.
    search : {"take", "paper"}
        As in `SelectionSettings`.
    kernel : str, optional
        Key in `KERNELS`; by default that of the search.
    skin : tuple of (V, 3) array and (3, V) array, optional
        Vertices and their region weights, on which exchanges are judged; by default the landmarks.

    Raises
    ------
    HeadError
        If fewer than one point per region is allowed, or a region has no landmark left.

    Notes
    -----
    The steps are those of method.md, section 6.2, after Yao et al. 2019, section 4.2, and Rendall & Allen 2010.
    The paper's search consists of the first three, without covariance and ridge. Ties go to the lower number, so that
    the same take always gives the same points.
    """
    points = as_points(landmarks, "landmarks", count=N_LANDMARKS, error=HeadError)
    motion = np.asarray(displacements, dtype=np.float64)
    if motion.ndim != 3 or motion.shape[1:] != (N_LANDMARKS, 3) or not len(motion) or not np.isfinite(motion).all():
        raise HeadError(
            "displacements must be finite and of shape (N, {n_landmarks}, 3); got {shape}.",
            n_landmarks=N_LANDMARKS,
            shape=motion.shape,
        )
    if max_points < len(REGIONS):
        raise HeadError(
            "At least {regions} control points are needed, one per region; got {max_points}.",
            regions=len(REGIONS),
            max_points=max_points,
        )
    plain = search == "paper"
    state = _State(points, motion, kernel or KERNEL_OF[search], frozenset(always), frozenset(never), plain=plain)
    # 1. Points of the muscles, and those that the user requires.
    state.start(max_points)
    # 2. and 3. Add the landmark with the largest predicted error, until all are within the tolerance.
    while state.worst() > tolerance and state.grow(max_points):
        pass
    if not plain:
        at_landmarks = points, membership().astype(np.float64)
        difference = SkinDifference(points, state.kernel, state.sigmas, motion, *(skin or at_landmarks))
        # 4. If the allowed number of points is used up, exchange points.
        while state.worst() > tolerance and state.exchange(difference):
            pass
        # 5. If the tolerance was reached, drop points that are not needed.
        while state.worst() <= tolerance and state.shrink(tolerance):
            pass
    reached = state.worst() <= tolerance
    return GreedySelection(state.members, tuple(state.steps), tolerance, reached, state.covariance)


class _State:
    """The selection during the search.

    Attributes
    ----------
    members : (3, 66) bool
        Whether each landmark is a control point of each region.
    error : (3, 66) float64
        Worst error of each landmark.
    frame : (3, 66) int
        Frame of that error.
    """

    def __init__(
        self,
        points: FloatArray,
        motion: FloatArray,
        kernel: str,
        always: frozenset[int],
        never: frozenset[int],
        *,
        plain: bool,
    ) -> None:
        self.kernel = get_kernel(kernel)
        self.motion = np.ascontiguousarray(motion.transpose(1, 0, 2))
        self.width = float(np.linalg.norm(np.subtract(*points[_FACE_SIDES])))
        self.sigmas = region_sigmas(points, self.kernel)
        self.covariance = None if plain else landmark_covariance(motion)
        self.regularisation = 0.0 if plain else REGULARISATION
        own = [region.landmarks for region in REGIONS]
        self.phi = [
            self.kernel.phi(distances(points[each], points[each]), sigma)
            for each, sigma in zip(own, self.sigmas.tolist(), strict=True)
        ]
        self.covariances = [None if self.covariance is None else self.covariance[np.ix_(each, each)] for each in own]
        self.candidates = membership()
        self.candidates[:, sorted(never)] = False
        self.always = always - never
        if not self.candidates.any(axis=1).all():
            raise HeadError("A region has no landmarks left. Keep at least one per region.")
        self.members = np.zeros_like(self.candidates)
        none = self.members.any(axis=0)
        at_rest = [self._errors(row, none) for row in range(len(REGIONS))]
        self.error, self.frame = (np.stack(each) for each in zip(*at_rest, strict=True))
        self.steps: list[GreedyStep] = []

    def start(self, max_points: int) -> None:
        """Take the user's points and those of the muscles, alternating between regions, so that each gets some."""
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
        """Return the largest error of any landmark, as a fraction of the face's width."""
        return float(self.error.max())

    def grow(self, max_points: int) -> bool:
        """Add the landmark with the largest error; return whether one was added."""
        open_ = self.candidates & ~self.members
        # When all points are used, only the other regions of these points are open.
        if self.members.any(axis=0).sum() >= max_points:
            open_ &= self.members.any(axis=0)
        if not open_.any():
            return False
        error = np.where(open_, self.error, -1.0)
        region, landmark = np.unravel_index(int(np.argmax(error)), error.shape)
        reason = Message(WAS_OFF, error=f"{100 * error.max():.2f}", frame=self.frame[region, landmark])
        return self._change("add", int(region), int(landmark), reason, max_points)

    def exchange(self, difference: SkinDifference) -> bool:
        """Exchange a point for the landmark that lowers `difference` most; return whether one was exchanged."""
        now = difference(self.members)
        used = self.members.any(axis=0)
        free = np.flatnonzero(self.candidates.any(axis=0) & ~used).tolist()
        # The need for each point: the difference without it.
        without = {i: self._replaced(i, i) for i in np.flatnonzero(used).tolist() if i not in self.always}
        losses = {landmark: difference(members) for landmark, members in without.items()}
        for old in sorted(losses, key=lambda landmark: losses[landmark])[:_EXCHANGE_CANDIDATES]:
            left = {new: difference(self._replaced(old, new)) for new in free}
            new = min(left, key=lambda landmark: left[landmark], default=old)
            if new != old and left[new] < now * (1.0 - _MIN_GAIN):
                self._swap(old, new, f"lowers the skin error by {100 * (1.0 - left[new] / now):.0f} %")
                return True
        return False

    def _replaced(self, old: int, new: int) -> NDArray[np.bool_]:
        """Return the control points without `old`, and with `new` in all its regions unless the two are equal."""
        members = self.members.copy()
        members[:, new] = self.candidates[:, new]
        members[:, old] = False
        return members

    def _swap(self, old: int, new: int, reason: str) -> None:
        members = self._replaced(old, new)
        self._drop(old, "exchanged for a more useful one")
        for region in np.flatnonzero(members[:, new]).tolist():
            self.members[region, new] = True
            self._note("add", region, new, reason)

    def shrink(self, tolerance: float) -> bool:
        """Drop the least needed point if all errors stay within `tolerance`; return whether one was dropped."""
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
        self._drop(best[1], f"not needed: {100 * best[0]:.2f} % without it")
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
        # Only the regions of this landmark are affected.
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
        """Return the largest error, as a fraction of the face's width, if `landmark` were not a control point."""
        known = self.members.any(axis=0)
        known[landmark] = False
        touched = self.candidates[:, landmark]
        again = [float(self._errors(row, known)[0].max()) for row in np.flatnonzero(touched).tolist()]
        return max([*again, float(self.error[~touched].max(initial=0.0))])

    def _errors(self, row: int, known: NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
        """Compute the worst error of each landmark of a region, as a fraction of the face's width, and its frame,
        (66,).

        `known` (66,) marks the control points of any region.
        """
        own = REGIONS[row].landmarks
        chosen = np.flatnonzero(known[own])
        matrix = follow_in_region(self.phi[row], self.covariances[row], chosen, self.regularisation)
        motion = self.motion[own]
        off = np.tensordot(matrix, motion[chosen], axes=1) - motion
        squared = np.einsum("pnk,pnk->pn", off, off)
        error, frame = np.zeros(N_LANDMARKS), np.zeros(N_LANDMARKS, dtype=np.intp)
        error[own], frame[own] = np.sqrt(squared.max(axis=1)) / self.width, squared.argmax(axis=1)
        return error, frame

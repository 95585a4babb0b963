"""Detection of all faces in an image (method.md, section 3.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TypeAlias, TypeVar

import numpy as np

from ..numeric.arrays import FloatArray
from .cascade_detector import EFFORTS, CascadeDetector, Effort, Step
from .fitter import COARSE, REFINED, FaceFitter, Fit
from .grey import Grey, whole
from .linear_fitter import LinearFitter
from .model_file import TrackerModel
from .network import SIDES, NetworkDetector
from .pdm import FittedShape

_MAX_BOXES = 60
"""Largest number of starts per effort that are fitted coarsely."""
_MAX_FACES = 4
"""Largest number of starts per effort that are then fitted to the end."""
_MAX_GRADUAL = 6
"""Largest number of starts per step of a gradual search that are fitted coarsely."""
_MAX_DETECTIONS = 8
"""Largest number of the network's detections that are fitted coarsely."""
_MIN_COARSE = 1e-3
"""Confidence of the coarse fit to such a detection above which it is fitted to the end. Most false detections are below
it, and hardly any true ones."""
_LIKELY_COARSE = 4e-3
"""Confidence of the coarse fit below which a detection counts as unlikely, as does one with odds below even. Of 47
false detections 43 had odds below even, of 96 faces with eyes at least 25 pixels apart none."""
_MAX_UNLIKELY = (2, 1)
"""How many unlikely detections a frame of a gradual search fits coarsely, in turn, and how many to the end."""
CERTAIN = 0.85
"""Confidence of a detected face above which no further effort is made."""
_SEPARATION = 0.6
"""Distance between the centres of two fits, in eye distances, above which they belong to two people."""


@dataclass(frozen=True)
class NetworkPass:
    """A pass of the network: `sides` and `turns` as for `NetworkDetector.detect`."""

    sides: tuple[int, ...]
    turns: int = 0


SearchStep: TypeAlias = "Step | NetworkPass"
_FIRST_PASS = NetworkPass(SIDES[:3])
_SMALL_FACES = NetworkPass(SIDES[3:])
"""The pass for small faces."""
_FURTHER_PASSES = (_SMALL_FACES, *(NetworkPass(SIDES[:3], turns) for turns in (1, 3, 2)))
"""Further passes of the network: for small faces, and for those that lie on their side or hang upside down. Much else
looks like these, so they have to be certain."""
_ALL = tuple(Step.whole(effort) for effort in EFFORTS)
_FIRST = (_FIRST_PASS, _ALL[0])
_QUICK = _ALL[:2]
"""The efforts that search for other people in view, without the network."""
_EVERY_FRAME = _ALL[:3]
"""The efforts that are made in every frame without a face, in addition to one of the others in turn, without the
network."""
_IN_TURN = tuple(
    step
    for i, part in enumerate(part for effort in EFFORTS[len(_EVERY_FRAME) :] for part in Step.parts(effort))
    for step in ([Step.whole(Effort.SMALL), part] if i % 3 == 0 else [part])
)
"""The steps of which a gradual search makes one per frame, besides those for near faces and for close-ups. Small faces,
which are common, come often."""
_MOMENT = 3
"""Number of frames after a loss in which a face is likely to be seen again, and only the first pass is made."""
_T = TypeVar("_T")
STAGES = ("detect", "experts", "fit", "check", "teeth", "gaze", "actions")


@dataclass(frozen=True)
class Candidate:
    """A fit, and the confidence, 0 to 1, that it is a face."""

    fit: Fit
    confidence: float

    @property
    def pose(self) -> FloatArray:
        """Pose in the image frame, (6,)."""
        return self.fit.fitted.pose

    def distance(self, x: float, y: float) -> float:
        """Return the distance from a point to the middle of the face, in pixels."""
        return float(np.hypot(self.pose[4] - x, self.pose[5] - y))


class FaceSearch:
    """Finds faces in a grey image, from scratch or near a face of the previous frame.

    A `gradual` search is spread over many frames, so that none takes long. The `network` searches before any cascade;
    None leaves the search to the cascades alone, as in the paper. `timings` are the seconds spent in each of `STAGES`
    since `begin`.
    """

    found_above = 0.5
    """Confidence above which a detected face is accepted."""

    def __init__(self, model: TrackerModel) -> None:
        self.gradual = False
        self.network: NetworkDetector | None = model.detector
        self._model = model
        self._cascades = CascadeDetector()
        self._images = 0
        self.timings: dict[str, float] = dict.fromkeys(STAGES, 0.0)
        if model.linear is None:
            self.fitter = FaceFitter(model, self.timings)
        else:
            self.fitter = LinearFitter(model, model.linear, self.timings)

    def begin(self) -> None:
        """Reset the timings for the next image."""
        self._images += 1
        self.timings.update(dict.fromkeys(STAGES, 0.0))

    def follow(self, grey: Grey, last: FittedShape) -> Candidate:
        """Fit the face near its position in the previous frame, and judge the fit, however low its confidence."""
        return self._judge(self.fitter.follow(grey, last))

    def steps(self, misses: int) -> tuple[SearchStep, ...]:
        """Return the steps after `misses` frames without a face: all at first, unless the search is gradual; later a
        short one per frame.

        The network makes its first pass in every other frame. The other frames alternate between its further passes and
        the cascades, except for a moment after a search of all steps, when only a face that moved fast is likely.
        """
        if self.network is None:
            return self._steps_of_cascades(misses)
        if not self.gradual and misses <= _MOMENT:
            return (_FIRST_PASS,) if misses else self._all
        turn, part = divmod(misses, 4)
        return ((_FIRST_PASS, _in_turn(turn, _FURTHER_PASSES), _FIRST_PASS, _in_turn(turn, _IN_TURN))[part],)

    def _steps_of_cascades(self, misses: int) -> tuple[Step, ...]:
        if self.gradual:
            near, _, filling = _EVERY_FRAME
            return near, _in_turn(misses, _IN_TURN), filling
        return _ALL if misses == 0 else (*_EVERY_FRAME, _in_turn(misses, _ALL[len(_EVERY_FRAME) :]))

    @property
    def _all(self) -> tuple[SearchStep, ...]:
        return _ALL if self.network is None else (_FIRST_PASS, *_FURTHER_PASSES, *_ALL)

    def detect(
        self,
        grey: Grey,
        steps: Sequence[SearchStep] | None = None,
        *,
        small: bool = False,
        brief: bool = False,
    ) -> list[Candidate]:
        """Detect faces by steps, by default all, in order, until one finds a certain face.

        `small` searches for small faces even if the first step finds a certain one, because a particular face is
        awaited, which may be small. `brief` fits few starts, as a gradual search does, because there was no face in the
        previous frame.
        """
        return list(self._detected(grey, self._all if steps is None else steps, small, brief or self.gradual))

    def others(self, grey: Grey, poses: Sequence[FloatArray], *, small: bool = False) -> list[Candidate]:
        """Find faces other than those at `poses` (6,) in the image frame. Only boxes away from them are fitted.

        `small` searches for small faces, too, which takes longer.
        """

        def apart(other: FloatArray) -> bool:
            return all(float(np.hypot(*(other[4:6] - pose[4:6]))) > _SEPARATION * float(pose[0]) for pose in poses)

        steps: tuple[SearchStep, ...] = (_FIRST_PASS if small else NetworkPass(SIDES[:2]),)
        if self.network is None:
            steps = _QUICK if small else _QUICK[:1]
        starts = [[start for start in self._starts(grey, step, self.gradual) if apart(start)] for step in steps]
        return [
            c
            for step, chosen in zip(steps, starts, strict=True)
            for c in self._faces_in(grey, chosen, step, self.gradual)
            if apart(c.pose)
        ]

    def _detected(self, grey: Grey, steps: Sequence[SearchStep], small: bool, brief: bool) -> Iterator[Candidate]:
        for step in steps:
            found = self._faces_in(grey, self._starts(grey, step, brief), step, brief)
            yield from found
            certain = any(c.confidence >= CERTAIN for c in found)
            if certain and not (step in _FIRST and small):
                return

    def _starts(self, grey: Grey, step: SearchStep, brief: bool) -> list[FloatArray]:
        """Return the poses (6,) of the network's detections, or frontal poses for the boxes of the cascades."""
        began = perf_counter()
        starts = self._boxes(grey, step, brief) if isinstance(step, Step) else self._detections(grey, step, brief)
        self.timings["detect"] += perf_counter() - began
        return starts

    def _boxes(self, grey: Grey, step: Step, brief: bool) -> list[FloatArray]:
        boxes = self._cascades.boxes(whole(grey), step)[: _MAX_GRADUAL if brief else _MAX_BOXES]
        return [box.start_pose(self._model.box_offset) for box in boxes]

    def _detections(self, grey: Grey, network_pass: NetworkPass, brief: bool) -> list[FloatArray]:
        """Return poses (6,) of the network's detections, ordered by size times likelihood."""
        assert self.network is not None
        found = self.network.detect(whole(grey), network_pass.sides, network_pass.turns)
        if brief:
            unlikely = [face for face in found if face.odds < 0.0]
            chosen = {(self._images + i) % len(unlikely) for i in range(_MAX_UNLIKELY[0])} if unlikely else set()
            found = [face for face in found if face.odds >= 0.0] + [unlikely[i] for i in sorted(chosen)]
        found.sort(key=lambda f: -f.pose[0] / (1.0 + np.exp(-f.odds)))
        return [face.pose for face in found[:_MAX_DETECTIONS]]

    def _faces_in(self, grey: Grey, poses: Sequence[FloatArray], step: SearchStep, brief: bool) -> list[Candidate]:
        """Return the accepted faces near the poses (6,) from a step."""
        neutral = np.zeros(self._model.pdm.n_modes)
        coarse = [self.fitter.fit(grey, FittedShape(pose, neutral), (COARSE,)) for pose in poses]
        promising = self._promising(coarse, by_network=not isinstance(step, Step), brief=brief)
        tried = [self._judge(self.fitter.fit(grey, fit.fitted, REFINED)) for fit in promising]
        least = CERTAIN if step in _FURTHER_PASSES else self.found_above
        return [c for c in tried if c.confidence >= least]

    def _promising(self, coarse: list[Fit], *, by_network: bool, brief: bool) -> list[Fit]:
        """Select the coarse fits that are fitted to the end, the likeliest first."""
        coarse = sorted(coarse, key=lambda f: -f.features[1])  # the log odds of the face network
        if by_network:
            judged = [(fit, self._model.check.confidence(fit.features)) for fit in coarse]
            coarse = [fit for fit, confidence in judged if confidence >= _MIN_COARSE]
            if brief:
                likely = [fit for fit, confidence in judged if confidence >= _LIKELY_COARSE]
                others = [fit for fit, confidence in judged if _MIN_COARSE <= confidence < _LIKELY_COARSE]
                coarse = likely + others[: _MAX_UNLIKELY[1]]
        return coarse[:_MAX_FACES]

    def _judge(self, fit: Fit) -> Candidate:
        return Candidate(fit, self._model.check.confidence(fit.features))


def _in_turn(frame: int, items: Sequence[_T]) -> _T:
    return items[frame % len(items)]


def largest(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the largest face, where half the confidence counts like half the size.

    Thus somebody who turns away in front comes before somebody behind. Among fits that count about the same, which may
    be of one face, the most confident one is returned.
    """
    if not candidates:
        return None
    counts = [c.pose[0] * c.confidence for c in candidates]
    near = [c for c, count in zip(candidates, counts, strict=True) if count > 0.8 * max(counts)]
    return max(near, key=lambda c: c.confidence)

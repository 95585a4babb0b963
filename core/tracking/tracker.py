"""The face tracker: it finds a face, follows it, and notices when it is somebody else's (method.md, section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..files.assets import ASSETS
from ..files.setting import Choice, setting
from ..numeric.arrays import FloatArray, as_image
from .cuts import LostScene
from .fitter import FaceFitter
from .grey import Grey, GreyImage
from .identity import FaceChoice, PerformerIdentity, are_same, describe_face
from .linear_fitter import load_any_model
from .model_file import TrackerModel
from .patch_experts import ActionExperts
from .pdm import FittedShape, PointDistributionModel
from .reading import FaceReader
from .result import HiddenMouth, TrackResult
from .rivals import Rivals
from .search import CERTAIN, Candidate, FaceSearch, largest

DEFAULT_MODEL = ASSETS / "tracker" / "face.tracker"

_IDENTITY_INTERVAL = 3
"""Frames from one check of the tracked person's identity to the next."""
_NEAR = 1.5
"""Distance in eye distances from where a face was first seen within which it may be found a second later."""
NETWORK, CASCADES = "network", "cascades"


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of the tracker.

    Attributes
    ----------
    detector : {"network", "cascades"}
        Detector for the first frame and after a loss; "cascades" is the paper's Viola-Jones detector.
    tracker_model : str
        File of a model of FaceTracker, whose linear experts the paper uses; "" is the shipped model.
    """

    detector: str = setting(
        NETWORK,
        "Face Detector",
        "How faces are found on the first frame and after tracking was lost",
        choices=(
            Choice(NETWORK, "Neural Network", "Find faces from any angle, with Viola-Jones for those that are missed"),
            Choice(CASCADES, "Viola-Jones", "Find faces with cascades alone, as in the paper"),
        ),
    )
    tracker_model: str = setting(
        "",
        "Tracker Model",
        "File of a model of FaceTracker, which the paper uses, from the next start on; empty for Facemime's own",
        unit="file",
    )


DEFAULTS = TrackingSettings()


class FaceTracker:
    """Finds one face and follows it, by a constrained local model.

    `track` continues from the previous frame; `locate` treats an image on its own.

    If several faces are in view, the largest is tracked, or the one chosen by `choose`. If the largest is a picture,
    which does not move, and another face moves, that one is tracked after a second. A lost face is sought near its last
    position before another one is taken. Other people may pass, even in front of the tracked face: tracking is then
    lost until the face is seen again, for at most 75 frames.

    Parameters
    ----------
    model : TrackerModel
        The tracker model.
    gradual : bool
        Whether to spread work over frames so that none takes long, as is needed live: the search for a face over up to
        40 frames, and the actions of eyes and mouth over two. By default the first frame without a face is searched
        completely, and all actions are measured in every frame.
    settings : TrackingSettings, optional
        How faces are found; may be replaced between frames, except for the model.

    Examples
    --------
    >>> import cv2
    >>> from facemime import FaceTracker
    >>> tracker = FaceTracker.load()
    >>> result = tracker.track(cv2.imread("portrait.png"))
    >>> result.found, result.landmarks.shape
    (True, (66, 2))
    """

    lost_below = 0.3
    """Confidence below which a tracked face is lost. It is lower than for a new face, as a hand may cover the face."""

    def __init__(self, model: TrackerModel, *, gradual: bool = False, settings: TrackingSettings = DEFAULTS) -> None:
        self._model = model
        self.search = FaceSearch(model)
        self.search.gradual = gradual
        self._reader = FaceReader(model, self.search.fitter, self.search.timings)
        self.settings = settings
        self._identity = PerformerIdentity()
        self._choice = FaceChoice()
        self._last: FittedShape | None = None
        self._switch_requested = False
        self._rivals: Rivals | None = None
        self._actions: FloatArray | None = None
        self._mouth = HiddenMouth()
        self._colour: NDArray[np.uint8] | None = None
        self._pixels = np.empty((0, 0), np.uint8)
        self._scene = LostScene()

    @classmethod
    def load(
        cls, path: Path | None = None, *, gradual: bool = False, settings: TrackingSettings = DEFAULTS
    ) -> FaceTracker:
        """Load a tracker model.

        Parameters
        ----------
        path : Path, optional
            The model file, or the file of a model of FaceTracker; by default that of the settings, or the shipped one.
        gradual : bool
            As for the class.
        settings : TrackingSettings
            As for the class.

        Raises
        ------
        ModelError
            If the file is missing or invalid.
        """
        chosen = Path(path or settings.tracker_model or DEFAULT_MODEL)
        return cls(load_any_model(chosen, DEFAULT_MODEL), gradual=gradual, settings=settings)

    @property
    def pdm(self) -> PointDistributionModel:
        """The shape model."""
        return self._model.pdm

    @property
    def model_id(self) -> str:
        """First digits of the model file's checksum."""
        return self._model.model_id

    @property
    def fitter(self) -> FaceFitter:
        """The fitter of the shape model."""
        return self.search.fitter

    @property
    def settings(self) -> TrackingSettings:
        """Settings of face detection."""
        return self._settings

    @settings.setter
    def settings(self, settings: TrackingSettings) -> None:
        self._settings = settings
        self.search.network = self._model.detector if settings.detector == NETWORK else None

    @property
    def timings(self) -> dict[str, float]:
        """Seconds spent in each stage of the last call, as listed in `search.STAGES`."""
        return self.search.timings

    @contextmanager
    def in_two_threads(self) -> Iterator[None]:
        """Run half of the networks of `track` in a second thread, which ends with the context.

        If a core is free, a frame takes a fifth less time; several trackers that share the cores gain nothing.
        """
        with ThreadPoolExecutor(1, "facemime-networks") as thread:
            self.fitter.second_thread = thread
            try:
                yield
            finally:
                self.fitter.second_thread = None

    def reset(self) -> None:
        """Forget the tracked face and any choice, so that the next `track` detects a face."""
        self._last, self._actions, self._switch_requested = None, None, False
        self._rivals = None
        self._choice = FaceChoice()
        self._identity.reset()
        self._mouth.reset()
        self._scene = LostScene()

    def choose(self, x: float, y: float) -> None:
        """Track the face nearest to a point, starting with the next `track`.

        Parameters
        ----------
        x, y : float
            Position in pixels.
        """
        self.reset()
        self._choice.request(x, y)

    def choose_next(self) -> None:
        """At the next `track`, switch to the next face on the right, or the leftmost; keep the only one."""
        self._switch_requested = True

    def track(self, image: ArrayLike) -> TrackResult:
        """Track the face in the next frame of a video.

        Follows the face of the previous call, and detects one if no face was tracked or the face was lost.

        Parameters
        ----------
        image : array_like
            The frame, as for `as_image`: grey, BGR or BGRA.

        Returns
        -------
        TrackResult
            The face, or that there is none.
        """
        grey = self.begin(image)
        self._identity.frame += 1
        # 1. Switch to another face if that was requested and one is in view.
        if self._switch_requested and (another := self._next_face(grey)) is not None:
            return self._switch(grey, another)
        # 2. Fit from the face of the previous frame; accept a face (3.6) of the same person (3.7).
        if self._last is not None:
            followed = self.search.follow(grey, self._last)
            if followed.confidence >= self.lost_below and self._is_same(grey, followed):
                if self._rivals is not None and (another := self._performing(grey, self._rivals, followed)) is not None:
                    return self._switch(grey, another)
                return self._accept(grey, followed)
            self._choice.lose(self._last)
        # 3. Detect all faces in view (3.2), and choose the performer's (3.7).
        steps = self.search.steps(self._choice.misses)
        brief = self._choice.misses > 0
        found = self.search.detect(grey, steps, small=self._choice.waiting, brief=brief)
        another_scene = self._choice.waiting and self._scene.is_another(self._pixels)
        if another_scene and found and not self._was_there(grey, found):
            self._choice.end_wait()
        chosen = self._choice.pick(grey, found, self._identity)
        if chosen is None:
            self._last = self._actions = None
            self._mouth.reset()
            self._choice.misses += 1
            return TrackResult.nothing(self.pdm.n_modes)
        self._rivals = Rivals(grey, chosen.pose, _certain(found)) if self._choice.anybody else None
        return self._accept(grey, chosen)

    def performer(self, images: Iterable[ArrayLike]) -> tuple[float, float] | None:
        """Return the place, in the first image of a video, of a face that moves while the largest one is a picture.

        Returns None if the largest one moves, or no other does. Does not affect `track`.
        """
        rivals: Rivals | None = None
        for image in images:
            grey = self.begin(image)
            if rivals is None:
                found = self.search.detect(grey)
                if (chosen := largest(found)) is None:
                    return None
                rivals = Rivals(grey, chosen.pose, _certain(found))
            rivals.watch(grey)
            if rivals.alone or rivals.settled:
                return None
        pose = None if rivals is None else rivals.performing()
        return None if pose is None else (float(pose[4]), float(pose[5]))

    def locate(self, image: ArrayLike) -> TrackResult:
        """Find the largest face in a single image, without effect on `track`."""
        grey = self.begin(image)
        found = largest(self.search.detect(grey, small=self._choice.waiting))
        return TrackResult.nothing(self.pdm.n_modes) if found is None else self.read(grey, found)

    def begin(self, image: ArrayLike) -> Grey:
        """Begin with an image, and return it in grey."""
        self.search.begin()
        self._pixels = pixels = as_image(image)
        self._colour = None if pixels.ndim == 2 else pixels
        return pixels if pixels.ndim == 2 else GreyImage(pixels)

    def _is_same(self, grey: Grey, followed: Candidate) -> bool:
        """Whether the tracked face is still the same person's, rather than that of somebody who stepped in front."""
        identity = self._identity
        if identity.frame % _IDENTITY_INTERVAL:
            return True
        descriptor = describe_face(grey, followed.pose)
        if identity.recognises(descriptor):
            return True
        if identity.is_bystander(descriptor):
            identity.update_bystander(descriptor, followed.pose)
            return False
        # The face is unfamiliar. Others in view are not the performer: remember them for later comparison. If there is
        # nobody else, the change is a hand, a shadow or the light.
        if identity.crowded or identity.search_due:
            for other in self.search.others(grey, [followed.pose]):
                identity.update_bystander(describe_face(grey, other.pose), other.pose)
        identity.adapt(descriptor)
        return True

    def _was_there(self, grey: Grey, found: Sequence[Candidate]) -> bool:
        """Whether one of the faces in view was in the same place when the tracked one was lost."""
        if (last := self._scene.last) is None:
            return False
        before = last if last.ndim == 2 else GreyImage(last)
        return any(are_same(describe_face(before, c.pose), describe_face(grey, c.pose)) for c in found)

    def _performing(self, grey: Grey, rivals: Rivals, followed: Candidate) -> Candidate | None:
        """Return the largest other face that moves if the tracked one is a picture; otherwise None."""
        rivals.watch(grey)
        if rivals.settled:
            self._rivals = None
        if rivals.settled or not rivals.due:
            return None
        found = self.search.others(grey, [followed.pose], small=True)
        if (pose := rivals.performing()) is not None:
            return largest([c for c in found if c.distance(pose[4], pose[5]) < _NEAR * float(pose[0])])
        rivals.add(grey, _certain(found))
        return None

    def _switch(self, grey: Grey, another: Candidate) -> TrackResult:
        """Track the face of somebody else."""
        self._identity.reset()
        self._mouth.reset()
        self._rivals, self._choice = None, FaceChoice()
        return self._accept(grey, another)

    def _next_face(self, grey: Grey) -> Candidate | None:
        """Return the next face to the right of the tracked one, or else the leftmost; None if there is no other."""
        self._switch_requested = False
        if self._last is None:
            return None
        here = self._last.pose
        found = self.search.others(grey, [here], small=True)
        return min([c for c in found if c.pose[4] > here[4]] or found, key=lambda c: float(c.pose[4]), default=None)

    def _accept(self, grey: Grey, candidate: Candidate) -> TrackResult:
        self._choice.settle(certain=candidate.confidence >= CERTAIN)
        self._scene.keep(self._pixels)
        # A gradual tracker measures all actions in the first frame, and then those of one part per frame.
        parts, before = self._model.actions, self._actions
        if self.search.gradual and before is not None:
            turn = self._identity.frame % len(parts)
            parts = parts[turn : turn + 1]
        result = self.read(grey, candidate, self._mouth, parts, before)
        self._last = FittedShape(result.pose, result.shape_params)
        self._actions = result.actions
        return result

    def read(
        self,
        grey: Grey,
        candidate: Candidate,
        mouth: HiddenMouth | None = None,
        parts: Sequence[ActionExperts] | None = None,
        before: FloatArray | None = None,
    ) -> TrackResult:
        """Return the result for a face, with the actions of `parts`; those of other parts are taken from `before`."""
        return self._reader.read(grey, self._colour, candidate, mouth, parts, before)


def _certain(found: Sequence[Candidate]) -> list[FloatArray]:
    """Poses (6,) of those that are certainly faces, the surest first."""
    return [c.pose for c in sorted(found, key=lambda c: -c.confidence) if c.confidence >= CERTAIN]

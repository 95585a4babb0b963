"""From a tracking result to a frame of a head: vertices, pose, jaw and gaze, live and offline; motion over a take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..deform.head_deformer import INFORMED, head_deformer
from ..deform.rbf import IncrementalDeformer, RBFDeformer
from ..errors import SourceError
from ..face.landmarks import outer_eye_distance
from ..face.rotation import euler_to_matrix, limit_rotation, limit_vector
from ..files.large_arrays import large_array
from ..heads.bite import bite_of
from ..heads.eyeballs import EyeballContact
from ..heads.regions import sharp_regions
from ..heads.rig import HeadRig
from ..numeric.arrays import FloatArray
from ..takes.neutral import MIRROR_WIDTH, Neutral
from ..takes.take import Take
from ..tracking.result import CAMERA_DISTANCE, TrackResult, mirror_result
from .actions import TONGUE, ActionDriver, action_modes
from .drive_settings import DriveSettings
from .parts import PartDriver
from .posing import EyeDriver, Jaw
from .retarget import retargeter_for
from .teaching import Expressions, TaughtControls, TaughtVertices, edited_vertices

_BY_DEFAULT = DriveSettings()
_RIGID = ("rotation", "translation", "jaw", "gaze")
"""What a motion has of `_Pose`."""


@dataclass(frozen=True)
class HeadFrame:
    """A frame of a driven head.

    Attributes
    ----------
    vertices : (A, 3) float32
        Positions as in `HeadRig.all_vertices`: head frame, unit of the mesh, without the pose of the head.
    rotation : (3, 3) float64
        Rotation of the head from neutral.
    translation : (3,) float64
        Translation of the head from neutral, in the unit of the mesh.
    jaw : (3, 3) float64
        Rotation of lower teeth and tongue about the pivot of the jaw.
    gaze : (2, 3, 3) float64
        Rotations of the right and left eyeball about their centres, relative to the head.
    actions : (15,) float64
        Activations of `actions.ACTIONS`; `vertices` include all but that of a tongue that is an object.
    displacements : (66, 3) float64
        Displacements of the landmarks, which move the skin: head frame, unit of the mesh.
    keys : (K,) float64
        Values of shape keys that move the vertices instead, in the order of `LiveKeys.offsets`; empty without keys.
    taught : (k,) float64
        Weights of the examples of `HeadRig.style` that count, by which the vertices are corrected.
    controls : mapping of str to float
        Changes of the controls of a rig, by `RigChannel.key`, that the examples of `HeadRig.style` teach.

    Examples
    --------
    >>> from facemime import HeadDriver, HeadFrame, built_in_head, calibrate, load_take
    >>> take = load_take("performance.facetake")
    >>> frame: HeadFrame = HeadDriver(built_in_head(), calibrate(take)).frame(take.result(0))
    >>> posed = frame.vertices @ frame.rotation.T + frame.translation  # in world axes, about the neck
    >>> posed.shape
    (1781, 3)
    """

    vertices: NDArray[np.float32]
    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray
    actions: FloatArray
    displacements: FloatArray
    keys: FloatArray
    taught: FloatArray = field(default_factory=lambda: np.empty(0))
    controls: Mapping[str, float] = field(default_factory=dict)

    @property
    def tongue(self) -> float:
        """How far the tongue is out, 0 to about 1."""
        return float(self.actions[TONGUE])


class _Pose(NamedTuple):
    """What a frame has beside its vertices, as in `HeadFrame`."""

    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray
    taught: FloatArray
    controls: Mapping[str, float]


class HeadDriver:
    """Drives a head by a performer. After preparation, a frame costs a few matrix products.

    Parameters
    ----------
    rig : HeadRig
        The head.
    neutral : Neutral
        The performer's neutral face, from `calibrate`.
    options : DriveSettings
        Settings.
    reuse : HeadDriver, optional
        An earlier driver, whose eyes are continued, and whose deformer is reused if kernel and rig, but for its style,
        are the same.

    Examples
    --------
    >>> from facemime import HeadDriver, built_in_head, calibrate, load_take
    >>> take = load_take("performance.facetake")
    >>> driver = HeadDriver(built_in_head(), calibrate(take))
    >>> frames = [driver.frame(take.result(i)) for i in np.flatnonzero(take.found)]
    >>> np.stack([frame.vertices for frame in frames]).shape  # the face was lost in one frame
    (59, 1781, 3)
    """

    def __init__(
        self,
        rig: HeadRig,
        neutral: Neutral,
        options: DriveSettings = _BY_DEFAULT,
        *,
        reuse: HeadDriver | None = None,
    ) -> None:
        landmarks = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
        self.rig = rig
        self.options = options
        self.neutral = neutral.mirrored() if options.mirror else neutral
        self.retargeter = retargeter_for(self.neutral, landmarks, mode=options.mode, strength=options.strength)
        self.deformer: RBFDeformer | IncrementalDeformer
        self.contact: EyeballContact
        self.modes: NDArray[np.float32] | None
        self.parts: PartDriver | None
        if reuse is not None and reuse.rig.same_face(rig) and _same_deformer(reuse.options, options):
            self.deformer, self.contact = reuse.deformer, reuse.contact
            self.modes, self.parts = reuse.modes, reuse.parts
        else:
            alone, skin = rig.skin()
            if options.borders == "sharp":
                sharp = sharp_regions(alone.region_weights, alone.landmarks, alone.faces)
                alone = replace(alone, region_weights=sharp)
            self.deformer = head_deformer(alone, options.kernel, incremental=options.incremental, exact=options.exact)
            self.modes = _modes(alone, self.deformer, options)
            self.contact = EyeballContact(alone.vertices, alone.region_weights.sum(axis=0), rig.eyeballs, alone.faces)
            self.parts = None if skin is None else PartDriver(rig, skin, alone)
        self.eyes = EyeDriver(self.neutral.gaze, self.neutral.vergence)
        if reuse is not None:
            self.eyes.follow(reuse.eyes)
        self.actions = ActionDriver(self.neutral.actions, self.neutral.shape, options.strength)
        every = np.arange(len(self.rest))
        self._kept, others = (every, every[:0]) if self.parts is None else (self.parts.kept, self.parts.others)
        self.taught = TaughtVertices(rig.style, len(every), self._kept, others)
        self._controls = TaughtControls(rig.style)
        self._expressions = Expressions(self.neutral)
        self._jaw = Jaw(landmarks, rig.jaw_pivot, bite_of(rig))
        self._unit = outer_eye_distance(landmarks)

    @property
    def rest(self) -> NDArray[np.float32]:
        """Vertices at rest, as in `HeadFrame`, (A, 3)."""
        return np.asarray(self.deformer.rest if self.parts is None else self.parts.rest)

    def frame(self, result: TrackResult) -> HeadFrame:
        """Compute the head for a tracking result with a face."""
        result = self._mirrored(result)
        displacements = self.retargeter.displacements(result.shape, result.teeth)
        actions = self._shown_actions(result.actions, result.shape)
        pose = self._pose(result, displacements)
        return HeadFrame(
            vertices=self._vertices(displacements, actions, pose),
            actions=actions,
            displacements=displacements,
            keys=np.empty(0),
            **pose._asdict(),
        )

    def motion(self, results: Sequence[TrackResult], times: FloatArray) -> HeadMotion:
        """Compute the motion for tracking results with a face, as `frame` does one after the other, at times (N,).

        Raises OutputError if it needs a file that is larger than the disk has room for.
        """
        results = [self._mirrored(result) for result in results]
        shapes = np.array([result.shape for result in results])
        displacements = self.retargeter.displacements(shapes, [result.teeth for result in results])
        actions = self._shown_actions(np.array([result.actions for result in results]), shapes)
        poses = [self._pose(result, moved) for result, moved in zip(results, displacements, strict=True)]
        rest = self.rest
        vertices = large_array((len(results), *rest.shape))
        for row, moved, shown, pose in zip(vertices, displacements, actions, poses, strict=True):
            np.subtract(self._vertices(moved, shown, pose), rest, out=row)
        controls = {name: np.array([pose.controls[name] for pose in poses]) for name in self._controls.names}
        rigid = {name: np.array([getattr(pose, name) for pose in poses]) for name in _RIGID}
        return HeadMotion(times, vertices, actions=actions, controls=controls, **rigid)

    def _vertices(self, displacements: FloatArray, actions: FloatArray, pose: _Pose) -> NDArray[np.float32]:
        """Compute all vertices (A, 3) for displacements (66, 3) of landmarks and shown actions (15,)."""
        skin = self._skin(displacements, actions)
        self.taught.move_skin(skin, pose.taught)
        vertices = self._posed(skin, pose.jaw, pose.gaze, float(actions[TONGUE]))
        self.taught.move_others(vertices, pose.taught)
        return vertices

    def _shown_actions(self, actions: FloatArray, shapes: FloatArray) -> FloatArray:
        """Activations (..., 15) that are shown, for those of tracking results and their shapes."""
        if self.options.only_landmarks:
            return np.zeros_like(actions)
        return self.actions.activations(actions, shapes)

    def _pose(self, result: TrackResult, displacements: FloatArray) -> _Pose:
        """Compute what moves rigidly, and the corrections, for a mirrored result and displacements of landmarks."""
        posing = self.options.posing
        # Pose within the user's limits (section 4.5).
        turned = euler_to_matrix(*result.pose[1:4]) @ self.neutral.rotation.T
        rotation = limit_rotation(turned, posing.rotation_strength, posing.rotation_limit)
        expression = self._expressions.of(result)
        gaze = self.eyes.rotations(result.gaze, result.vergence, rotation)
        moved = limit_vector(self._translation(result.pose), posing.location_strength, posing.location_limit)
        return _Pose(
            rotation=rotation,
            translation=self._unit * moved,
            jaw=self._jaw.rotation(displacements, result.teeth),
            gaze=np.stack([limit_rotation(eye, posing.eyes_strength, posing.eyes_limit) for eye in gaze]),
            taught=self.taught.weights(expression),
            controls=self._controls.changes(expression),
        )

    def expression(self, result: TrackResult) -> FloatArray:
        """Return the expression of a tracking result with a face, (213,), for which corrections are taught."""
        return self._expressions.of(self._mirrored(result))

    def offsets(self, shown: HeadFrame, wanted: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the offsets, (A, 3), of an example that lets the head look as `wanted` (A, 3) in a frame.

        Where that is what the frame shows already, the example keeps the present correction. Arrays are as in
        `HeadFrame`.
        """
        edited = self.edited(shown, wanted)
        offsets = np.zeros_like(shown.vertices)
        self.taught.move_others(offsets, shown.taught)
        base, kept = self._skin(shown.displacements, shown.actions), self._kept
        present = np.zeros_like(base)
        self.taught.move_skin(present, shown.taught)
        skin = np.where(edited[kept, None], wanted[kept] - base, present)
        offsets[kept] = skin
        if self.parts is not None:
            others = self.parts.others[edited[self.parts.others]]
            offsets[others] = (wanted - self._posed(base + skin, shown.jaw, shown.gaze, shown.tongue))[others]
        return offsets

    def edited(self, shown: HeadFrame, wanted: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return which vertices (A,) of a head that looks as `wanted` (A, 3) differ from those of a frame."""
        return edited_vertices(wanted, shown.vertices, self._unit)

    def _mirrored(self, result: TrackResult) -> TrackResult:
        return mirror_result(result, MIRROR_WIDTH) if self.options.mirror else result

    def _skin(self, displacements: FloatArray, actions: FloatArray) -> NDArray[np.float32]:
        """Move the skin (U, 3) by the landmarks (section 5), and by actions that no landmark shows (5.9)."""
        vertices = self.deformer.deform(displacements)
        if self.modes is not None:
            for k in np.flatnonzero(actions):
                vertices += np.float32(actions[k]) * self.modes[k]
        if self.options.mode == "planar":
            vertices[:, 2] = self.deformer.rest[:, 2]
        return vertices

    def _posed(
        self, skin: NDArray[np.float32], jaw: FloatArray, eyes: FloatArray, tongue: float
    ) -> NDArray[np.float32]:
        """Return all vertices (A, 3) for those of the skin, whose lids slide over the eyeballs (section 5.8)."""
        planar = self.options.mode == "planar"
        if self.options.contact and not planar:
            self.contact.resolve(skin)
        return skin if self.parts is None else self.parts.pose(skin, jaw, eyes, tongue, planar=planar)

    def _translation(self, pose: FloatArray) -> FloatArray:
        """Translation from neutral in outer-eye distances, (3,), by weak perspective (equation 4.4)."""
        scale, tx, ty = self.neutral.position
        s = float(pose[0])
        sideways = np.array([pose[4] - tx, pose[5] - ty]) / np.sqrt(s * scale)
        return np.array([*sideways, CAMERA_DISTANCE * (scale / s - 1.0)])


def _modes(
    rig: HeadRig, deformer: RBFDeformer | IncrementalDeformer, options: DriveSettings
) -> NDArray[np.float32] | None:
    """Return the modes of the actions, or None for a deformer without knowledge of how faces move."""
    if options.kernel != INFORMED or rig.faces is None or not isinstance(deformer, RBFDeformer):
        return None
    return action_modes(rig, deformer)


def _same_deformer(one: DriveSettings, other: DriveSettings) -> bool:
    kept = (one.kernel, one.borders, one.exact) == (other.kernel, other.borders, other.exact)
    return kept and not one.incremental and not other.incremental


@dataclass(frozen=True)
class HeadMotion:
    """The motion of a head over the frames of a take that have a face.

    Attributes
    ----------
    times : (N,) float64
        Times in seconds from the first frame of the take. Lost frames are omitted; animation curves bridge them.
    vertices : (N, A, 3) float32
        Displacements from rest, ordered as in `HeadFrame`: head frame, unit of the mesh.
    rotation, jaw : (N, 3, 3) float64
    gaze : (N, 2, 3, 3) float64
    translation : (N, 3) float64
    actions : (N, 15) float64
        As in `HeadFrame`.
    controls : mapping of str to (N,) float64
        As in `HeadFrame`.
    """

    times: FloatArray
    vertices: NDArray[np.float32]
    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray
    actions: FloatArray
    controls: Mapping[str, FloatArray] = field(default_factory=dict)


def drive_take(driver: HeadDriver, take: Take) -> HeadMotion:
    """Drive a head by all frames of a take that have a face; raises SourceError if none has."""
    found = np.flatnonzero(take.found)
    if len(found) == 0:
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    return driver.motion([take.result(int(index)) for index in found], take.times[found])


def select_distinct_frames(motion: HeadMotion, count: int) -> NDArray[np.intp]:
    """Return at most `count` rows of `motion`, in order of time, whose expressions differ most.

    Farthest-point sampling (Gonzalez 1985) of the displacements of the vertices, starting with the frame that is
    farthest from rest.
    """
    flat = motion.vertices.reshape(len(motion.times), -1)
    squares = np.array([row @ row for row in flat])
    chosen = [int(np.argmax(squares))]
    distance = np.full(len(flat), np.inf, dtype=np.float32)
    while len(chosen) < min(count, len(flat)):
        last = chosen[-1]
        # |a - b|^2 = |a|^2 + |b|^2 - 2 a b; rounding can make it negative.
        np.minimum(distance, np.maximum(squares + squares[last] - 2.0 * (flat @ flat[last]), 0.0), out=distance)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return np.sort(np.array(chosen, dtype=np.intp))

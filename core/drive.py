"""The way of a frame from a tracking result to a head: vertices, pose, jaw and gaze; the same live and headless."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray, IntArray
from .deform.expressions import ExpressionModel, learnt_covariance, shipped_expressions
from .deform.eyeballs import EyeballContact
from .deform.follow import following
from .deform.kernels import kernel_named
from .deform.rbf import IncrementalDeformer, RBFDeformer
from .deform.regions import DEFAULT_KERNEL, membership, region_sigmas
from .errors import HeadError
from .eyes import EyeDriver
from .head import load_head
from .landmarks import N_LANDMARKS, OUTER_EYE_CORNERS, from_ibug
from .posing import Posing, limited_rotation, limited_vector
from .retarget import MIRROR_WIDTH, Mode, Neutral, retargeter_for
from .rotation import euler_to_matrix, fit_rotation
from .tracking.mirror import mirror_result
from .tracking.result import TrackResult

_CHIN = from_ibug(range(6, 11))
_CAMERA_DISTANCE = 6.0

INFORMED = "informed"
"""The kernel that knows faces, by default; any name of `kernels.KERNELS` is one that knows distance alone."""


@dataclass(frozen=True)
class HeadRig:
    """What driving a mesh needs to know of it, in the head frame and the mesh's own unit.

    Attributes
    ----------
    vertices : (V, 3) float
        Rest positions.
    landmarks : (66,) int
        Vertex of each landmark.
    region_weights : (3, V) float
        Shares of the regions upper, middle and lower.
    jaw_pivot : (3,) float
        A point on the hinge of the jaw.
    eyeballs : (E, 4) float
        Centre and radius of each eyeball; none by default.
    control_points : (3, 66) bool, optional
        Which landmark controls which region, as `greedy_select` chooses; all of a region's by default.
    covariance : (66, 66) float, optional
        Of the landmarks in the take for which these were chosen: how the others follow.
    faces : (F, K) int, optional
        Vertices of each face, padded with -1: the skin that the informed kernel follows; space alone where not known.
    """

    vertices: FloatArray
    landmarks: IntArray
    region_weights: FloatArray
    jaw_pivot: FloatArray
    eyeballs: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    control_points: NDArray[np.bool_] | None = None
    covariance: FloatArray | None = None
    faces: IntArray | None = None

    def __post_init__(self) -> None:
        landmarks = np.asarray(self.landmarks)
        if landmarks.shape != (N_LANDMARKS,):
            raise HeadError(
                f"{N_LANDMARKS} landmark vertices are needed; got {landmarks.shape}. Bind the landmarks first."
            )
        if landmarks.min() < 0 or landmarks.max() >= len(self.vertices):
            raise HeadError("The landmarks name vertices that the mesh no longer has. Bind them again.")


@dataclass(frozen=True)
class HeadFrame:
    """One frame of a driven head.

    Attributes
    ----------
    vertices : (V, 3) float32
        Head frame, the mesh's unit, the head's pose not applied.
    rotation : (3, 3) float64
        Of the whole head from its neutral attitude.
    translation : (3,) float64
        Of the whole head from its neutral place, the mesh's unit.
    jaw : (3, 3) float64
        Rotation of lower teeth and tongue about the jaw's pivot.
    gaze : (3, 3) float64
        Rotation of both eyeballs about their centres, within the head.
    """

    vertices: NDArray[np.float32]
    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray


@dataclass(frozen=True)
class DriveOptions:
    """How a performance moves a head.

    Attributes
    ----------
    mode : {"3d", "planar"}
    strength : tuple of float
        Gains of the regions upper, middle and lower.
    kernel : str
        "informed" for `DEFAULT_KERNEL` with what is learnt of faces beside it, or a name of `kernels.KERNELS`; the
        paper's is "gaussian".
    incremental : bool
        Fit every frame anew from the one before, as the paper does.
    mirror : bool
        Whether the head is the performer's mirror image.
    posing : Posing
        Strength and limits of head and eyes.
    """

    mode: Mode = "3d"
    strength: tuple[float, float, float] = (1.0, 1.0, 1.0)
    kernel: str = INFORMED
    incremental: bool = False
    mirror: bool = False
    posing: Posing = field(default_factory=Posing)


class HeadDriver:
    """Drives one head from one performer; prepared once, then a few matrix products a frame.

    Parameters
    ----------
    rig : HeadRig
    neutral : Neutral
        The performer's, from `calibrate`.
    options : DriveOptions
    like : HeadDriver, optional
        Drove the same rig before: where its kernel is the same too, what was prepared for it is used again.
    """

    def __init__(
        self,
        rig: HeadRig,
        neutral: Neutral,
        options: DriveOptions = DriveOptions(),
        *,
        like: HeadDriver | None = None,
    ) -> None:
        landmarks = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
        self.rig = rig
        self.options = options
        self.neutral = neutral.mirrored() if options.mirror else neutral
        self.retargeter = retargeter_for(self.neutral, landmarks, mode=options.mode, strength=options.strength)
        self.deformer: RBFDeformer | IncrementalDeformer
        self.contact: EyeballContact
        if like is not None and like.rig is rig and _same_skin(like.options, options):
            self.deformer, self.contact = like.deformer, like.contact
        else:
            self.deformer = head_deformer(rig, options.kernel, incremental=options.incremental)
            self.contact = EyeballContact(rig.vertices, rig.region_weights.sum(axis=0), rig.eyeballs)
        self.eyes = EyeDriver(self.neutral.gaze)
        self._chin = landmarks[_CHIN] - rig.jaw_pivot
        self._unit = float(np.linalg.norm(np.subtract(*landmarks[OUTER_EYE_CORNERS])))

    def frame(self, result: TrackResult) -> HeadFrame:
        """The head for one tracking result in which a face was found."""
        result = mirror_result(result, MIRROR_WIDTH) if self.options.mirror else result
        posing = self.options.posing
        displacements = self.retargeter.displacements(result.shape)
        turned = euler_to_matrix(*result.pose[1:4]) @ self.neutral.rotation.T
        rotation = limited_rotation(turned, posing.rotation, posing.rotation_limit)
        vertices = self.deformer.deform(displacements)
        self.contact.resolve(vertices)
        return HeadFrame(
            vertices=vertices,
            rotation=rotation,
            translation=self._unit * limited_vector(self._moved(result.pose), posing.location, posing.location_limit),
            jaw=fit_rotation(self._chin, self._chin + displacements[_CHIN]),
            gaze=limited_rotation(self.eyes.rotation(result.gaze, rotation), posing.eyes, posing.eyes_limit),
        )

    def _moved(self, pose: FloatArray) -> FloatArray:
        """(3,) outer-eye distances from the neutral place: weak perspective at an ordinary webcam distance."""
        scale, tx, ty = self.neutral.position
        s = float(pose[0])
        sideways = np.array([pose[4] - tx, pose[5] - ty]) / np.sqrt(s * scale)
        return np.array([*sideways, _CAMERA_DISTANCE * (scale / s - 1.0)])


def _same_skin(one: DriveOptions, other: DriveOptions) -> bool:
    return one.kernel == other.kernel and not one.incremental and not other.incremental


def built_in_rig() -> HeadRig:
    """The built-in head, as Blender's copy of it would be read."""
    head = load_head()
    eyes = [part for part in head.parts if part.name.startswith("eye")]
    eyeballs = [[*eye.pivot, float(np.linalg.norm(eye.vertices - eye.pivot, axis=1).max())] for eye in eyes]
    return HeadRig(
        head.vertices,
        head.landmarks,
        head.regions,
        head.jaw_pivot,
        np.array(eyeballs, dtype=np.float64),
        faces=head.faces,
    )


def head_deformer(
    rig: HeadRig,
    kernel: str = INFORMED,
    *,
    incremental: bool = False,
    expressions: tuple[ExpressionModel, ...] | None = None,
) -> RBFDeformer | IncrementalDeformer:
    """What moves the vertices of `rig` by the displacements of its 66 landmarks; parameters as for `HeadDriver`.

    `expressions` are what the informed kernel knows of faces, by default what ships.
    """
    places = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    plain = DEFAULT_KERNEL if kernel == INFORMED else kernel
    sigma = region_sigmas(places, kernel_named(plain))
    follow = None
    if rig.control_points is not None:
        follow = following(places, rig.control_points, rig.covariance, kernel_named(plain), sigma)
    fit = partial(
        IncrementalDeformer if incremental else RBFDeformer,
        rig.vertices,
        places,
        rig.region_weights,
        membership(),
        kernel=plain,
        sigma=sigma,
        follow=follow,
    )
    if kernel != INFORMED or rig.faces is None or incremental:
        return fit()
    known = shipped_expressions() if expressions is None else expressions
    return fit(skin=learnt_covariance(known, rig.vertices, rig.faces, rig.landmarks, rig.region_weights))

"""The way of a frame from a tracking result to a head: vertices, pose, jaw and gaze; the same live and headless."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..deform.head_deformer import head_deformer
from ..deform.rbf import IncrementalDeformer, RBFDeformer
from ..heads.eyeballs import EyeballContact
from ..heads.rig import HeadRig
from ..landmarks import CHIN, outer_eye_distance
from ..rotation import euler_to_matrix, fit_rotation
from ..takes.neutral import MIRROR_WIDTH, Neutral
from ..tracking.mirror import mirror_result
from ..tracking.result import TrackResult
from .eyes import EyeDriver
from .posing import limited_rotation, limited_vector
from .retarget import retargeter_for
from .settings import DriveSettings

_CAMERA_DISTANCE = 6.0
_BY_DEFAULT = DriveSettings()


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


class HeadDriver:
    """Drives one head from one performer; prepared once, then a few matrix products a frame.

    Parameters
    ----------
    rig : HeadRig
    neutral : Neutral
        The performer's, from `calibrate`.
    options : DriveSettings
    like : HeadDriver, optional
        Drove the same rig before: where its kernel is the same too, what was prepared for it is used again.
    """

    def __init__(
        self,
        rig: HeadRig,
        neutral: Neutral,
        options: DriveSettings = _BY_DEFAULT,
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
        self._chin = landmarks[CHIN] - rig.jaw_pivot
        self._unit = outer_eye_distance(landmarks)

    def frame(self, result: TrackResult) -> HeadFrame:
        """The head for one tracking result in which a face was found."""
        result = mirror_result(result, MIRROR_WIDTH) if self.options.mirror else result
        posing = self.options.posing
        displacements = self.retargeter.displacements(result.shape)
        turned = euler_to_matrix(*result.pose[1:4]) @ self.neutral.rotation.T
        rotation = limited_rotation(turned, posing.rotation_strength, posing.rotation_limit)
        vertices = self.deformer.deform(displacements)
        self.contact.resolve(vertices)
        return HeadFrame(
            vertices=vertices,
            rotation=rotation,
            translation=self._unit
            * limited_vector(self._moved(result.pose), posing.location_strength, posing.location_limit),
            jaw=fit_rotation(self._chin, self._chin + displacements[CHIN]),
            gaze=limited_rotation(self.eyes.rotation(result.gaze, rotation), posing.eyes_strength, posing.eyes_limit),
        )

    def _moved(self, pose: FloatArray) -> FloatArray:
        """(3,) outer-eye distances from the neutral place: weak perspective at an ordinary webcam distance."""
        scale, tx, ty = self.neutral.position
        s = float(pose[0])
        sideways = np.array([pose[4] - tx, pose[5] - ty]) / np.sqrt(s * scale)
        return np.array([*sideways, _CAMERA_DISTANCE * (scale / s - 1.0)])


def _same_skin(one: DriveSettings, other: DriveSettings) -> bool:
    return one.kernel == other.kernel and not one.incremental and not other.incremental

"""What driving a head requires, wherever its mesh comes from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, IntArray
from ..errors import HeadError
from ..landmarks import N_LANDMARKS, outer_eye_distance
from .built_in import load_head


@dataclass(frozen=True)
class HeadRig:
    """A mesh that can be driven, in the head frame and the unit of the mesh.

    Attributes
    ----------
    vertices : (V, 3) float
        Rest positions.
    landmarks : (66,) int
        Vertex of each landmark.
    region_weights : (3, V) float
        Weights of the regions upper, middle and lower.
    jaw_pivot : (3,) float
        A point on the hinge of the jaw.
    eyeballs : (E, 4) float
        Centre and radius of each eyeball.
    control_points : (3, 66) bool, optional
        Whether a landmark is a control point of a region, as `greedy_select` chooses; by default all are.
    covariance : (66, 66) float, optional
        Covariance of the landmarks in the take for which these were chosen, by which the others follow.
    faces : (F, K) int, optional
        Vertices of each face, padded with -1, for the informed kernel, which otherwise uses distance in space alone.
    """

    vertices: FloatArray
    landmarks: IntArray
    region_weights: FloatArray
    jaw_pivot: FloatArray
    eyeballs: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    control_points: NDArray[np.bool_] | None = None
    covariance: FloatArray | None = None
    faces: IntArray | None = None

    @property
    def eye_distance(self) -> float:
        """Distance between the outer corners of the eyes, in the unit of the mesh."""
        return outer_eye_distance(self.vertices[self.landmarks])

    def __post_init__(self) -> None:
        landmarks = np.asarray(self.landmarks)
        if landmarks.shape != (N_LANDMARKS,):
            raise HeadError(
                f"{N_LANDMARKS} landmark vertices are needed; got {landmarks.shape}. Bind the landmarks first."
            )
        if landmarks.min() < 0 or landmarks.max() >= len(self.vertices):
            raise HeadError("The mesh no longer has the vertices of the landmarks. Bind them again.")


def built_in_rig() -> HeadRig:
    """The rig of the built-in head, equal to that of its copy in Blender."""
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

"""What driving a mesh needs to know of it, whatever it came from."""

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

    @property
    def eye_distance(self) -> float:
        """Between the outer corners of the eyes, the mesh's unit."""
        return outer_eye_distance(self.vertices[self.landmarks])

    def __post_init__(self) -> None:
        landmarks = np.asarray(self.landmarks)
        if landmarks.shape != (N_LANDMARKS,):
            raise HeadError(
                f"{N_LANDMARKS} landmark vertices are needed; got {landmarks.shape}. Bind the landmarks first."
            )
        if landmarks.min() < 0 or landmarks.max() >= len(self.vertices):
            raise HeadError("The landmarks name vertices that the mesh no longer has. Bind them again.")


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

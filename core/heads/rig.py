"""All that driving a head requires, whatever the source of its mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError
from ..face.landmarks import JAW, N_LANDMARKS, outer_eye_distance
from ..face.rotation import fit_rotation
from ..numeric.arrays import FloatArray, IntArray
from .built_in import Head, load_head
from .parts import FaceParts, Part, Skin, skin_of

_JAW_SIDES = JAW[[2, 14]]
"""Landmarks in front of the ears, between which the jaw turns."""


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
        Whether each landmark is a control point of each region, as chosen by `greedy_select`; by default all are.
    covariance : (66, 66) float, optional
        Covariance of the landmarks in the take for which the control points were chosen, by which the others follow.
    faces : (F, K) int, optional
        Vertices of each face, padded with -1, for the informed kernel, which otherwise uses only distance in space.
    parts : FaceParts, optional
        Eyes, teeth, lashes and other parts, of this mesh and of others; without it all vertices are skin.

    Examples
    --------
    >>> from facemime import HeadRig, built_in_head
    >>> head: HeadRig = built_in_head()
    >>> head.vertices.shape, head.landmarks.shape, head.region_weights.shape
    ((1781, 3), (66,), (3, 1781))
    """

    vertices: FloatArray
    landmarks: IntArray
    region_weights: FloatArray
    jaw_pivot: FloatArray
    eyeballs: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    control_points: NDArray[np.bool_] | None = None
    covariance: FloatArray | None = None
    faces: IntArray | None = None
    parts: FaceParts | None = None

    @property
    def eye_distance(self) -> float:
        """Distance between the outer corners of the eyes, in the unit of the mesh."""
        return outer_eye_distance(self.vertices[self.landmarks])

    @property
    def kinds(self) -> NDArray[np.int8]:
        """`Part` of each of `all_vertices`, (A,)."""
        return np.zeros(len(self.vertices), dtype=np.int8) if self.parts is None else self.parts.kinds

    @property
    def all_vertices(self) -> NDArray[np.float32]:
        """Rest positions of the vertices of this mesh, then of other meshes, (A, 3)."""
        own = np.asarray(self.vertices, dtype=np.float32)
        return own if self.parts is None else np.concatenate([own, self.parts.others])

    @property
    def all_faces(self) -> IntArray:
        """Faces of all meshes, (F + G, K)."""
        own = np.empty((0, 3), dtype=np.intp) if self.faces is None else np.asarray(self.faces, dtype=np.intp)
        others = own[:0] if self.parts is None else np.asarray(self.parts.faces, dtype=np.intp)
        width = max(own.shape[1], others.shape[1])
        return np.concatenate([_widened(own, width), _widened(others, width)])

    def skin(self) -> tuple[HeadRig, Skin | None]:
        """Return the rig of the skin alone with its seams closed, and the skin, or None if it is the whole mesh.

        Raises
        ------
        HeadError
            If a landmark lies on another part.
        """
        if self.faces is None:
            return self, None
        others = self.kinds[: len(self.vertices)] != Part.SKIN
        skin = skin_of(self.vertices, self.faces, others, self.landmarks)
        if skin.is_whole and self.parts is None:
            return self, None
        landmarks = skin.number[self.landmarks]
        if (landmarks < 0).any():
            raise HeadError(
                "Landmarks lie on parts that are not skin. Set these parts to Skin, or find the face again."
            )
        alone = replace(
            self,
            vertices=np.asarray(self.vertices)[skin.kept],
            landmarks=landmarks,
            region_weights=np.asarray(self.region_weights)[:, skin.kept],
            faces=skin.faces,
            parts=None,
        )
        return alone, skin

    def __post_init__(self) -> None:
        landmarks = np.asarray(self.landmarks)
        if landmarks.shape != (N_LANDMARKS,):
            raise HeadError(
                "{n_landmarks} landmark vertices are needed; got {shape}. Find the face first.",
                n_landmarks=N_LANDMARKS,
                shape=landmarks.shape,
            )
        if landmarks.min() < 0 or landmarks.max() >= len(self.vertices):
            raise HeadError("The vertices of the landmarks no longer exist. Bind the landmarks again.")


def neck_of(points: FloatArray) -> FloatArray:
    """Return the point about which a head with landmarks `points`, (66, 3), turns: the built-in head's origin, carried
    over by a similarity.
    """
    head = load_head()
    source, target = head.vertices[head.landmarks].astype(np.float64), np.asarray(points, dtype=np.float64)
    turn = fit_rotation(source - source.mean(axis=0), target - target.mean(axis=0))
    size = outer_eye_distance(target) / outer_eye_distance(source)
    return np.asarray(target.mean(axis=0) - size * turn @ source.mean(axis=0))


def jaw_pivot_of(points: FloatArray) -> FloatArray:
    """Return the middle between the sides of the jaw, (3,), from landmarks, (66, 3): a point on its hinge."""
    return np.asarray(np.asarray(points, dtype=np.float64)[_JAW_SIDES].mean(axis=0))


def _widened(faces: IntArray, width: int) -> IntArray:
    return np.pad(faces, ((0, 0), (0, width - faces.shape[1])), constant_values=-1)


def built_in_head(*, lashes: bool = False) -> HeadRig:
    """Return the rig of the built-in head; with lashes and brows, it equals that of its copy in Blender.

    Examples
    --------
    >>> from facemime import built_in_head
    >>> built_in_head().vertices.shape
    (1781, 3)
    """
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
        parts=_lashes(head) if lashes else None,
    )


def _lashes(head: Head) -> FaceParts:
    part = head.part("lashes")
    count = len(head.vertices)
    kinds = np.repeat([Part.SKIN, Part.ON_SKIN], [count, len(part.vertices)]).astype(np.int8)
    return FaceParts(kinds, part.vertices, np.where(part.faces < 0, -1, part.faces + count))


built_in_rig = built_in_head
"""Its name in version 0.1.0, for programs that import it, until 1.0."""

"""All that driving a head requires, whatever the source of its mesh, with the parts of a character's face."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError, messages
from ..face.landmarks import EYE_LEFT, EYE_RIGHT, JAW, LIPS, N_LANDMARKS, outer_eye_distance
from ..face.rotation import fit_rotation
from ..mesh.surface import SurfaceGraph, border_twins, touching
from ..mesh.winding import inside_out, turned_over
from ..numeric.arrays import FloatArray, IntArray
from .built_in import Head, load_head
from .style import Style

_SLIT_REACH = 0.15
"""Distance, in outer-eye distances, from the landmarks of an eye or the mouth within which a closed border is its
slit."""


_SLIT_LENGTH = 0.5
"""Length of a slit, as a share of the size of the eye or mouth, below which it is a piece of a seam."""


class Part(IntEnum):
    """The part that a vertex belongs to, which decides what it follows. Left and right are the character's own."""

    SKIN = 0
    ON_HEAD = 1
    ON_SKIN = 2
    EYE_RIGHT = 3
    EYE_LEFT = 4
    TEETH_UPPER = 5
    TEETH_LOWER = 6


PART_NAMES = messages(
    {
        Part.SKIN: "Skin",
        Part.ON_HEAD: "On Head",
        Part.ON_SKIN: "On Skin",
        Part.EYE_RIGHT: "Right Eye",
        Part.EYE_LEFT: "Left Eye",
        Part.TEETH_UPPER: "Upper Teeth",
        Part.TEETH_LOWER: "Lower Teeth",
    }
)
"""Names of the parts in the interface."""


@dataclass(frozen=True, eq=False)
class FaceParts:
    """The parts of a face other than its skin.

    Attributes
    ----------
    kinds : (A,) int8
        `Part` of each vertex: first those of the head's own mesh, then those of other meshes.
    others : (A - V, 3) float32
        Rest positions of the vertices of other meshes, in the head frame.
    faces : (G, K) int
        Faces of the other meshes, padded with -1, as indices into all A vertices.
    """

    kinds: NDArray[np.int8]
    others: NDArray[np.float32]
    faces: IntArray


def same_parts(first: FaceParts | None, second: FaceParts | None) -> bool:
    """Return whether two faces have parts of the same kinds, vertices and faces; None is a face that is all skin."""
    if first is None or second is None:
        return first is second
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("kinds", "others", "faces"))


@dataclass(frozen=True, eq=False)
class Skin:
    """The skin of a mesh, with seams closed.

    Attributes
    ----------
    kept : (U,) intp
        Vertex of the mesh of each vertex of the skin.
    number : (V,) intp
        Vertex of the skin of each vertex of the mesh; twins at a seam share one, and vertices of other parts have -1.
    faces : (F, K) intp
        Faces of the skin.
    rows : (F,) intp
        Face of the mesh of each face of the skin.
    turned : (F,) bool
        Faces whose corners are in the opposite order, so that all face outwards.
    """

    kept: NDArray[np.intp]
    number: NDArray[np.intp]
    faces: NDArray[np.intp]
    rows: NDArray[np.intp]
    turned: NDArray[np.bool_]

    @property
    def is_whole(self) -> bool:
        """Whether the skin is the unchanged mesh."""
        return len(self.kept) == len(self.number)


def skin_of(
    vertices: FloatArray, faces: IntArray, others: NDArray[np.bool_] | None = None, landmarks: IntArray | None = None
) -> Skin:
    """Find the skin of a mesh, without the vertices that `others` (V,) marks as those of other parts.

    If the landmarks are given, slits that were cut along lids and lips stay open.
    """
    faces = np.asarray(faces)
    skin = np.ones(len(vertices), dtype=bool) if others is None else ~np.asarray(others)
    slits = np.empty(0, dtype=np.intp) if landmarks is None else _slits(vertices, faces, landmarks)
    first = border_twins(vertices, faces, np.concatenate([slits, np.flatnonzero(~skin)]))
    kept = np.flatnonzero(skin & (first == np.arange(len(first))))
    number = np.full(len(first) + 1, -1)
    number[kept] = np.arange(len(kept))
    number[:-1][skin] = number[first[skin]]
    within = ((number[faces] >= 0) | (faces < 0)).all(axis=1)
    found = number[faces[within]]
    turned = inside_out(np.asarray(vertices)[kept], found)
    return Skin(kept, number[:-1], turned_over(found, found, turned), np.flatnonzero(within), turned)


def _size(points: FloatArray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _slits(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> NDArray[np.intp]:
    """Find the vertices of borders along the lids or the lips where skin was cut apart without a gap.

    There a border touches itself. At a seam of the texture it touches that of another piece, such as the inside of the
    mouth.
    """
    graph = SurfaceGraph(vertices, faces)
    points = graph.vertices[landmarks]
    reach = _SLIT_REACH * outer_eye_distance(points)
    found, borders = [np.empty(0, dtype=np.intp)], graph.openings()
    firsts = graph.vertices[[border[0] for border in borders]].reshape(-1, 3)
    for organ in (EYE_RIGHT, EYE_LEFT, LIPS):
        around = np.linalg.norm(firsts[:, None] - points[organ], axis=2).min(axis=1)
        for i in np.flatnonzero(around < reach):  # a mesh whose faces are all apart has a border around each
            places = graph.vertices[borders[i]]
            away = np.linalg.norm(places[:, None] - points[organ], axis=2).min(axis=1)
            if _size(places) > _SLIT_LENGTH * _size(points[organ]) and away.max() < reach:
                found.append(touching(graph.vertices, borders[i]))
    return np.concatenate(found)


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
    style : Style
        Examples by which the head was taught; by default none.

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
    style: Style = field(default_factory=Style)

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
            style=Style(),
        )
        return alone, skin

    def same_face(self, other: HeadRig) -> bool:
        """Return whether everything but the style is the same objects, as after `dataclasses.replace`."""
        names = (one.name for one in fields(self) if one.name != "style")
        return all(getattr(self, name) is getattr(other, name) for name in names)

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
"""Its name in version 0.1.0, for programs that import it, until 2.0."""

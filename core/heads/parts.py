"""Parts of a character's face, in one mesh or several, and the skin among them (method.md, section 7.5)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ..errors import messages
from ..face.landmarks import EYE_LEFT, EYE_RIGHT, LIPS, outer_eye_distance
from ..mesh.pieces import border_twins
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray

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
    """Return whether two faces have the same parts.

    Parameters
    ----------
    first, second : FaceParts or None
        The parts; None for a face that is all skin.

    Returns
    -------
    bool
        Whether kinds, vertices and faces are equal.
    """
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
    """

    kept: NDArray[np.intp]
    number: NDArray[np.intp]
    faces: NDArray[np.intp]

    @property
    def is_whole(self) -> bool:
        """Whether the skin is the unchanged mesh."""
        return len(self.kept) == len(self.number)


def skin_of(
    vertices: FloatArray, faces: IntArray, others: NDArray[np.bool_] | None = None, landmarks: IntArray | None = None
) -> Skin:
    """Find the skin of a mesh.

    Parameters
    ----------
    vertices : (V, 3) array
        Positions, in any unit.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    others : (V,) bool, optional
        Whether a vertex belongs to another part.
    landmarks : (66,) array of int, optional
        Vertices of the landmarks. Slits that were cut along lids and lips then stay open.
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
    return Skin(kept, number[:-1], number[faces[within]])


def _size(points: FloatArray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _slits(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> NDArray[np.intp]:
    """Find the vertices of closed borders along the lids or the lips, where skin was cut apart without a gap."""
    graph = SurfaceGraph(vertices, faces)
    points = graph.vertices[landmarks]
    reach = _SLIT_REACH * outer_eye_distance(points)
    found = [np.empty(0, dtype=np.intp)]
    for border in graph.openings():
        for organ in (EYE_RIGHT, EYE_LEFT, LIPS):
            away = np.linalg.norm(graph.vertices[border][:, None] - points[organ], axis=2).min(axis=1)
            long = _size(graph.vertices[border]) > _SLIT_LENGTH * _size(points[organ])
            if long and away.max() < reach:
                found.append(border)
    return np.concatenate(found)

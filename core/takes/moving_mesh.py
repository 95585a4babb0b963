"""Takes from meshes that move: landmarks are bound at rest, and their places in each frame become pose and shape."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError, SourceError
from ..face.landmarks import EYE_CORNERS, from_ibug, outer_eye_distance
from ..heads.bind import bind_landmarks, pieces_with_face
from ..heads.proposal import propose_regions
from ..heads.regions import LOWER
from ..heads.rig import Part, Skin, neck_of, skin_of
from ..heads.sorting import Piece, sort_pieces
from ..mesh.surface import border_twins, islands
from ..numeric.arrays import FloatArray, IntArray
from ..tracking.result import TrackResult
from .measured import FacePoints, PointTracker, describe_animation
from .take import Take, TakeRecorder

TO_HEAD = np.array([1.0, -1.0, -1.0])
"""Factors that convert axes with y up and z to the viewer, as files have them, to those of the head frame."""
_MAX_ANCHORS = 1000
_REACH = 2.0
"""Distance from the middle of the eyes within which vertices determine the pose of the head, in eye distances."""
_NOSE_BASE = int(from_ibug([33])[0])


@dataclass(frozen=True)
class MovingMesh:
    """A mesh whose vertices move.

    Attributes
    ----------
    source : str
        Name of the file.
    rest : (V, 3) float64
        Vertices in which the landmarks are bound: head frame, in any unit.
    faces : (F, K) int
        Vertices of each face, padded with -1.
    frames : iterable of (V, 3) float64 or None
        Vertices in each frame; None if a frame is missing.
    is_neutral : bool
        Whether the mesh at rest is the neutral face.
    notes : tuple of str
        What was assumed, or is missing.
    """

    source: str
    rest: FloatArray
    faces: IntArray
    frames: Iterable[FloatArray | None]
    is_neutral: bool = False
    notes: tuple[str, ...] = ()


def take_of_mesh(mesh: MovingMesh, fps: float, marks: Mapping[int, int] | None = None) -> Take:
    """Return the take of a moving mesh.

    `marks` are vertices that the user marked, by iBUG number, as for `bind_landmarks`. Unless the mesh at rest is
    neutral, the neutral face is found in the take, as in that of a video. Raises HeadError if no face is found, and
    SourceError if a frame cannot be read.
    """
    skin, landmarks, turn, eyes = _bound(mesh, marks or {})
    places = mesh.rest @ turn.T
    anchors = anchors_of(places, landmarks, np.isin(np.arange(len(places)), skin.kept))
    weights = propose_regions(places[skin.kept], skin.faces, skin.number[landmarks])
    trust = 1.0 - weights[LOWER, skin.number[anchors]].astype(np.float64)

    def points(vertices: FloatArray) -> FacePoints:
        right, left = (vertices[eye] @ turn.T for eye in eyes)
        return FacePoints(vertices[landmarks] @ turn.T, vertices[anchors] @ turn.T, (right, left))

    tracker = PointTracker(points(mesh.rest), neck_of(places[landmarks]), trust)
    recorder = TakeRecorder(describe_animation(mesh.source, fps))
    for number, vertices in enumerate(mesh.frames):
        result = TrackResult.nothing(0) if vertices is None else tracker.track(points(vertices))
        recorder.append(number / fps, result)
    take = tracker.finish(recorder) if mesh.is_neutral else recorder.finish()
    if not take.found.any():
        raise SourceError("{source} has no frame with a face. Choose another file.", source=mesh.source)
    if mesh.notes:
        take.info["notes"] = list(mesh.notes)
    return take


def anchors_of(vertices: FloatArray, landmarks: IntArray, skin: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Choose vertices of the skin (V,) around the skull and the brow, which no mouth moves, nor the bones of a body."""
    points = vertices[landmarks]
    middle, reach = points[EYE_CORNERS].mean(axis=0), _REACH * outer_eye_distance(points)
    near = (np.linalg.norm(vertices - middle, axis=1) < reach) & (vertices[:, 1] < points[_NOSE_BASE, 1])
    anchors = np.flatnonzero(near & skin)
    chosen = np.linspace(0, len(anchors) - 1, min(_MAX_ANCHORS, len(anchors))).astype(np.intp)
    return anchors[np.unique(chosen)]


def _bound(
    mesh: MovingMesh, marks: Mapping[int, int]
) -> tuple[Skin, NDArray[np.intp], FloatArray, list[NDArray[np.intp]]]:
    """Find skin, landmarks, the rotation into the head frame, and the vertices of both eyes; the eyes are no skin."""
    skin = skin_of(mesh.rest, mesh.faces)
    landmarks, turn = _landmarks(mesh, skin, marks)
    number = islands(len(mesh.rest), mesh.faces, border_twins(mesh.rest, mesh.faces))
    on_skin = pieces_with_face(number, landmarks)
    members = np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])
    places = mesh.rest @ turn.T
    pieces = [Piece(places[own], ("", ""), bool(seen)) for own, seen in zip(members, on_skin, strict=True)]
    parts = sort_pieces(pieces, places[landmarks])
    eyes = [
        np.concatenate([np.empty(0, np.intp), *(own for own, of in zip(members, parts, strict=True) if of == part)])
        for part in (Part.EYE_RIGHT, Part.EYE_LEFT)
    ]
    others = ~on_skin[number]
    if on_skin.any() and others.any():
        skin = skin_of(mesh.rest, mesh.faces, others, landmarks)
        landmarks, turn = _landmarks(mesh, skin, marks)
    return skin, landmarks, turn, eyes


def _landmarks(mesh: MovingMesh, skin: Skin, marks: Mapping[int, int]) -> tuple[NDArray[np.intp], FloatArray]:
    """Find the vertices of the landmarks, and the rotation into the head frame."""
    if unknown := [vertex for vertex in marks.values() if not 0 <= vertex < len(mesh.rest)]:
        raise HeadError(
            "{source} has {count} vertices, from 0, and not vertex {vertex}. Mark another.",
            source=mesh.source,
            count=len(mesh.rest),
            vertex=unknown[0],
        )
    marked = {point: int(skin.number[vertex]) for point, vertex in marks.items() if skin.number[vertex] >= 0}
    binding = bind_landmarks(mesh.rest[skin.kept], skin.faces, marked)
    return skin.kept[binding.landmarks], binding.rotation

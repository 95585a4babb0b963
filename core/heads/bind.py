"""Landmarks on an unlabelled head, found by looking at it and bending a template to it (method.md, section 7.1).

The user marks a few points (corners of the eyes and the mouth, tip of the nose, chin), or none if the head is
aligned with the axes of the mesh. The mesh may include a body. The tracker looks at a rendering of the mesh; what it
sees decides on the attitude and guides the template. The template is the built-in head, whose skin is taken by ever
more flexible warps to the nearest places of the mesh that face the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import HeadError, Message, messages
from ..face.landmarks import JAW, N_LANDMARKS, NOSE, from_ibug, outer_eye_distance
from ..mesh.surface import SurfaceGraph, border_twins, islands
from ..numeric.arrays import FloatArray, IntArray, as_points
from .checks import Finding, resting_findings
from .fit_template import NOT_FOUND, fit_template
from .landmark_vertices import FACING, TOO_COARSE, distinct, on_own_lip, onto_corners, onto_rims, pulled_to_marks
from .portrait import Paint
from .proposal import propose_regions
from .rig import HeadRig, jaw_pivot_of
from .sight import CLEAR, Sight
from .symmetry import even_landmarks, mirror_of
from .template import Surface, Template, load_template

MARKS = messages(
    {
        36: "Right eye, outer corner",
        39: "Right eye, inner corner",
        42: "Left eye, inner corner",
        45: "Left eye, outer corner",
        30: "Tip of the nose",
        48: "Right mouth corner",
        54: "Left mouth corner",
        8: "Chin",
    }
)
"""Points that a user may mark, by iBUG number; all or some of them, in any order."""
MIN_MARKS = 4
_DOUBTS = messages(
    {
        1: "This face is unusual. If landmarks are misplaced, also mark: {label1}",
        2: "This face is unusual. If landmarks are misplaced, also mark: {label1}; {label2}",
        3: "This face is unusual. If landmarks are misplaced, also mark: {label1}; {label2}; {label3}",
        4: "This face is unusual. If landmarks are misplaced, mark four points: {label1}; {label2}; {label3}; {label4}",
    }
)
"""What to do in doubt, by the number of marks that would help."""
_ENOUGH = 5 * N_LANDMARKS
"""Number of vertices below which a mesh in which no face is found is too coarse. The built-in head, decimated, is found
down to 370."""

_RIM_REACH = 0.08
"""Distance, in outer-eye distances, within which these landmarks are moved to a rim."""
_RIM_REACH_SEEN = 0.04
"""Distance within which they are if they were seen. It is shorter, as the border of a mesh is often deep inside the
mouth or behind the lids."""
_HEAD_SHARE = 0.8
"""Share of a mesh's vertices below which its head is considered to have a body."""
_MAX_DISTANCE = 0.1
"""Distance, in outer-eye distances, beyond which a vertex that faces the same way is not accepted for a landmark."""
_FACE = np.concatenate([JAW, NOSE])
"""Landmarks that lie on the skin of any face."""
_MIN_ON_SKIN = 3
"""Smallest number of these on a piece of a mesh that is skin."""
_DISTINCT = 0.8
"""Share of landmarks that need a vertex of their own if a face was seen or marked. On a coarse face two landmarks of
the lips or lids may share one."""
_DISTINCT_BY_SHAPE = 0.95
"""Share of landmarks that need a vertex of their own if a face is known by its shape alone."""
_STRANGE = 0.12
"""Strain above which a mesh whose face is not clearly visible is refused. A teddy bear and a cat have 0.123 or more;
anime figures up to 0.09 and a doll 0.114, and their faces are clearly visible."""
_AGREEMENT = 0.12
"""Median distance of landmarks found without marks from these, in outer-eye distances, above which the marks lead the
search."""


@dataclass(frozen=True)
class Binding:
    """Landmarks found on a mesh.

    Attributes
    ----------
    landmarks : (66,) intp
        Vertex of each landmark.
    rotation : (3, 3) float64
        Rotates the mesh upright and towards the viewer: ``vertices @ rotation.T`` is in the head frame.
    residual : float
        Median distance of the bent template from the mesh, in outer-eye distances.
    strain : float
        Mean distance of the bent landmarks from their best similarity, in outer-eye distances: 0.02 to 0.04 for a human
        head.
    symmetric : bool
        Whether the head is its own mirror image. If so, the landmarks are too.
    body : bool
        Whether the mesh is much more than a head.
    clarity : float
        How clearly the tracker sees the face on a rendering of the mesh, 0 to 1; 0 if it sees none.
    wanted : tuple of int
        iBUG numbers of the marks that would help most, at most four, if neither the shape nor the rendering is clear.
        They are expected where their landmarks are now.
    findings : tuple of Finding
        What distinguishes the head at rest from a neutral face.
    """

    landmarks: NDArray[np.intp]
    rotation: FloatArray
    residual: float
    strain: float
    symmetric: bool
    body: bool
    clarity: float = 0.0
    wanted: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def sure(self) -> bool:
        """Whether this certainly is a face in this attitude: marked, seen, or shaped like a human head."""
        return not self.wanted

    @property
    def doubt(self) -> str:
        """What to do if this may not be the face; "" if it is `sure`."""
        if self.sure:
            return ""
        labels = {f"label{place}": MARKS[number] for place, number in enumerate(self.wanted, 1)}
        return Message(_DOUBTS[len(labels)].template, **labels)


def bind_landmarks(
    vertices: FloatArray, faces: IntArray, marks: Mapping[int, int] | None = None, paint: Paint | None = None
) -> Binding:
    """Find the 66 landmarks of a head.

    Parameters
    ----------
    vertices : (V, 3) array
        Positions, in any unit. Without marks, the head has to be aligned with the axes: upright and facing the viewer
        in the head frame (tried first, and fastest), facing another side, or lying on its back or face.
    faces : (F, K) array of int
        Vertices of each face, padded with -1.
    marks : mapping of int to int, optional
        Vertices that the user marked, by iBUG number; at least four of `MARKS`.
    paint : Paint, optional
        Colours of the mesh, in which brows and lids may be seen more clearly than as if it were of clay.

    Returns
    -------
    Binding
        The landmarks.

    Raises
    ------
    HeadError
        If there are fewer than four marks, they lie on one line, a vertex of `faces` is missing, or no face is found.

    Notes
    -----
    Nearest places are sought by position and normal together, so that a lip is not taken for the inside of the mouth.
    The steps are those of method.md, section 7.1: a look by the tracker, a similarity (Besl & McKay 1992), warps
    of decreasing smoothness (Amberg et al. 2007), rims and symmetry. It takes about 1.5 s for 110,000 vertices.
    """
    places = as_points(vertices, "vertices", error=HeadError)
    picked = {int(from_ibug([number])[0]): int(vertex) for number, vertex in (marks or {}).items()}
    if picked and len(picked) < MIN_MARKS:
        raise HeadError(
            "Mark at least {min_marks} points, or none; got {picked}.", min_marks=MIN_MARKS, picked=len(picked)
        )
    if picked and (min(picked.values()) < 0 or max(picked.values()) >= len(places)):
        raise HeadError("A marked point is not a vertex of the mesh. Mark it again.")
    if not len(places):
        raise HeadError("The mesh has no vertices. Choose another mesh.")
    if len(places) < N_LANDMARKS:
        raise HeadError(TOO_COARSE)
    polygons = np.asarray(faces)
    missing = polygons[(polygons < -1) | (polygons >= len(places))]
    if len(missing):
        raise HeadError(
            "A face of the mesh refers to vertex {vertex}, which does not exist. Use vertices from 0 to {last}, and -1 "
            "to pad faces with fewer corners.",
            vertex=missing[0],
            last=len(places) - 1,
        )
    return _marked(places, polygons, picked, paint) if picked else _unmarked(places, polygons, paint)


def _unmarked(places: FloatArray, faces: IntArray, paint: Paint | None) -> Binding:
    """Find the landmarks of a head without marks, and again on its skin alone if some lie on other pieces.

    Raises HeadError if it neither looks like a face nor is shaped like one.
    """
    binding = _on_skin(places, faces, paint)
    if binding.strain > _STRANGE and binding.clarity <= CLEAR:
        raise HeadError(NOT_FOUND)
    return binding


def _on_skin(places: FloatArray, faces: IntArray, paint: Paint | None) -> Binding:
    """Find the landmarks of a head as `_unmarked` does, whatever it looks like."""
    binding = _bound(places, faces, {}, paint)
    skin = _under_others(places, faces, binding.landmarks)
    if not skin.any():
        return binding
    kept = np.flatnonzero(skin)
    number = np.append(np.cumsum(skin) - 1, -1)
    rows = skin[faces[:, 0]]
    try:
        again = _bound(places[kept], number[faces[rows]], {}, None if paint is None else paint.of_faces(rows))
    except HeadError:
        return binding
    return replace(again, landmarks=kept[again.landmarks], body=binding.body)


def _marked(places: FloatArray, faces: IntArray, picked: Mapping[int, int], paint: Paint | None) -> Binding:
    """Find the landmarks of a head with marks: these refine what is found without them, unless that is elsewhere.

    Marks settle the doubt about their own landmarks.
    """
    try:
        plain = _unmarked(places, faces, paint)
    except HeadError:
        return _bound(places, faces, picked, paint)
    points = places[plain.landmarks]
    off = np.linalg.norm(points[list(picked)] - places[list(picked.values())], axis=1)
    if float(np.median(off)) > _AGREEMENT * outer_eye_distance(points):
        return _bound(places, faces, picked, paint)
    landmarks = pulled_to_marks(places, faces, plain.landmarks, picked, symmetric=plain.symmetric)
    wanted = tuple(number for number in plain.wanted if int(from_ibug([number])[0]) not in picked)
    return replace(plain, landmarks=landmarks, wanted=wanted)


def pieces_with_face(number: IntArray, landmarks: IntArray) -> NDArray[np.bool_]:
    """Return which pieces of a mesh, (P,), have the jaw or the nose, by the piece `number` (V,) of each vertex."""
    return np.bincount(number[landmarks[_FACE]], minlength=number.max() + 1) >= _MIN_ON_SKIN


def _under_others(places: FloatArray, faces: IntArray, landmarks: IntArray) -> NDArray[np.bool_]:
    """Find the skin, (V,), of a mesh on which landmarks lie on other pieces, such as a cage for clothes and hair.

    Nothing is skin if all landmarks lie on it, or no piece has the jaw or the nose.
    """
    number = islands(len(places), faces, border_twins(places, faces))
    skin = pieces_with_face(number, landmarks)[number]
    return skin if not skin[landmarks].all() else np.zeros_like(skin)


def _bound(places: FloatArray, faces: IntArray, picked: Mapping[int, int], paint: Paint | None) -> Binding:
    """Find the landmarks of a head, as `bind_landmarks` does, whatever piece of the mesh they lie on."""
    # 2. to 4. Look, similarity and warps.
    template = load_template()
    try:
        fitted = fit_template(template, places, faces, picked, paint)
    except HeadError as error:
        if picked or len(places) >= _ENOUGH:
            raise
        raise HeadError(TOO_COARSE) from error
    surface, (unit, rotation, _), bent, picked = fitted.view.surface, fitted.pose, fitted.bent, dict(fitted.marks)
    # Vertices nearest to the bent landmarks; marked points override them.
    sight = fitted.sight
    landmarks = _nearest(template, surface, (bent, rotation), _MAX_DISTANCE * unit, sight is not None)
    graph = SurfaceGraph(surface.places, surface.faces)
    # 5. Move landmarks to the rims of openings, and inner lips to their own side.
    landmarks = onto_rims(graph, bent[template.landmarks], landmarks, unit * (_RIM_REACH_SEEN if sight else _RIM_REACH))
    landmarks = onto_corners(graph, surface.faces, landmarks, -rotation[:, 2])
    landmarks[list(picked)] = list(picked.values())
    landmarks = on_own_lip(graph, bent[template.landmarks], landmarks)
    # 6. Symmetry, on a mesh that is its own mirror image.
    mirror = mirror_of(surface.places, rotation, surface.places[landmarks], unit)
    if mirror is not None:
        landmarks = even_landmarks(landmarks, mirror, surface.places, bent[template.landmarks], picked)
        landmarks = on_own_lip(graph, bent[template.landmarks], landmarks, mirror == np.arange(len(mirror)))
    if len(set(landmarks.tolist())) < (_DISTINCT if sight is not None or picked else _DISTINCT_BY_SHAPE) * N_LANDMARKS:
        raise HeadError(TOO_COARSE if sight is not None or picked or len(places) < _ENOUGH else NOT_FOUND)
    turn = rotation.T @ fitted.view.attitude
    points = surface.places[landmarks] @ rotation / unit
    found = fitted.view.part[distinct(graph, landmarks, picked)]
    body = len(fitted.view.part) < _HEAD_SHARE * len(places)
    return Binding(
        landmarks=found,
        rotation=turn,
        residual=fitted.residual,
        strain=fitted.strain,
        symmetric=mirror is not None,
        body=body,
        clarity=sight.clarity if sight else 0.0,
        wanted=() if fitted.sure else _wanted(sight, surface.places[landmarks], picked),
        findings=resting_findings(sight.shape, points) if sight and sight.sure else (),
    )


def _wanted(sight: Sight | None, found: FloatArray, picked: Mapping[int, int]) -> tuple[int, ...]:
    """Return the unmarked points, by iBUG number, for which the places found (66, 3) differ most from those seen.

    If no face is seen, marks alone determine it, and the first of the others are returned; none without marks.
    """
    others = [number for number in MARKS if int(from_ibug([number])[0]) not in picked]
    if sight is not None:
        off = np.linalg.norm(found - sight.points, axis=1)
        others.sort(key=lambda number: -float(off[from_ibug([number])[0]]))
    elif not picked:
        return ()
    return tuple(sorted(others[:MIN_MARKS]))


def _nearest(
    template: Template, surface: Surface, posed: tuple[FloatArray, FloatArray], reach: float, seen: bool
) -> NDArray[np.intp]:
    """Find the vertices nearest to the landmarks of the template, (66,), of which `posed` are the bent vertices and the
    rotation.

    If landmarks were seen, so that they are about right, these are nearest in space among those that face roughly the
    same way; otherwise nearest by position and normal together. If there is none within `reach` at a lid or lip, the
    orientation of the surrounding skin is used: on a mesh without rims, the normal of a rim would lead to the underside
    of something.
    """
    bent, rotation = posed
    wanted = bent[template.landmarks]
    own, around = template.landmark_normals(bent, rotation)
    found = surface.nearest(wanted, own)
    if seen:
        close, distance = surface.close_by(wanted)
        facing = (np.einsum("nkd,nd->nk", surface.normals[close], normals) for normals in (own, around))
        fits = (np.maximum(*facing) > FACING) & (distance < reach)
        found = np.where(fits.any(axis=1), close[np.arange(N_LANDMARKS), fits.argmax(axis=1)], found)
    away = np.linalg.norm(surface.places[found] - wanted, axis=1) > reach
    found[away] = surface.nearest(wanted[away], around[away]) if away.any() else found[away]
    return found


def bind_head(vertices: FloatArray, faces: IntArray, marks: Mapping[int, int] | None = None) -> HeadRig:
    """Make a head of any mesh with a face.

    Parameters
    ----------
    vertices, faces, marks : (V, 3) array, (F, K) array, mapping of int to int
        As for `bind_landmarks`.

    Returns
    -------
    HeadRig
        The head, turned upright and towards the viewer: head frame, unit of `vertices`. All of the mesh counts as skin.

    Raises
    ------
    HeadError
        As `bind_landmarks`.

    Examples
    --------
    >>> from facemime import bind_head, built_in_head
    >>> mesh = built_in_head()
    >>> head = bind_head(mesh.vertices, mesh.faces)
    >>> head.landmarks.shape, head.region_weights.shape
    ((66,), (3, 1781))
    """
    places = as_points(vertices, "vertices", error=HeadError)
    polygons = np.asarray(faces)
    binding = bind_landmarks(places, polygons, marks)
    upright = places @ binding.rotation.T
    landmarks = binding.landmarks
    return HeadRig(
        upright,
        landmarks,
        propose_regions(upright, polygons, landmarks),
        jaw_pivot_of(upright[landmarks]),
        faces=polygons,
    )

"""The corners of eyes that are carved into a closed skin."""

import numpy as np

from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, from_ibug
from facemime.core.heads.landmark_vertices import onto_corners
from facemime.core.mesh.surface import SurfaceGraph
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES
from tests.helpers.scans import scanned


def with_sockets() -> tuple[np.ndarray, np.ndarray]:
    """The head with a closed skin that goes on behind its lids, as on a sculpture with carved eyes."""
    places, faces = [VERTICES], [HEAD.faces[:, :4]]
    count = len(VERTICES)
    for lids in (EYE_RIGHT, EYE_LEFT):
        rim = min(
            SurfaceGraph(VERTICES, HEAD.faces).openings(),
            key=lambda opening: float(np.linalg.norm(VERTICES[opening].mean(axis=0) - POINTS[lids].mean(axis=0))),
        )
        numbers = {int(vertex): count + i for i, vertex in enumerate(rim)}
        rings = [[int(v) for v in face if v >= 0] for face in HEAD.faces]
        edges = {
            (a, b) for ring in rings for a, b in zip(ring, ring[1:] + ring[:1], strict=True) if {a, b} <= set(numbers)
        }
        single = [(a, b) for a, b in edges if (b, a) not in edges]
        middle = VERTICES[rim].mean(axis=0)
        places.append(middle + 1.1 * (VERTICES[rim] - middle) + [0.0, 0.0, 0.15 * UNIT])
        places.append(middle[None] + [0.0, 0.0, 0.2 * UNIT])
        back = count + len(rim)
        faces.append(np.array([[b, a, numbers[a], numbers[b]] for a, b in single]))
        faces.append(np.array([[numbers[b], numbers[a], back, -1] for a, b in single]))
        count = back + 1
    return np.concatenate(places), np.concatenate(faces)


def test_corners_that_fall_short_are_moved_to_where_the_lids_meet_on_a_closed_skin():
    places, faces = with_sockets()
    graph, forward = SurfaceGraph(places, faces), np.array([0.0, 0.0, -1.0])
    assert not [rim for rim in graph.openings() if np.isin(rim, HEAD.landmarks[EYE_RIGHT]).any()]
    np.testing.assert_array_equal(onto_corners(graph, faces, HEAD.landmarks, forward), HEAD.landmarks)
    short = HEAD.landmarks.copy()
    for outer, upper in from_ibug((36, 37, 45, 44)).reshape(2, 2):
        path = graph.path(int(short[outer]), int(short[upper]))
        short[outer] = path[-2]
    assert np.linalg.norm(places[short] - POINTS, axis=1).max() > 0.04 * UNIT
    away = np.linalg.norm(places[onto_corners(graph, faces, short, forward)] - POINTS, axis=1)
    assert away.max() < 0.02 * UNIT


def test_corners_of_open_eyes_and_of_eyes_that_are_one_skin_with_their_lids_stay():
    aside = HEAD.landmarks.copy()
    aside[from_ibug([36])] = aside[from_ibug([37])]
    forward = np.array([0.0, 0.0, -1.0])
    np.testing.assert_array_equal(onto_corners(SurfaceGraph(VERTICES, HEAD.faces), HEAD.faces, aside, forward), aside)
    places, faces = scanned()
    near = np.linalg.norm(places[:, None] - POINTS, axis=2).argmin(axis=0)
    np.testing.assert_array_equal(onto_corners(SurfaceGraph(places, faces), faces, near, forward), near)

"""Triangles that pass through each other."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from facemime.core.mesh.triangles import crossing_pairs


def crosses(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether an edge of one triangle goes through the other, by solving for the point."""
    for edges_of, triangle in ((one, other), (other, one)):
        for k in range(3):
            begin, end = edges_of[k], edges_of[(k + 1) % 3]
            matrix = np.column_stack([begin - end, triangle[1] - triangle[0], triangle[2] - triangle[0]])
            if abs(np.linalg.det(matrix)) < 1e-9:
                continue
            share, u, v = np.linalg.solve(matrix, begin - triangle[0])
            if 1e-6 < share < 1 - 1e-6 and u > 1e-6 and v > 1e-6 and u + v < 1 - 1e-6:
                return True
    return False


@given(arrays(np.float64, (30, 3), elements=st.integers(-20, 20).map(float)))
def test_crossing_pairs_agree_with_a_test_of_all_pairs(places):
    triangles = np.arange(30).reshape(10, 3)
    found = {tuple(sorted(pair)) for pair in crossing_pairs(places, triangles).tolist()}
    known = {(a, b) for a in range(10) for b in range(a + 1, 10) if crosses(places[triangles[a]], places[triangles[b]])}
    assert found == known


def test_neighbours_do_not_count_and_only_moved_triangles_are_tested():
    places = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -1], [0.5, 0.5, 1], [0.6, 0.5, 1.0]])
    triangles = np.array([[0, 1, 2], [3, 4, 5], [0, 4, 5]])
    assert crossing_pairs(places, triangles).tolist() == [[0, 1]]
    assert not len(crossing_pairs(places, triangles, np.array([False, False, True])))
    assert crossing_pairs(places, triangles, np.array([False, True, False])).tolist() == [[0, 1]]
    assert crossing_pairs(places, triangles[:0]).shape == (0, 2)

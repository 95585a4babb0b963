"""The line along which joined lips are cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.errors import HeadError
from facemime.core.face.landmarks import MOUTH_CORNERS, from_ibug
from facemime.core.heads.bind import bind_landmarks
from facemime.core.heads.proposal import propose_regions
from facemime.core.heads.slits import lip_line, lips_joined, rim_landmarks
from facemime.core.mesh.surface import SurfaceGraph
from tests.helpers.scans import HEAD, UNIT, VERTICES, scanned


def test_the_line_follows_edges_between_the_lips_from_corner_to_corner():
    places, faces = scanned()
    landmarks = bind_landmarks(places, faces).landmarks
    graph = SurfaceGraph(places, faces)
    assert lips_joined(graph, landmarks)
    line = lip_line(graph, landmarks)
    assert [line[0], line[-1]] == landmarks[from_ibug((48, 54))].tolist()
    assert len(set(line.tolist())) == len(line)
    assert all(b in graph.neighbours(a) for a, b in pairwise(line.tolist()))
    upper, lower = places[landmarks[from_ibug((51, 57))], 1]
    assert (places[line, 1] > upper).all() and (places[line, 1] < lower).all()
    true = VERTICES[HEAD.landmarks[from_ibug((62, 66))], 1].mean()
    assert abs(places[line[len(line) // 2], 1] - true) < 0.06 * UNIT


def test_no_strip_of_the_lower_region_runs_up_the_cheeks_of_a_scan():
    places, faces = scanned()
    landmarks = bind_landmarks(places, faces).landmarks
    lower = propose_regions(places, faces, landmarks)[2]
    right, left = places[landmarks[MOUTH_CORNERS]]
    inside = (places[:, 0] > right[0] - 0.05 * UNIT) & (places[:, 0] < left[0] + 0.05 * UNIT)
    above = inside & (places[:, 1] < min(right[1], left[1]) - 0.2 * UNIT)
    assert above.sum() > 500 and lower[above].max() < 0.3  # with round-off, landmarks of the lips move by a vertex


def test_a_mouth_with_too_few_vertices_is_refused_with_advice():
    places = np.array([[x, y, 0.0] for y in (0.0, 1.0) for x in range(5)])
    faces = np.array([[i, i + 1, i + 6, i + 5] for i in range(4)])
    landmarks = np.zeros(66, dtype=int)
    landmarks[from_ibug((48, 54))] = 0, 4
    landmarks[from_ibug((61, 62, 63, 65, 66, 67))] = 1, 2, 3, 3, 2, 1
    with pytest.raises(HeadError, match="Subdivide"):
        lip_line(SurfaceGraph(places, faces), landmarks)


@given(st.lists(st.floats(0.01, 5.0), min_size=6, max_size=40))
def test_the_inner_landmarks_of_a_lip_are_three_ordered_vertices_between_the_corners(steps):
    points = np.concatenate([[0.0], np.cumsum(steps)])[:, None] * [[1.0, 0.0, 0.0]]
    chosen = rim_landmarks(points)
    assert (np.diff(chosen) > 0).all()
    assert chosen[0] > 0 and chosen[-1] < len(points) - 1

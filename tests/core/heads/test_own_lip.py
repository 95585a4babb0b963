"""Landmarks of the lips that end on the wrong side of a slit."""

import numpy as np
import pytest

from facemime.core.face.landmarks import LOWER_LIP, UPPER_LIP
from facemime.core.heads.landmark_vertices import on_own_lip
from facemime.core.mesh.surface import SurfaceGraph
from tests.helpers.built_in import HEAD, POINTS, UNIT, VERTICES


@pytest.mark.parametrize("swapped", [(0,), (1, 2), (0, 1, 2, 3, 4)])
@pytest.mark.parametrize(("own", "other"), [(LOWER_LIP, UPPER_LIP), (UPPER_LIP, LOWER_LIP)])
def test_outer_landmarks_that_ended_on_the_other_lip_return_to_their_own(own, other, swapped):
    graph = SurfaceGraph(VERTICES, HEAD.faces)
    crossed = HEAD.landmarks.copy()
    crossed[own[list(swapped)]] = crossed[other[list(swapped)]]
    found = on_own_lip(graph, POINTS, crossed)
    away = np.linalg.norm(VERTICES[found] - POINTS, axis=1)
    assert away.max() < 0.03 * UNIT


def test_landmarks_on_their_own_lips_stay():
    graph = SurfaceGraph(VERTICES, HEAD.faces)
    np.testing.assert_array_equal(on_own_lip(graph, POINTS, HEAD.landmarks), HEAD.landmarks)

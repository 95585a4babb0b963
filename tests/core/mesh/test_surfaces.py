"""Paths along a surface, and warps between meshes."""

import numpy as np
import pytest

from facemime.core.errors import HeadError
from facemime.core.mesh.kernels import Warp
from facemime.core.mesh.surface import SurfaceGraph


def test_paths_along_a_strip_go_around_its_slit():
    # two rows of squares, joined at the left end only
    x = np.arange(6.0)
    top, bottom = np.stack([x, 0 * x, 0 * x], 1), np.stack([x, 0.1 + 0 * x, 0 * x], 1)
    outer_top, outer_bottom = top - [0, 1, 0], bottom + [0, 1, 0]
    vertices = np.concatenate([outer_top, top, bottom, outer_bottom])
    quads = [[r * 6 + i, r * 6 + i + 1, (r + 1) * 6 + i + 1, (r + 1) * 6 + i] for r in (0, 2) for i in range(5)]
    quads.append([6, 12, 12, 6])
    graph = SurfaceGraph(vertices, np.array(quads))
    assert graph.path_lengths([11])[17] == pytest.approx(10.1)
    assert graph.path(11, 17) == [*range(11, 5, -1), *range(12, 18)]
    assert np.isinf(graph.path_lengths([11], limit=3.0)[17])


def test_a_warp_meets_its_points_and_reproduces_affine_maps():
    rng = np.random.default_rng(0)
    source, elsewhere = rng.normal(size=(20, 3)), rng.normal(size=(50, 3))
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    warp = Warp(source, source @ matrix + shift, smoothing=0.0)
    np.testing.assert_allclose(warp(elsewhere), elsewhere @ matrix + shift, atol=1e-8)
    bent = source + rng.normal(0.0, 0.1, source.shape)
    np.testing.assert_allclose(Warp(source, bent, smoothing=0.0)(source), bent, atol=1e-8)


def test_a_warp_between_coplanar_points_is_refused():
    flat = np.random.default_rng(0).normal(size=(20, 3)) * [1, 1, 0]
    with pytest.raises(HeadError, match="lie in one plane"):
        Warp(flat, flat, smoothing=0.0)

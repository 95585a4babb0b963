"""The product of a frame equals the plain dense product, in whatever order the vertices are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.drive.blocks import TOLERANCE, BlockProduct, RegionMatrix
from facemime.core.heads.kernels import distances, gaussian


def random_regions(rng: np.random.Generator, count: int, points: int) -> list[RegionMatrix]:
    """Three overlapping regions of random vertices and control points."""
    regions = []
    for _ in range(3):
        rows = np.flatnonzero(rng.random(count) < 0.4)
        columns = rng.permutation(points)[: max(1, points // 2)]
        regions.append(RegionMatrix(rows, columns, rng.normal(size=(len(rows), len(columns))).astype(np.float32)))
    return regions


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.sampled_from([3, 50, 2_000, 12_000]), st.sampled_from([3, 20, 66]))
def test_blocks_equal_the_dense_matrix(seed, count, points):
    rng = np.random.default_rng(seed)
    rest = rng.normal(size=(count, 3)).astype(np.float32)
    regions = random_regions(rng, count, points)
    dense = np.zeros((count, points), np.float32)
    for region in regions:
        dense[np.ix_(region.rows, region.columns)] += region.matrix
    product = BlockProduct(rest, regions, points)
    out = np.empty_like(rest)
    for _ in range(2):
        moved = rng.normal(size=(points, 3)).astype(np.float32)
        product.apply(moved, out)
        np.testing.assert_allclose(out, rest + dense @ moved, atol=1e-3)


@pytest.mark.parametrize(("count", "most"), [(1781, 2.2), (26_000, 1.5), (100_000, 1.2)])
def test_blocks_take_little_more_memory_than_the_regions(count, most):
    rng = np.random.default_rng(0)
    rest = rng.normal(size=(count, 3)).astype(np.float32)
    side = rest[:, 0] > 0
    regions = [
        RegionMatrix(rows, columns, np.ones((len(rows), len(columns)), np.float32))
        for rows, columns in ((np.flatnonzero(side), np.arange(30)), (np.flatnonzero(~side), np.arange(30, 60)))
    ]
    product = BlockProduct(rest, regions, 60)
    assert product.nbytes < most * sum(region.matrix.nbytes for region in regions)


@settings(max_examples=5)
@given(st.integers(0, 10_000))
def test_smooth_fields_take_half_the_memory_within_the_tolerance(seed):
    rng = np.random.default_rng(seed)
    rest = (rng.uniform(size=(30_000, 3)) * [1.0, 1.0, 0.1]).astype(np.float32)
    centres = rest[:60]
    matrix = gaussian(distances(rest, centres), 0.3).astype(np.float32)
    product = BlockProduct(rest, [RegionMatrix(np.arange(30_000), np.arange(60), matrix)], 60)
    assert product.nbytes < 0.5 * matrix.nbytes
    moved = rng.normal(size=(60, 3)).astype(np.float32)
    out = np.empty_like(rest)
    product.apply(moved, out)
    off = np.linalg.norm(out - rest - matrix @ moved, axis=1)
    assert off.max() < TOLERANCE * np.linalg.norm(moved) + 1e-5

"""Products of matrices without a BLAS."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from facemime.core.numeric import products
from facemime.core.numeric.products import dot, multiply


@pytest.mark.parametrize("shape", [(1, 1, 1), (5, 7, 3), (66, 5343, 80), (300, 40, 1), (0, 4, 3), (4, 0, 3), (4, 3, 0)])
def test_products_equal_those_of_numpy_in_double_precision(shape) -> None:
    rows, inner, columns = shape
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(rows, inner)), rng.normal(size=(inner, columns))
    bound = 1e-6 * np.abs(left) @ np.abs(right) + 1e-9
    assert (np.abs(multiply(left, right) - left @ right) <= bound).all()
    assert (np.abs(multiply(left, right.T, transposed=True) - left @ right) <= bound).all()
    assert multiply(left, right).dtype == np.float32


@pytest.mark.parametrize("shape", [(213,), (2, 257), (3, 4, 5)])
def test_small_products_equal_those_of_numpy(shape) -> None:
    rng = np.random.default_rng(5)
    left, matrix = rng.normal(size=shape), rng.normal(size=(shape[-1], 7))
    np.testing.assert_allclose(dot(left, matrix), left @ matrix, atol=1e-12)
    np.testing.assert_allclose(dot(left, matrix[:, 0]), left @ matrix[:, 0], atol=1e-12)


def test_earlier_products_keep_their_values_and_inputs_are_not_changed() -> None:
    rng = np.random.default_rng(1)
    left, right = rng.normal(size=(2, 6, 6)).astype(np.float32)
    first, expected = multiply(left, right), left @ right
    kept = left.copy()
    multiply(right, left)
    np.testing.assert_allclose(first, expected, atol=1e-5)
    np.testing.assert_array_equal(left, kept)


def test_threads_multiply_at_once() -> None:
    rng = np.random.default_rng(2)
    pairs = rng.normal(size=(4, 50, 2, 30, 30)).astype(np.float32)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda some: [multiply(a, b) for a, b in some], pairs))
    np.testing.assert_allclose(np.array(found), pairs[:, :, 0] @ pairs[:, :, 1], atol=1e-4)


def test_a_large_product_leaves_no_buffers_behind() -> None:
    large = np.ones((2_000, 2_000), np.float32)
    np.testing.assert_array_equal(multiply(large, large), np.full((2_000, 2_000), 2_000.0))
    assert getattr(products._KEPT, "2 False") is None
    small = np.eye(3, dtype=np.float32)
    multiply(small, small)
    kept = getattr(products._KEPT, "2 False")
    np.testing.assert_array_equal(multiply(2.0 * small, small), 2.0 * small)
    assert kept is not None and getattr(products._KEPT, "2 False") is kept

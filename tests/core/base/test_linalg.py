"""Linear algebra by scipy, in several threads and with any numpy."""

import ast
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from facemime.core.base import linalg
from facemime.core.base.linalg import multiply

ROOT = Path(__file__).resolve().parents[3]
ROOMS = ("core", "blender", "cli", "settings", "sessions", "operators", "ui")
WITHOUT_LAPACK = {"norm", "matrix_power", "LinAlgError"}
"""What numpy computes without LAPACK; of norms, those of vectors."""
SHAPES = [(1, 1, 1), (5, 7, 3), (66, 5343, 80), (300, 40, 1), (0, 4, 3), (4, 0, 3), (4, 3, 0)]


@pytest.mark.parametrize("precision", [np.float32, np.float64])
@pytest.mark.parametrize("shape", SHAPES)
def test_products_equal_those_of_numpy_whatever_the_order_in_memory(shape, precision) -> None:
    rows, inner, columns = shape
    rng = np.random.default_rng(0)
    left, right = rng.normal(size=(rows, inner)).astype(precision), rng.normal(size=(inner, columns)).astype(precision)
    expected = left.astype(np.float64) @ right.astype(np.float64)
    bound = 4.0 * np.finfo(precision).eps * inner * np.abs(left).max(initial=0.0) * np.abs(right).max(initial=0.0)
    for a in (left, np.asfortranarray(left), np.repeat(left, 2, axis=1)[:, ::2]):
        for b in (right, np.asfortranarray(right), np.repeat(right, 2, axis=1)[:, ::2]):
            product = multiply(a, b)
            assert product.dtype == precision and product.shape == expected.shape
            assert np.abs(product - expected).max(initial=0.0) <= bound


@pytest.mark.parametrize("order", ["C", "F"])
def test_products_with_vectors_equal_those_of_numpy(order) -> None:
    rng = np.random.default_rng(5)
    matrix = np.asarray(rng.normal(size=(9, 7)), order=order)
    left, right = rng.normal(size=9), rng.normal(size=7)
    np.testing.assert_allclose(multiply(left, matrix), left @ matrix, atol=1e-12)
    np.testing.assert_allclose(multiply(matrix, right), matrix @ right, atol=1e-12)
    np.testing.assert_allclose(multiply(matrix, matrix[4]), matrix @ matrix[4], atol=1e-12)


def test_a_product_is_as_precise_as_the_less_precise_matrix() -> None:
    single, double = np.eye(3, dtype=np.float32), np.eye(3)
    assert multiply(single, double).dtype == multiply(double, single).dtype == np.float32
    assert multiply(double, double).dtype == np.float64


def test_threads_get_the_results_of_a_single_one() -> None:
    rng = np.random.default_rng(0)
    systems = rng.normal(size=(4, 200, 12, 12)) + 20.0 * np.eye(12)

    def work(many):
        return [multiply(linalg.inv(matrix), matrix) for matrix in many]

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(work, systems))
    np.testing.assert_array_equal(np.array(found), np.array([work(many) for many in systems]))


@pytest.mark.parametrize("shift", [0.0, -2.0])
def test_a_symmetric_system_is_solved_whether_it_is_definite_or_not(shift) -> None:
    rng = np.random.default_rng(3)
    half, wanted = rng.normal(size=(9, 6)), rng.normal(size=6)
    matrix = half.T @ half + shift * np.eye(6)
    kept = matrix.copy()
    assert (np.linalg.eigvalsh(matrix).min() > 0.0) == (shift == 0.0)
    np.testing.assert_allclose(linalg.solve_definite(matrix, matrix @ wanted), wanted, atol=1e-9)
    np.testing.assert_array_equal(matrix, kept)


def test_a_singular_system_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        linalg.solve_definite(np.zeros((3, 3)), np.ones(3))


def test_small_matrices_are_inverted_as_a_stack() -> None:
    matrices = np.random.default_rng(4).normal(size=(5, 2, 3, 3)) + 3.0 * np.eye(3)
    np.testing.assert_allclose(linalg.inverses_of_three(matrices), np.linalg.inv(matrices), atol=1e-12)


def test_only_scipys_own_blas_is_limited_to_one_thread() -> None:
    code = (
        "from threadpoolctl import threadpool_info\n"
        "from facemime.core.base import linalg\n"
        "import numpy, sys\n"
        "before = {i['filepath']: i['num_threads'] for i in threadpool_info()}\n"
        "assert 'scipy' not in sys.modules\n"
        "linalg.eigh(numpy.eye(2))\n"
        "for i in threadpool_info():\n"
        "    own = 'scipy.libs' in i['filepath']\n"
        "    assert i['num_threads'] == (1 if own else before[i['filepath']]), i\n"
        "    print('scipy' if own else 'other')\n"
    )
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "2")
    environment = {"PATH": "/usr/bin:/bin", **threads}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0 and "scipy" in done.stdout and "other" in done.stdout, done.stderr


def test_no_module_uses_lapack_but_through_this_one() -> None:
    found = []
    for path in (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            past = isinstance(node, ast.Attribute) and ast.unparse(node.value) == "np.linalg"
            past = past and node.attr not in WITHOUT_LAPACK
            past |= isinstance(node, ast.ImportFrom | ast.Import) and "scipy.linalg" in ast.unparse(node)
            if past and path.name != "linalg.py":
                found.append(f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)}")
    assert found == []

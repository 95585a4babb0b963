"""Linear algebra in several threads, with a numpy that has no LAPACK of its own."""

import ast
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from time import sleep

import numpy as np
import pytest

from facemime.core.numeric import linalg

ROOT = Path(__file__).resolve().parents[3]
ROOMS = ("core", "blender", "cli", "settings", "sessions", "operators", "ui")
WITHOUT_LAPACK = {"norm", "matrix_power", "LinAlgError"}
"""What numpy computes without LAPACK; of norms, those of vectors."""


def test_two_threads_are_never_in_lapack_at_once() -> None:
    inside, most, start = [], [], Barrier(4)

    def visit(_: int) -> None:
        inside.append(1)
        most.append(len(inside))
        sleep(0.001)
        inside.pop()

    guarded = [linalg._alone(visit) for _ in range(4)]

    def work(i: int) -> None:
        start.wait()
        for turn in range(20):
            guarded[i](turn)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    assert len(most) == 80 and max(most) == 1


def test_threads_get_the_results_of_a_single_one() -> None:
    rng = np.random.default_rng(0)
    systems = rng.normal(size=(4, 200, 12, 12)) + 20.0 * np.eye(12)
    expected = np.linalg.inv(systems)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda many: [linalg.inv(matrix) for matrix in many], systems))
    np.testing.assert_array_equal(np.array(found), expected)


@pytest.mark.parametrize("shift", [0.0, -2.0])
def test_a_symmetric_system_is_solved_whether_it_is_definite_or_not(shift) -> None:
    rng = np.random.default_rng(3)
    half, wanted = rng.normal(size=(9, 6)), rng.normal(size=6)
    matrix = half.T @ half + shift * np.eye(6)
    assert (np.linalg.eigvalsh(matrix).min() > 0.0) == (shift == 0.0)
    np.testing.assert_allclose(linalg.solve_definite(matrix, matrix @ wanted), wanted, atol=1e-9)


def test_a_singular_system_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        linalg.solve_definite(np.zeros((3, 3)), np.ones(3))


def test_no_module_calls_lapack_past_the_guard() -> None:
    found = []
    for path in (path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            past = isinstance(node, ast.Attribute) and ast.unparse(node.value) == "np.linalg"
            if past and node.attr not in WITHOUT_LAPACK and path.name != "linalg.py":
                found.append(f"{path.relative_to(ROOT)}:{node.lineno} np.linalg.{node.attr}")
    assert found == []

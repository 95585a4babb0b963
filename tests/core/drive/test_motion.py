"""The motion of a take, its basis, and the selection of its most distinct frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.fit import fit_basis, fit_positive_basis
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver, HeadMotion, drive_take, select_distinct_frames
from facemime.core.face.names import N_ACTIONS
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.neutral import calibrate
from tests.helpers.takes import performance


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 8), st.floats(0.001, 0.3))
def test_the_basis_keeps_every_vertex_of_every_frame_within_the_tolerance(seed, rank, tolerance):
    rng = np.random.default_rng(seed)
    motion = np.einsum("nk,kvd->nvd", rng.normal(size=(40, rank)), rng.normal(size=(rank, 50, 3))).astype(np.float32)
    basis = fit_basis(motion, tolerance)
    rebuilt = np.einsum("nk,kvd->nvd", basis.weights, basis.modes)
    worst = np.linalg.norm(rebuilt - motion, axis=2).max()
    assert len(basis.modes) <= rank
    assert worst <= tolerance + 1e-4
    np.testing.assert_allclose(worst, basis.worst_error, atol=1e-4)
    assert np.abs(basis.weights).max(initial=0.0) <= 1.0 + 1e-6


@settings(max_examples=5)
@given(st.integers(0, 10_000))
def test_the_modes_of_a_long_motion_are_as_few_as_those_of_singular_vectors(seed):
    rng = np.random.default_rng(seed)
    amounts = rng.normal(size=(500, 60)) * 0.8 ** np.arange(60)
    motion = np.einsum("nk,kvd->nvd", amounts, rng.normal(size=(60, 100, 3))).astype(np.float32)
    basis = fit_basis(motion, 0.05, max_modes=60)
    left, values, right = np.linalg.svd(motion.reshape(500, -1), full_matrices=False)
    best = left[:, : len(basis.modes)] * values[: len(basis.modes)] @ right[: len(basis.modes)]
    away = np.linalg.norm(best.reshape(motion.shape) - motion, axis=2).max()
    assert basis.worst_error <= 0.05 and basis.worst_error <= 1.05 * away + 1e-4
    rebuilt = np.einsum("nk,kvd->nvd", basis.weights, basis.modes)
    np.testing.assert_allclose(np.linalg.norm(rebuilt - motion, axis=2).max(), basis.worst_error, atol=1e-4)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 8), st.integers(2, 20))
def test_a_positive_basis_has_weights_of_0_to_1_and_shows_the_same_motion(seed, rank, most):
    rng = np.random.default_rng(seed)
    motion = np.einsum("nk,kvd->nvd", rng.normal(size=(40, rank)), rng.normal(size=(rank, 50, 3))).astype(np.float32)
    basis = fit_positive_basis(motion, 1e-3, max_modes=most)
    assert len(basis.modes) <= most
    assert basis.weights.min(initial=0.0) >= 0.0 and basis.weights.max(initial=0.0) <= 1.0
    rebuilt = np.einsum("nk,kvd->nvd", basis.weights, basis.modes)
    assert np.linalg.norm(rebuilt - motion, axis=2).max() <= basis.worst_error + 0.1
    if most >= 2 * rank:
        assert basis.worst_error <= 1e-3


def test_a_motion_at_rest_needs_no_mode():
    for fit in (fit_basis, fit_positive_basis):
        basis = fit(np.zeros((10, 5, 3), np.float32), 0.01)
        assert basis.modes.shape == (0, 5, 3) and basis.weights.shape == (10, 0) and basis.worst_error == 0.0


def test_the_error_reveals_too_few_modes():
    motion = np.random.default_rng(0).normal(size=(20, 30, 3)).astype(np.float32)
    basis = fit_basis(motion, 1e-6, max_modes=3)
    assert len(basis.modes) == 3 and basis.worst_error > 0.1


@pytest.mark.parametrize("options", [DriveSettings(), DriveSettings(mirror=True), DriveSettings(only_landmarks=True)])
def test_the_motion_of_a_take_is_that_of_its_frames_one_after_the_other(options):
    take, rig = performance(), built_in_head()
    take.actions[:] = np.random.default_rng(2).random(take.actions.shape)
    take.actions[::5] = np.nan
    drivers = [HeadDriver(rig, calibrate(take), options) for _ in range(2)]
    motion, found = drive_take(drivers[0], take), np.flatnonzero(take.found)
    assert len(motion.times) == len(found) < len(take)
    for row, frame in enumerate(found):
        shown = drivers[1].frame(take.result(int(frame)))
        np.testing.assert_allclose(motion.vertices[row] + drivers[0].rest, shown.vertices, atol=1e-6)
        for name in ("rotation", "translation", "jaw", "gaze", "actions"):
            np.testing.assert_allclose(getattr(motion, name)[row], getattr(shown, name), atol=1e-9, err_msg=name)


def test_the_most_distinct_frames_show_each_expression_once():
    poses = np.random.default_rng(1).normal(size=(4, 20, 3))
    vertices = np.repeat(poses, 10, axis=0).astype(np.float32)
    count = len(vertices)
    eye = np.tile(np.eye(3), (count, 1, 1))
    motion = HeadMotion(
        np.arange(count) / 25.0, vertices, eye, np.zeros((count, 3)), eye, eye, np.zeros((count, N_ACTIONS))
    )
    assert (select_distinct_frames(motion, 4) // 10).tolist() == [0, 1, 2, 3]
    assert len(select_distinct_frames(motion, 100)) == count

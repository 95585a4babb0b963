"""Properties of deformers with any kernel."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.base.errors import HeadError
from facemime.core.base.landmarks import MIRROR
from facemime.core.base.rotation import euler_to_matrix
from facemime.core.drive.head_deformer import INFORMED, head_deformer
from facemime.core.drive.rbf import IncrementalDeformer, RBFDeformer
from facemime.core.heads.kernels import KERNELS, distances
from facemime.core.heads.regions import membership, region_sigmas
from facemime.core.heads.rig import HeadRig, built_in_head

ALL_KERNELS = [INFORMED, *KERNELS]
RIG = built_in_head()
LANDMARKS = np.asarray(RIG.vertices, float)[RIG.landmarks]
UNIT = 0.09


def motion(seed: int) -> np.ndarray:
    """Random displacements (66, 3) of up to some millimetres."""
    return np.random.default_rng(seed).normal(0.0, 0.003, (66, 3))


@pytest.fixture(scope="module", params=ALL_KERNELS)
def deformer(request):
    return head_deformer(RIG, request.param)


@settings(max_examples=15)
@given(st.integers(0, 10_000))
@pytest.mark.parametrize("kernel", list(KERNELS))
def test_control_points_are_met_exactly_without_regularisation(kernel, seed):
    sigma = region_sigmas(LANDMARKS, KERNELS[kernel])
    shares = np.maximum(np.asarray(RIG.region_weights), 1e-3)
    exact = RBFDeformer(
        LANDMARKS, LANDMARKS, shares[:, RIG.landmarks] * membership(), membership(),
        kernel=kernel, sigma=sigma, regularisation=0.0,
    )  # fmt: skip
    moving = (shares[:, RIG.landmarks] * membership()).sum(axis=0) >= 0.999
    moved = exact.deform(motion(seed))[moving] - LANDMARKS[moving]
    np.testing.assert_allclose(moved, motion(seed)[moving], atol=1e-5)


def test_a_motionless_face_stays_at_rest(deformer):
    np.testing.assert_array_equal(deformer.deform(np.zeros((66, 3))), deformer.rest)


@pytest.mark.parametrize("kernel", ALL_KERNELS)
def test_deformation_commutes_with_rigid_motion_of_the_rest_mesh(kernel):
    turn, shift = euler_to_matrix(2.0, 1.0, -2.5), np.array([0.3, -0.2, 1.0])
    displaced = motion(1)
    plain = head_deformer(RIG, kernel).deform(displaced)
    moved_rig = replace(RIG, vertices=np.asarray(RIG.vertices, float) @ turn.T + shift)
    moved = head_deformer(moved_rig, kernel).deform(displaced @ turn.T)
    np.testing.assert_allclose(moved, plain @ turn.T + shift, atol=1e-5)


@pytest.mark.parametrize("kernel", ALL_KERNELS)
def test_a_mirrored_motion_gives_a_mirrored_face(kernel):
    flip = np.array([-1.0, 1.0, 1.0])
    rest = np.asarray(RIG.vertices, float)
    mirror = distances(rest * flip, rest).argmin(axis=1)
    even = replace(RIG, region_weights=(RIG.region_weights + RIG.region_weights[:, mirror]) / 2.0)
    deformer = head_deformer(even, kernel)
    one = deformer.deform(motion(2))
    other = deformer.deform((motion(2) * flip)[MIRROR])
    tolerance = 3e-4 if kernel == INFORMED else 1e-5  # the learnt head is not quite symmetric
    np.testing.assert_allclose(other, one[mirror] * flip, atol=tolerance)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 60))
def test_another_control_point_never_worsens_the_error_at_the_control_points(seed, count):
    rng = np.random.default_rng(seed)
    points, moved = rng.uniform(0.0, 1.0, (61, 3)), rng.normal(0.0, 0.1, (61, 3))
    used = slice(0, count)

    def error(chosen: slice) -> float:
        weights, members = np.ones((1, len(points))), np.ones((1, len(points[chosen])), bool)
        deformer = RBFDeformer(points, points[chosen], weights, members, sigma=0.1, regularisation=0.0)
        return float(np.abs(deformer.deform(moved[chosen])[used] - points[used] - moved[used]).max())

    assert error(slice(0, count + 1)) <= error(used) + 1e-4


def test_one_control_point_moves_its_region_at_most_as_far_as_itself():
    vertices = np.random.default_rng(0).uniform(0.0, 1.0, (50, 3))
    deformer = RBFDeformer(vertices, vertices[:1], np.ones((1, 50)), np.ones((1, 1), bool), regularisation=0.0)
    moved = deformer.deform([[0.1, 0.0, 0.0]]) - deformer.rest
    assert moved[0, 0] == pytest.approx(0.1, abs=1e-5)
    assert np.abs(moved[:, 0]).max() <= 0.1 + 1e-5


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_displacements_that_are_not_finite_are_refused(deformer, value):
    broken = motion(0)
    broken[5, 1] = value
    with pytest.raises(Exception, match="displacements must be finite; 1 rows are not, first row 5"):
        deformer.deform(broken)


def test_an_unknown_kernel_is_refused_with_the_known_ones():
    with pytest.raises(HeadError, match=r"no kernel 'magic'\. Choose one of gaussian, multiscale"):
        head_deformer(RIG, "magic")


def test_the_fit_reports_sigma_and_condition_of_each_region(deformer):
    assert len(deformer.fits) == 3
    for fit in deformer.fits:
        assert fit.sigma > 0.0 and 1.0 <= fit.condition < 1e10


def test_the_incremental_deformer_starts_equal_and_depends_on_the_path():
    incremental = head_deformer(RIG, "gaussian", incremental=True)
    assert isinstance(incremental, IncrementalDeformer)
    plain = head_deformer(RIG, "gaussian")
    np.testing.assert_allclose(incremental.deform(motion(4)), plain.deform(motion(4)), atol=1e-6)
    after_detour = incremental.deform(motion(5))
    incremental.reset()
    np.testing.assert_allclose(incremental.deform(motion(5)), plain.deform(motion(5)), atol=1e-6)
    assert np.abs(after_detour - plain.deform(motion(5))).max() > 1e-4


def test_the_informed_kernel_depends_neither_on_the_unit_nor_on_the_order_of_the_vertices():
    order = np.random.default_rng(0).permutation(len(RIG.vertices))
    place = np.argsort(order)
    shuffled = replace(
        RIG,
        vertices=100.0 * np.asarray(RIG.vertices, float)[order],
        landmarks=place[RIG.landmarks],
        region_weights=np.asarray(RIG.region_weights)[:, order],
        faces=np.where(RIG.faces < 0, -1, place[RIG.faces]),
    )
    moved = head_deformer(shuffled).deform(100.0 * motion(6))
    np.testing.assert_allclose(moved / 100.0, head_deformer(RIG).deform(motion(6))[order], atol=2e-6)
    assert np.abs(moved / 100.0 - head_deformer(RIG, "multiscale").deform(motion(6))[order]).max() > 1e-4


def test_a_mesh_without_faces_stays_between_its_landmarks():
    coarse = np.unique(np.concatenate([RIG.landmarks, np.arange(0, 1781, 3)]))
    place = {int(v): i for i, v in enumerate(coarse)}
    part = HeadRig(
        np.asarray(RIG.vertices)[coarse] * 100.0,
        np.array([place[int(v)] for v in RIG.landmarks]),
        np.asarray(RIG.region_weights)[:, coarse],
        np.zeros(3),
    )
    displaced = motion(6) * 100.0
    moved = head_deformer(part).deform(displaced) - np.asarray(part.vertices)
    assert np.linalg.norm(moved, axis=1).max() < 3.0 * np.linalg.norm(displaced, axis=1).max()


@pytest.mark.parametrize("out", [np.empty((1781, 3)), np.empty((3, 1781), np.float32).T, np.empty((5, 3), np.float32)])
def test_a_result_is_written_to_the_given_array_or_refused(deformer, out):
    with pytest.raises(ValueError, match="out must be"):
        deformer.deform(motion(0), out)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan])
def test_an_invalid_width_is_refused(sigma):
    points = np.random.default_rng(0).uniform(size=(5, 3))
    with pytest.raises(HeadError, match="sigma must be positive"):
        RBFDeformer(points, points, np.ones((1, 5)), np.ones((1, 5), bool), sigma=sigma)

"""The partitioned Gaussian RBF."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.base.errors import HeadError
from facemime.core.base.landmarks import from_ibug
from facemime.core.drive.rbf import RBFDeformer
from facemime.core.heads.regions import REGIONS, membership


def cloud(seed: int, count: int = 400, points: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in a unit cube, and control points, well apart, among them."""
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(0.0, 1.0, (count, 3))
    chosen = [0]
    while len(chosen) < points:
        distance = np.linalg.norm(vertices[:, None] - vertices[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return vertices, np.array(chosen)


def single_region(vertices: np.ndarray, chosen: np.ndarray, **options: float) -> RBFDeformer:
    """A single region that covers everything."""
    return RBFDeformer(
        vertices, vertices[chosen], np.ones((1, len(vertices))), np.ones((1, len(chosen)), dtype=bool), **options
    )


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_regularisation_hardly_moves_control_points_from_their_places(seed):
    vertices, chosen = cloud(seed)
    displacements = np.random.default_rng(seed + 1).normal(0.0, 0.1, (len(chosen), 3))
    nearly = single_region(vertices, chosen).deform(displacements)
    assert np.abs(nearly[chosen] - vertices[chosen] - displacements).max() < 0.1 * np.abs(displacements).max()


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.floats(-3.0, 3.0))
def test_deformation_is_linear_in_the_displacements(seed, factor):
    vertices, chosen = cloud(seed)
    deformer = single_region(vertices, chosen)
    rng = np.random.default_rng(seed + 1)
    a, b = rng.normal(0.0, 0.1, (2, len(chosen), 3))
    together = deformer.deform(a + factor * b) - deformer.rest
    apart = (deformer.deform(a) - deformer.rest) + factor * (deformer.deform(b) - deformer.rest)
    np.testing.assert_allclose(together, apart, atol=1e-5)


def test_a_region_does_not_move_the_vertices_of_another():
    vertices, chosen = cloud(3)
    weights = np.stack([vertices[:, 1] < 0.5, vertices[:, 1] >= 0.5]).astype(float)
    members = weights[:, chosen] > 0
    deformer = RBFDeformer(vertices, vertices[chosen], weights, members)
    displacements = np.where(members[0][:, None], 0.1, 0.0) * np.ones((len(chosen), 3))
    moved = deformer.deform(displacements) - deformer.rest
    assert np.abs(moved[weights[1] > 0]).max() == 0.0
    assert np.abs(moved[weights[0] > 0]).max() > 0.05


def test_a_vertex_of_two_regions_takes_their_weighted_mean():
    vertices, chosen = cloud(4)
    members = np.zeros((2, len(chosen)), dtype=bool)
    members[0, ::2] = members[1, 1::2] = True
    displacements = np.random.default_rng(0).normal(0.0, 0.1, (len(chosen), 3))

    def moved(first: float, second: float) -> np.ndarray:
        weights = np.outer([first, second], np.ones(len(vertices)))
        deformer = RBFDeformer(vertices, vertices[chosen], weights, members)
        return deformer.deform(displacements) - deformer.rest

    expected = 0.75 * moved(1.0, 0.0) + 0.25 * moved(0.0, 1.0)
    np.testing.assert_allclose(moved(3.0, 1.0), expected, atol=1e-5)


def test_a_vertex_in_no_region_does_not_move():
    vertices, chosen = cloud(5)
    weights = np.ones((1, len(vertices)))
    weights[0, 7] = 0.0
    deformer = RBFDeformer(vertices, vertices[chosen], weights, np.ones((1, len(chosen)), dtype=bool))
    moved = deformer.deform(np.full((len(chosen), 3), 0.2))
    np.testing.assert_array_equal(moved[7], deformer.rest[7])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v, c, w, m: (v, np.vstack([c[:-1], c[:1]]), w, m), "coincides with another"),
        (lambda v, c, w, m: (np.where(v > 0.9, np.nan, v), c, w, m), "must be finite"),
        (lambda v, c, w, m: (v, c, 0 * w, m), "No vertex lies in a region"),
        (lambda v, c, w, m: (v, c, w, m & False), "no control points"),
        (lambda v, c, w, m: (v, c, w[:, :-1], m), "region_weights must be"),
        (lambda v, c, w, m: (v, c, -w, m), "not negative"),
    ],
)
def test_degenerate_input_is_refused_with_a_message(spoil, message):
    vertices, chosen = cloud(6)
    weights, members = np.ones((1, len(vertices))), np.ones((1, len(chosen)), dtype=bool)
    with pytest.raises(HeadError, match=message):
        RBFDeformer(*spoil(vertices, vertices[chosen], weights, members))


def test_an_ill_conditioned_fit_is_refused_with_its_condition_number():
    vertices, chosen = cloud(7)
    with pytest.raises(HeadError, match=r"condition number \d"):
        single_region(vertices, chosen, sigma=100.0, regularisation=0.0)


def test_every_landmark_controls_a_region_and_only_slit_ends_and_the_bridge_control_two():
    counts = membership().sum(axis=0)
    assert counts.min() == 1
    np.testing.assert_array_equal(np.flatnonzero(counts == 2), np.sort(from_ibug((36, 39, 42, 45, 27, 28, 48, 54))))
    assert [len(region.landmarks) for region in REGIONS] == [20, 35, 19]

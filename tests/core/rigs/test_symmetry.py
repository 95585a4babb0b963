"""Controls that mirror each other, on the built-in head."""

import numpy as np
import pytest

from facemime.core.heads.rig import built_in_head
from facemime.core.heads.symmetry import face_images, symmetry_of
from facemime.core.rigs.rig_map import LOCATION, Probe, RigChannel, even_probes, map_of
from facemime.core.rigs.solver import RigSolver

HEAD = built_in_head()
UNIT = HEAD.eye_distance


@pytest.fixture(scope="module")
def sample():
    face = np.flatnonzero(HEAD.region_weights.sum(axis=0) > 0.0)
    images = face_images(HEAD.vertices, HEAD.landmarks, face)
    half = np.setdiff1d(face[::8], HEAD.landmarks)
    others = np.setdiff1d(np.union1d(half, images[np.searchsorted(face, half)]), HEAD.landmarks)
    return np.concatenate([HEAD.landmarks, others])


def rig(sample, symmetry, noise):
    """Channels and probes of ten pairs of bones, the second of each the mirror image of the first, not quite."""
    random = np.random.default_rng(5)
    places = HEAD.vertices[sample]
    channels, probes = [], []
    for pair in range(10):
        near = np.exp(-np.square((places - places[random.integers(len(places))]) / (0.3 * UNIT)).sum(axis=1))
        moved = 0.1 * UNIT * near[:, None] * random.normal(size=3)
        for name, effect in (("a", moved), ("b", symmetry.mirrored(moved))):
            channels.append(RigChannel("Rig", f"{name}{pair}", LOCATION, unit=UNIT))
            both = [sign * effect + noise * UNIT * random.normal(size=effect.shape) for sign in (1.0, -1.0)]
            probes.append([Probe(0.1, both[0]), Probe(-0.1, both[1])])
    return channels, probes


def test_the_built_in_head_is_its_own_mirror_image(sample):
    symmetry = symmetry_of(HEAD.vertices, HEAD.landmarks, sample)
    places = HEAD.vertices[sample]
    centre = HEAD.vertices[HEAD.landmarks].mean(axis=0)
    np.testing.assert_allclose(symmetry.mirrored(places - centre), places - centre, atol=0.02 * UNIT)
    np.testing.assert_allclose(symmetry.mirrored(symmetry.mirrored(places)), places, atol=1e-9)


def test_a_head_that_is_not_symmetric_has_no_mirror_image(sample):
    random = np.random.default_rng(0)
    crooked = HEAD.vertices + 0.1 * UNIT * random.normal(size=HEAD.vertices.shape)
    assert symmetry_of(crooked, HEAD.landmarks, sample) is None


def test_a_mirrored_face_is_shown_by_the_mirrored_controls(sample):
    symmetry = symmetry_of(HEAD.vertices, HEAD.landmarks, sample)
    channels, probes = rig(sample, symmetry, noise=2e-3)
    found = map_of(channels, even_probes(probes, symmetry), sample, UNIT)
    wanted = np.einsum("k,ksc->sc", np.random.default_rng(1).normal(size=len(found.effects)), found.effects)
    values, mirrored = (RigSolver(found).variables(each) for each in (wanted, symmetry.mirrored(wanted)))
    np.testing.assert_allclose(mirrored, values.reshape(-1, 2)[:, ::-1].ravel(), atol=1e-6 * np.abs(values).max())


def test_a_control_without_a_mirror_image_keeps_its_effect(sample):
    symmetry = symmetry_of(HEAD.vertices, HEAD.landmarks, sample)
    probes = rig(sample, symmetry, noise=0.0)[1]
    alone = even_probes(probes[:1], symmetry)
    np.testing.assert_array_equal(alone[0][0].moved, probes[0][0].moved)
    assert even_probes([], symmetry) == []
    assert even_probes([[]], symmetry) == [[]]

"""Features and motions that are transferred from known heads (method.md, section 5.5)."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.deform.expressions import learn, load_expressions, shipped_expressions, transferred
from facemime.core.face.landmarks import LOWER_LIPS, outer_eye_distance
from facemime.core.heads.built_in import Head, load_head
from facemime.core.heads.rims import MOUTH, rims_of
from facemime.core.numeric.arrays import IntArray

PUFF = "cheekPuff"


@pytest.fixture(scope="module")
def known() -> Head:
    return load_head()


def test_motion_carried_to_the_head_it_comes_from_is_the_same(known: Head) -> None:
    moving = known.regions.any(axis=0)
    back = transferred(known.units, known.vertices, known.faces, known.landmarks, known.regions)
    missed = np.linalg.norm(back - known.units, axis=2)[:, moving].sum()
    assert missed < 0.06 * np.linalg.norm(known.units, axis=2)[:, moving].sum()
    assert not back[:, ~moving].any()


def test_motion_that_varies_linearly_is_carried_over_linearly(known: Head) -> None:
    tilt = np.array([[0.2, 0.1, 0.0], [-0.1, 0.3, 0.2], [0.0, 0.1, -0.2]])
    places = known.vertices - known.vertices[known.landmarks].mean(axis=0)
    wanted = places @ tilt
    moving = known.regions.any(axis=0)
    found = transferred(wanted[None], known.vertices, known.faces, known.landmarks, known.regions)[0]
    missed = np.linalg.norm(found - wanted, axis=1)[moving]
    assert np.percentile(missed, 99) < 0.04 * np.linalg.norm(wanted, axis=1)[moving].mean()


def test_a_puffed_cheek_has_no_ripples_on_a_dense_mesh(known: Head) -> None:
    puff = known.units[known.unit_names.index(PUFF)]
    vertices = np.asarray(known.vertices, dtype=np.float64)
    eye = outer_eye_distance(vertices[known.landmarks])
    corners = known.faces[(known.faces >= 0).all(axis=1)][:, :2]
    puffed = np.linalg.norm(puff[corners], axis=2).min(axis=1) > 0.02 * eye
    corners = corners[puffed & (np.linalg.norm(np.diff(vertices[corners], axis=1)[:, 0], axis=1) > 0.04 * eye)]
    assert len(corners) > 20
    # Forty vertices along each edge of the coarse cheek.
    share = np.linspace(0.0, 1.0, 40)

    def along(values: np.ndarray) -> np.ndarray:
        first, last = values[corners[:, 0]], values[corners[:, 1]]
        return first[:, None] + share[:, None] * (last - first)[:, None]

    dense = np.concatenate([vertices, along(vertices).reshape(-1, 3)])
    regions = np.concatenate([known.regions.T, along(known.regions.T).reshape(-1, 3)]).T
    motion = transferred(puff[None], dense, None, known.landmarks, regions)[0, len(vertices) :]
    bends = np.diff(motion.reshape(len(corners), len(share), 3), n=2, axis=1)
    steps = np.linalg.norm(vertices[corners[:, 1]] - vertices[corners[:, 0]], axis=1) / (len(share) - 1)
    assert np.percentile(np.linalg.norm(bends, axis=2) / steps[:, None], 99) < 0.2


def test_the_shipped_correlation_is_the_mean_of_both_known_heads(known: Head) -> None:
    models = learn(known.vertices, known.faces, known.landmarks, known.regions, known.units), load_expressions()
    alone = [model.transfer(known.vertices, known.faces, known.landmarks, known.regions) for model in models]
    wanted = np.mean([features @ features[known.landmarks].T for features in alone], axis=0)
    joined = shipped_expressions().transfer(known.vertices, known.faces, known.landmarks, known.regions)
    missed = joined @ joined[known.landmarks].T - wanted
    assert np.sqrt(np.square(missed).mean()) < 0.03 * np.sqrt(np.square(wanted).mean())


def test_an_open_mouth_is_as_round_wherever_between_the_corners_its_landmarks_are(known: Head) -> None:
    jaw = known.units[[known.unit_names.index("jawOpen")]]
    rims = rims_of(np.asarray(known.vertices, dtype=np.float64), known.faces, known.landmarks, MOUTH)
    assert rims is not None
    lower, eye = rims[1].vertices, outer_eye_distance(known.vertices[known.landmarks])
    nearer = known.landmarks.copy()
    for landmark, beside in ((LOWER_LIPS[0], 1), (LOWER_LIPS[2], -1)):
        nearer[landmark] = lower[np.flatnonzero(lower == known.landmarks[landmark])[0] + beside]

    def missed(faces: IntArray | None) -> float:
        found = transferred(jaw, known.vertices, faces, nearer, known.regions)[0]
        return float(np.linalg.norm((found - jaw[0])[lower], axis=1).max() / eye)

    assert missed(None) > 0.05  # by its landmarks alone it is a diamond
    assert missed(known.faces) < 0.02

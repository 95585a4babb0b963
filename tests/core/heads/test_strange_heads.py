"""Heads that look unlike people: what is no face is refused, and lips are judged by the mesh."""

import numpy as np
import pytest

from facemime.core.errors import HeadError
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.heads.bind import bind_landmarks
from facemime.core.heads.built_in import load_head
from facemime.core.heads.checks import resting_findings
from facemime.core.heads.rig import built_in_head

HEAD = built_in_head()
PLACES = HEAD.vertices.astype(np.float64)
UNIT = outer_eye_distance(PLACES[HEAD.landmarks])


def with_snout(length: float, width: float, height: float) -> np.ndarray:
    """The built-in head with a snout of a length and a width, in outer-eye distances, and of another height."""
    places, nose = PLACES.copy(), PLACES[HEAD.landmarks[30]]
    off = np.hypot(places[:, 0] - nose[0], places[:, 1] - nose[1] - 0.15 * UNIT) / UNIT
    front = places[:, 2] < nose[2] + 1.2 * UNIT
    places[:, 2] -= length * UNIT * np.exp(-np.square(off / width)) * front
    places[:, 1] *= height
    return places


def test_the_head_of_an_animal_is_refused_unless_it_is_marked():
    places = with_snout(1.0, 0.6, 0.6)
    with pytest.raises(HeadError, match="No face was found on the mesh"):
        bind_landmarks(places, HEAD.faces)
    numbers = {36: 36, 45: 45, 33: 33, 8: 8, 48: 48, 54: 54}
    marks = {number: int(HEAD.landmarks[place]) for number, place in numbers.items()}
    assert bind_landmarks(places, HEAD.faces, marks).landmarks.shape == (66,)


@pytest.mark.parametrize(("length", "width", "height"), [(0.5, 0.6, 1.0), (1.0, 0.3, 1.0), (0.5, 0.6, 0.6)])
def test_a_cartoon_with_a_snout_is_bound(length, width, height):
    assert bind_landmarks(with_snout(length, width, height), HEAD.faces).landmarks.shape == (66,)


@pytest.mark.parametrize("opened", [0.0, 0.25, 0.5])
def test_lips_that_look_open_are_called_open_only_if_those_of_the_mesh_are(opened):
    jaw = load_head().units[COEFFICIENT_INDEX["jawOpen"]]
    seen, places = ((PLACES + share * jaw)[HEAD.landmarks] / UNIT for share in (0.5, opened))
    told = any("open at rest" in finding.problem for finding in resting_findings(seen, places))
    assert told == (opened > 0.0)


def test_an_open_mouth_is_found_on_a_mesh():
    places = PLACES + 0.25 * load_head().units[COEFFICIENT_INDEX["jawOpen"]]
    assert any("open at rest" in finding.problem for finding in bind_landmarks(places, HEAD.faces).findings)

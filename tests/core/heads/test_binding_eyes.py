"""Lids are bound where they are seen against a separate eye."""

import numpy as np
import pytest

from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.heads.eyeballs import EYES
from facemime.core.heads.portrait import lids_seen


def eye_of(head, *, left: bool):
    return next(part for part in head.parts if part.name == ("eye_left" if left else "eye_right"))


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.1, -0.15, 0.05)])
def test_the_landmarks_of_an_eye_are_found_on_the_rim_of_its_lids(left, angles):
    head = load_head()
    turn = euler_to_matrix(*angles)
    eye = eye_of(head, left=left)
    found = lids_seen(head.vertices @ turn.T, head.faces, eye.vertices @ turn.T, eye.faces, left=left)
    true = head.landmarks[EYES[int(left)]]
    off = np.linalg.norm(head.vertices[found] - head.vertices[true], axis=1)
    assert len(set(found.tolist())) == 6
    assert off.mean() < 0.045 * outer_eye_distance(head.vertices[head.landmarks])


def test_a_shut_eye_has_no_rim():
    head = load_head()
    shut = head.vertices + 1.05 * head.units[head.unit_names.index("eyeBlinkLeft")]
    eye = eye_of(head, left=True)
    assert lids_seen(shut, head.faces, eye.vertices - (0.0, 0.0, -0.004), eye.faces, left=True) is None


def test_an_eye_behind_the_head_has_no_rim():
    head = load_head()
    eye = eye_of(head, left=True)
    assert lids_seen(head.vertices, head.faces, eye.vertices + (0.0, 0.0, 0.3), eye.faces, left=True) is None

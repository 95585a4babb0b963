"""The joints of Rigify's face, placed by landmarks."""

import numpy as np
import pytest

from facemime.core.face.landmarks import MIRROR, from_ibug
from facemime.core.heads.rig import built_in_head
from facemime.core.rigs.metarig import FaceShape, MetarigFit, joints_of


@pytest.fixture(scope="module")
def shape():
    rig = built_in_head()
    points = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    eyes = np.asarray(rig.eyeballs, dtype=np.float64)[:, :3]
    return FaceShape(points, np.asarray(rig.jaw_pivot, dtype=np.float64), eyes[np.argsort(eyes[:, 0])])


def flipped(points):
    return points * (-1.0, 1.0, 1.0)


def test_joints_are_at_the_landmarks_of_their_side(shape):
    joints = joints_of(shape)
    for joint, number in ((("lid.T.L", "head"), 45), (("lid.T.R", "head"), 36), (("jaw", "tail"), 8)):
        np.testing.assert_allclose(joints[joint], shape.landmarks[from_ibug([number])[0]])
    assert joints["eye.L", "head"][0] > 0.0 > joints["eye.R", "head"][0]
    assert joints["lip.T.L", "head"] == pytest.approx(joints["lip.T.R", "head"])


def test_a_mirrored_face_has_mirrored_joints(shape):
    mirrored = FaceShape(flipped(shape.landmarks[MIRROR]), flipped(shape.jaw_pivot), flipped(shape.eyes[::-1]))
    joints, again = joints_of(shape), joints_of(mirrored)
    for (bone, end), place in joints.items():
        other = bone.replace(".L", ".?").replace(".R", ".L").replace(".?", ".R")
        np.testing.assert_allclose(again[other, end], flipped(place), atol=1e-12)


def test_a_fit_meets_the_joints_and_carries_others_along(shape):
    random = np.random.default_rng(0)
    joints = {joint: 3.0 * place + (1.0, 2.0, 3.0) for joint, place in joints_of(shape).items()}
    ear = shape.landmarks[0] + (-0.01, 0.0, 0.03)
    fit = MetarigFit({**joints, ("ear.R", "head"): 3.0 * ear + (1.0, 2.0, 3.0)}, shape)
    for joint, place in fit.placed.items():
        np.testing.assert_allclose(fit.face(joints[joint][None])[0], place, atol=1e-6)
    np.testing.assert_allclose(fit.face(3.0 * ear[None] + (1.0, 2.0, 3.0))[0], ear, atol=1e-5)
    spine = random.normal(size=(4, 3))
    np.testing.assert_allclose(fit.body(3.0 * spine + (1.0, 2.0, 3.0)), spine, atol=1e-9)

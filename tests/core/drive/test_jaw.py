"""The rotation of the jaw agrees with the built-in head's units, and suits a wide-open mouth."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.drive.posing import Jaw
from facemime.core.face.landmarks import CHIN, LOWER_LIPS, outer_eye_distance
from facemime.core.face.rotation import fit_rotation
from facemime.core.heads.built_in import load_head

HEAD = load_head()
LANDMARKS = HEAD.vertices[HEAD.landmarks].astype(np.float64)
JAW, UNIT = Jaw(LANDMARKS, HEAD.jaw_pivot), outer_eye_distance(LANDMARKS)


def motion(**mixture: float) -> np.ndarray:
    return sum(share * HEAD.units[HEAD.unit_names.index(name)][HEAD.landmarks] for name, share in mixture.items())


def degrees(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))


@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
def test_an_open_jaw_turns_as_the_teeth_of_the_built_in_head_do(share):
    teeth = next(part for part in HEAD.parts if part.name == "teeth_lower")
    rest = teeth.vertices.astype(np.float64) - HEAD.jaw_pivot
    wanted = fit_rotation(rest, rest + share * teeth.units[HEAD.unit_names.index("jawOpen")])
    assert degrees(JAW.rotation(motion(jawOpen=share)) @ wanted.T) < 1.5


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_teeth_follow_the_lower_lip_if_the_motion_of_the_chin_is_underestimated(share):
    true = motion(jawOpen=share)
    tracked = true.copy()
    tracked[CHIN] *= 0.6
    chin_alone = fit_rotation(*(LANDMARKS[CHIN] - HEAD.jaw_pivot + moved[CHIN] for moved in (0 * true, tracked)))
    wanted, found = degrees(JAW.rotation(true)), degrees(JAW.rotation(tracked))
    assert degrees(chin_alone) < 0.7 * wanted < 0.8 * wanted < found < 1.05 * wanted


@pytest.mark.parametrize(
    "names", [("mouthLowerDownLeft", "mouthLowerDownRight"), ("mouthFunnel",), ("mouthShrugLower",)]
)
def test_a_lower_lip_that_moves_by_itself_leaves_the_teeth_where_they_are(names):
    assert degrees(JAW.rotation(motion(**dict.fromkeys(names, 1.0)))) < 0.6


def test_sealed_lips_do_not_shut_an_open_jaw():
    sealed = motion(jawOpen=0.5)
    sealed[LOWER_LIPS] = 0.0
    assert degrees(JAW.rotation(sealed)) > 10.0


def test_a_motionless_chin_does_not_turn_the_jaw():
    np.testing.assert_allclose(JAW.rotation(np.zeros((66, 3))), np.eye(3), atol=1e-12)

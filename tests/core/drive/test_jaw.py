"""The rotation of the jaw agrees with the built-in head's units, and suits a wide-open mouth."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.drive.posing import Jaw
from facemime.core.face.landmarks import CHIN, LOWER_LIPS, outer_eye_distance
from facemime.core.face.rotation import fit_rotation
from facemime.core.heads.bite import bite_of
from facemime.core.heads.built_in import WOMAN_FILE, load_head
from facemime.core.heads.rig import built_in_head

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


@pytest.mark.parametrize("file", [None, WOMAN_FILE])
@pytest.mark.parametrize("opened", [0.0, 0.4])
def test_shut_teeth_meet_however_far_the_chin_was_tracked_down(file, opened):
    head = load_head(file)
    landmarks = head.vertices[head.landmarks].astype(np.float64)
    jaw = Jaw(landmarks, head.jaw_pivot, bite_of(built_in_head()))
    upper, lower = (head.part(f"teeth_{row}").vertices.astype(np.float64) for row in ("upper", "lower"))
    below = []
    for teeth in (0.0, 0.5, 1.0):
        turned = (lower - head.jaw_pivot) @ jaw.rotation(motion(jawOpen=opened), teeth).T + head.jaw_pivot
        below.append((front(turned)[:, 1].min() - front(upper)[:, 1].max()) / UNIT)
    assert below[0] > 0.03 and below[0] > below[1] > below[2]
    assert -0.025 < below[2] < 0.0
    np.testing.assert_array_equal(jaw.rotation(motion(jawOpen=opened)), jaw.rotation(motion(jawOpen=opened), 0.0))


def front(teeth: np.ndarray) -> np.ndarray:
    """The front teeth of a row."""
    middle = teeth[np.abs(teeth[:, 0]) < 0.12 * UNIT]
    return middle[middle[:, 2] < middle[:, 2].min() + 0.06 * UNIT]

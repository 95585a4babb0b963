"""Several heads follow several people of one camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.files.capture import read_image
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.outputs import LiveHead
from facemime.core.puppet.sources import LiveFrame
from facemime.core.puppet.worker import LiveOptions, LiveWorker
from facemime.core.tracking.people import PeopleRoles
from tests.core.puppet.test_live_worker import Listed, Recorded, run

PORTRAITS = Path(__file__).parents[2] / "data" / "portraits"
FACES = {"collins.jpg": (59.3, 133.5, 108.9), "hopper.jpg": (114.9, 177.2, 182.5)}
"""Distance between the outer corners of the eyes, and the middle of the face, in pixels."""
SIDE = 300
BOTH = LiveOptions(smoothing=0.0, people=(0, 0))


@pytest.fixture(scope="module")
def couple() -> np.ndarray:
    """An image of two people side by side, their eyes 70 pixels apart."""
    sides = []
    for name, (eyes, x, y) in FACES.items():
        scale = 70.0 / eyes
        matrix = np.column_stack([scale * np.eye(2), SIDE / 2.0 - scale * np.array([x, y])])
        picture = read_image(PORTRAITS / name)
        sides.append(cv2.warpAffine(picture, matrix, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE))
    return np.hstack(sides)


def frames(image: np.ndarray, count: int = 60) -> list[LiveFrame]:
    return [LiveFrame(i / 25.0, np.roll(image, i % 3, axis=0)) for i in range(count)]


def test_each_head_follows_a_person_of_its_own(couple):
    rig = built_in_head()
    worker = LiveWorker(Listed(frames(couple)), heads=(LiveHead(rig), LiveHead(rig)), options=BOTH)
    recorded = Recorded()
    worker.record(recorded)
    run(worker)
    assert worker.error is None and worker.counts.tracked == 60 and worker.counts.lost == 0
    assert dict(worker.latest.people) == {0: (0,), 1: (1,)}
    one, other = worker.latest.heads
    assert np.abs(one.vertices - other.vertices).max() > 0.0
    neutrals = [worker.performer(number).neutral for number in (0, 1)]
    assert np.linalg.norm(neutrals[0].shape - neutrals[1].shape, axis=1).mean() > 0.01
    places = {round(result.pose[4] // SIDE) for _, result in recorded[-2:]}
    assert len(recorded) == 120 and places == {0, 1}


def test_a_head_follows_the_person_chosen_for_it(couple):
    rig = built_in_head()
    source = Listed(frames(couple, 40))
    worker = LiveWorker(source, heads=(LiveHead(rig),), options=LiveOptions(smoothing=0.0, people=(2,)))
    run(worker)
    assert dict(worker.latest.people) == {0: (), 1: (0,)}
    second = worker.performer(1).result
    assert worker.latest.result is second and worker.performer(0).result is None


def test_a_head_whose_person_is_out_of_view_keeps_its_last_frame(couple):
    alone = couple.copy()
    alone[:, SIDE:] = 128
    rig = built_in_head()
    worker = LiveWorker(
        Listed([*frames(couple, 40), *frames(alone, 5)]), heads=(LiveHead(rig), LiveHead(rig)), options=BOTH
    )
    run(worker)
    (left,) = worker.latest.people
    assert len(worker.latest.heads) == 2 and worker.counts.lost == 0
    assert not worker.performer(1 - left).result.found


@given(st.lists(st.tuples(st.lists(st.integers(0, 3), min_size=1, max_size=4), st.sets(st.integers(0, 3)))))
def test_no_head_is_driven_by_two_people_and_chosen_ones_keep_their_head(moments):
    roles = PeopleRoles()
    for time, (wanted, in_view) in enumerate(moments):
        heads = roles.assign(wanted, in_view, float(time))
        driven = [head for own in heads.values() for head in own]
        assert len(driven) == len(set(driven)) and all(head < len(wanted) for head in driven)
        for head, person in enumerate(wanted):
            assert person == 0 or head in heads[person - 1]


def test_a_head_waits_for_its_person_before_somebody_else_drives_it():
    roles = PeopleRoles()
    assert roles.assign((0,), {0}, 0.0) == {0: (0,)}
    assert roles.assign((0,), {1}, 3.0) == {0: (0,)}
    assert roles.assign((0,), {1}, 6.0) == {1: (0,)}
    assert roles.assign((0,), {0, 1}, 6.1) == {1: (0,)}

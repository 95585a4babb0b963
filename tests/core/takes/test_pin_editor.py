"""Editing of pins, frame by frame."""

import numpy as np
import pytest

from facemime.core.takes.pin_editor import PinEditor
from facemime.core.takes.pins import Pin, pins_of, with_pins
from tests.helpers.takes import performance


@pytest.fixture
def editor():
    return PinEditor(performance(60), 20)


def test_a_placed_landmark_is_where_it_was_put_and_its_neighbours_follow(editor):
    before = editor.landmarks()
    editor.mark()
    editor.place(19, before[19, 0], before[19, 1] - 12.0)
    after = editor.landmarks()
    assert np.abs(after[19] - before[19] - (0.0, -12.0)).max() < 0.2
    assert (after[[18, 20], 1] < before[[18, 20], 1] - 3.0).all(), "the brow follows"
    np.testing.assert_allclose(after[36:], before[36:], atol=1e-3)


def test_dragging_on_replaces_the_pin_of_the_same_frame(editor):
    for step in range(5):
        editor.place(30, 100.0 + step, 200.0)
    assert pins_of(editor.take) == (Pin(editor.time, 30, 104.0, 200.0),)
    editor.step(1)
    editor.place(30, 50.0, 60.0)
    assert len(pins_of(editor.take)) == 2 and editor.pins()[30].x == 50.0


def test_undo_and_redo_return_to_every_state(editor):
    states = [pins_of(editor.take)]
    for landmark in (20, 30, 40):
        editor.mark()
        editor.place(landmark, 10.0, 10.0)
        states.append(pins_of(editor.take))
    for state in states[-2::-1]:
        assert editor.undo() and pins_of(editor.take) == state
    assert not editor.undo()
    for state in states[1:]:
        assert editor.redo() and pins_of(editor.take) == state
    assert not editor.redo()
    editor.undo()
    editor.mark()
    editor.place(1, 1.0, 1.0)
    assert not editor.redo(), "a change after an undo begins another branch"


def test_a_frame_without_a_face_cannot_be_pinned():
    take = performance(60)
    lost = int(np.flatnonzero(~take.found)[0])
    editor = PinEditor(take, lost)
    editor.place(30, 10.0, 10.0)
    assert not editor.found and pins_of(editor.take) == () and np.isnan(editor.landmarks()).all()


def test_pins_at_a_lost_frame_do_not_move_another_frame():
    take = performance(60)
    lost = int(np.flatnonzero(~take.found)[0])
    pinned = with_pins(take, [Pin(float(take.times[lost]), 30, 5.0, 5.0)])
    editor = PinEditor(pinned, lost + 1)
    np.testing.assert_allclose(editor.landmarks(), take.landmarks[lost + 1], atol=1e-4)


def test_steps_stay_within_the_take_and_jumps_find_pins(editor):
    editor.step(-1000)
    assert editor.frame == 0
    editor.step(1000)
    assert editor.frame == len(editor.take) - 1
    assert not editor.next_pinned()
    for frame in (10, 40):
        editor.frame = frame
        editor.place(30, 10.0, 10.0)
    editor.frame = 25
    assert editor.next_pinned() and editor.frame == 40
    assert not editor.next_pinned() and editor.next_pinned(-1) and editor.frame == 10


def test_unknown_certainty_counts_as_certain(editor):
    editor.take.landmark_confidence[:] = np.nan
    assert (editor.certainty == 1.0).all()

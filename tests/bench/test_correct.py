"""The benchmark of pins: its simulated users, and its figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from facemime.core.takes.pins import pins_of
from facemime.core.takes.timing import project
from lab.bench.correct import GROUPS, Performer, by_doubt, by_group, effect, errors_of, largest, pinned
from tests.helpers.takes import performance


def performer(group: str, off: float = 4.0) -> Performer:
    """A take of which a group of landmarks is too low by pixels in all frames, more so in the middle."""
    take = performance(100)
    take = take.part(take.found)
    take = replace(take, landmarks=project(take.shape.astype(float), take.pose).astype(np.float32))
    truth = take.landmarks.astype(float) + (0.1, 0.0)
    swell = 1.0 + 0.2 * np.sin(np.pi * np.linspace(0.0, 1.0, len(take)))
    truth[:, GROUPS[group], 1] -= off * swell[:, None]
    return Performer(take, truth, errors_of(take, truth), 5.0)


def test_the_user_pins_the_largest_errors_that_lie_apart():
    errors = np.zeros(50)
    errors[[10, 12, 30, 49]] = [1.0, 0.9, 0.5, 0.7]
    assert largest(errors, 3).tolist() == [10, 49, 30]


def test_the_group_with_the_largest_error_is_the_worst():
    assert performer("left brow").worst == "left brow"


def test_pins_are_true_places_and_reduce_the_error_of_their_group_alone():
    one = performer("left brow")
    frames = largest(one.errors["left brow"], 3)
    pins = pins_of(pinned(one.take, one.truth, "left brow", frames))
    assert len(pins) == 15
    assert (pins[0].x, pins[0].y) == tuple(one.truth[frames.min(), pins[0].landmark])
    plain, learnt = (effect(one, "left brow", frames, learns=learns) for learns in (False, True))
    assert learnt.elsewhere < 0.7 < plain.elsewhere < 1.0
    assert plain.pinned < 0.05 and learnt.pinned < 0.05


def test_without_pins_nothing_changes():
    nothing = effect(performer("jaw"), "jaw", np.array([], dtype=np.intp), learns=False)
    assert nothing.elsewhere == 1.0 and np.isnan(nothing.pinned)


def test_every_group_has_a_row_for_both_halves():
    one = performer("lips")
    one.take.landmark_confidence[:] = np.random.default_rng(0).uniform(0.4, 0.9, (len(one.take), 66))
    table = by_group([[one], [one]])
    assert [row[0] for row in table.rows] == list(GROUPS)
    assert all(" / " in str(cell) for row in by_doubt([[one], [one]]).rows for cell in row[1:])

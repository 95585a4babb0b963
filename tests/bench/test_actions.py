"""The benchmark of actions: which frames it counts."""

from __future__ import annotations

import numpy as np
import pytest

from facemime.core.face.names import ACTIONS, N_ACTIONS
from lab.bench.actions import Seen, auc, rows_of


def test_the_area_under_the_curve_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    measured, shown = rng.normal(size=60).round(1), rng.random(60) < 0.4
    pairs = np.subtract.outer(measured[shown], measured[~shown])
    expected = ((pairs > 0) + 0.5 * (pairs == 0)).mean()
    assert auc(measured, shown, ~shown) == pytest.approx(expected)
    assert auc(shown.astype(float), shown, ~shown) == 1.0
    assert auc(np.zeros(60), shown, ~shown) == 0.5


def test_each_action_and_crossed_eyes_have_a_row_and_unknown_frames_are_ignored():
    truth = np.zeros((40, N_ACTIONS))
    truth[20:] = 1.0
    crossed = np.where(np.arange(40) < 20, 0.0, 0.6)
    vergence = np.where(np.arange(40) % 2, crossed, np.nan)
    rows = rows_of(Seen(truth, truth - 0.2, 0.5 * truth, crossed, vergence))
    assert [row[0] for row in rows] == [*ACTIONS, "crossed eyes"]
    assert all(row[2] == 1.0 for row in rows)
    assert rows[0][1:] == [20, 1.0, 0.5, 0.0]
    assert rows[-1][1] == 10

"""The benchmark of strangers' clips: agreement with the performer itself is complete, and a wrong rest face counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facemime.core.face.landmarks import BROWS, LOWER_LIPS, UPPER_LIPS
from facemime.core.face.names import COEFFICIENTS
from facemime.core.heads.built_in import load_head
from facemime.core.takes import rest
from facemime.core.takes.face_space import load_face_space
from lab.bench.strangers import (
    ACROSS,
    Clip,
    across,
    by_keys,
    read_clips,
    shut_lips,
    simple_rules,
    stated_alike,
    within,
)
from lab.training.patching import patched
from tests.helpers.takes import make_take

FRAMES = 60


def clip(raised: float) -> tuple[Clip, np.ndarray]:
    """A clip of somebody with raised brows who opens the mouth more and more, and its rest."""
    rest = load_face_space().mean
    shapes = np.tile(rest, (FRAMES, 1, 1))
    open_ = np.linspace(0.0, 0.2, FRAMES)
    shapes[:, LOWER_LIPS, 1] += open_[:, None]
    height = raised + 0.04 * np.sin(np.arange(FRAMES))
    shapes[:, BROWS, 1] -= height[:, None]
    known = {name: np.zeros(FRAMES) for _, _, names in ACROSS.values() for name in names}
    known |= {"jawOpen": open_, "browInnerUp": height, "browOuterUpLeft": height, "browOuterUpRight": height}
    return Clip(make_take(shapes), shapes, known, np.arange(FRAMES)), rest


def test_a_head_that_moves_as_the_performer_agrees_completely():
    reads = [(one, one.points, rest) for one, rest in (clip(0.0), clip(0.12))]
    assert across(reads)["brows up"] == pytest.approx(1.0, abs=1e-3)
    assert across(reads)["jaw"] == pytest.approx(1.0, abs=0.02)
    count, correlation, slope = within(reads)["jaw"]
    assert count == 2 and correlation == pytest.approx(1.0) and slope == pytest.approx(1.0)


def test_a_rest_face_that_took_the_expression_for_rest_counts_across_clips_and_not_within():
    reads = [(one, one.points, rest) for one, rest in (clip(0.0), clip(0.12))]
    wrong = [(one, shown, np.median(shown, axis=0)) for one, shown, _ in reads]
    assert across(wrong)["brows up"] < 0.7
    assert within(wrong)["brow_l"][1] == pytest.approx(within(reads)["brow_l"][1])


def test_lips_that_are_apart_while_the_performers_are_shut_count():
    one, rest = clip(0.0)
    shut = np.linalg.norm(one.points[:, UPPER_LIPS].mean(axis=1) - one.points[:, LOWER_LIPS].mean(axis=1), axis=1)
    one = replace(one, points=np.tile(one.points[np.argmin(shut)], (FRAMES, 1, 1)))
    sealed = one.points.copy()
    sealed[:, LOWER_LIPS, 1] = sealed[:, UPPER_LIPS, 1]
    one = replace(one, points=sealed)
    parted = sealed.copy()
    parted[: FRAMES // 4, LOWER_LIPS, 1] += 0.1
    assert shut_lips([(one, sealed, rest)]) == 1.0
    assert shut_lips([(one, parted, rest)]) == pytest.approx(0.75)


def test_coefficients_are_compared_by_rank_across_clips_and_by_slope_within_them():
    reads = []
    for one, _ in (clip(0.0), clip(0.12)):
        found = np.zeros((FRAMES, len(COEFFICIENTS)))
        found[:, COEFFICIENTS.index("jawOpen")] = 0.5 * one.coefficients["jawOpen"]
        found[:, COEFFICIENTS.index("browInnerUp")] = (
            one.coefficients["browInnerUp"] - one.coefficients["browInnerUp"][0]
        )
        reads.append((one, found))
    compared = stated_alike(reads)
    assert compared["jawOpen"] == pytest.approx((1.0, 2, 1.0, 0.5), abs=1e-3)
    assert compared["browInnerUp"][0] < 0.7 and compared["browInnerUp"][1] == 0
    assert "eyeWideLeft" not in compared


def test_a_head_is_driven_by_its_keys_in_the_frames_with_a_face():
    take = make_take(clip(0.0)[0].points, found=np.arange(FRAMES) % 2 == 0)
    found = np.zeros((FRAMES // 2, len(COEFFICIENTS)))
    found[-1, COEFFICIENTS.index("jawOpen")] = 1.0
    shown, head = by_keys(take, found), load_head()
    assert np.isnan(shown[1::2]).all()
    np.testing.assert_allclose(shown[0], head.vertices[head.landmarks])
    moved = head.units[COEFFICIENTS.index("jawOpen")][head.landmarks]
    np.testing.assert_allclose(shown[-2] - shown[0], moved, atol=1e-6)


def test_rules_are_patched_only_for_a_while():
    before = rest._TOWARDS_MEAN
    with pytest.raises(RuntimeError), patched({(rest, "_TOWARDS_MEAN"): 0.0}):
        assert rest._TOWARDS_MEAN == 0.0
        raise RuntimeError
    assert before == rest._TOWARDS_MEAN
    assert all(rule(clip(0.0)[0].take).shape == (66, 3) for rule in simple_rules().values())


def test_a_clip_that_the_folder_lacks_is_left_out_with_a_message(tmp_path, capsys):
    peer = tmp_path / "peer"
    peer.mkdir()
    np.savez(peer / "nobody.npz", points=np.zeros((1, 66, 3)))
    assert read_clips(tmp_path, peer, tmp_path) == {}
    assert "nobody" in capsys.readouterr().err

"""Mending of takes changes what is wrong, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import facemime
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.drive.retarget import anonymise
from facemime.core.errors import FacemimeError, SourceError
from facemime.core.face.landmarks import OUTER_EYE_CORNERS, mouth_aperture
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.from_video import track_video
from facemime.core.takes.mending import bridge_gaps, find_outliers, mirror_take, remove_outliers, renew_neutral
from facemime.core.takes.neutral import Neutral, calibrate
from facemime.core.takes.smooth import CUTOFFS, before_after, low_pass, smooth_zero_phase
from facemime.core.takes.take import FIELDS, Take, check_take
from facemime.core.takes.timing import mark_lost
from facemime.core.tracking.smoothing import SHAPE_PARTS
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.owners import UNDER_WINE
from tests.helpers.takes import performance

CLIP = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


@pytest.fixture(scope="module")
def tracked() -> Take:
    """The whole sample clip, which blinks, talks and turns."""
    return track_video(CLIP, FaceTracker.load())


def gone(take: Take, *rows: int) -> Take:
    return mark_lost(take, np.isin(np.arange(len(take)), rows))


def test_a_bridged_gap_is_interpolated_with_confidence_zero():
    take = gone(performance(), *range(40, 45))
    out = bridge_gaps(take)
    check_take(out)
    assert out.found.all() and (out.confidence[40:45] == 0).all() and (out.landmark_confidence[40:45] == 0).all()
    step = (out.shape[45] - out.shape[39]) / 6
    np.testing.assert_allclose(np.diff(out.shape[39:46], axis=0), np.broadcast_to(step, (6, 66, 3)), atol=1e-6)
    np.testing.assert_allclose(out.info["bridged"], [[29 / 25, 31 / 25], [39 / 25, 45 / 25]])
    seen = take.found
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(out, name)[seen], getattr(take, name)[seen])
    assert not take.found[42]


def test_a_held_gap_repeats_the_last_face_and_long_gaps_and_ends_stay_lost():
    take = gone(performance(), 0, 1, *range(10, 14), *range(40, 45), 59)
    out = bridge_gaps(take, "hold", longest=0.21)
    assert np.flatnonzero(~out.found).tolist() == [0, 1, *range(40, 45), 59]
    np.testing.assert_array_equal(out.shape[10:14], np.repeat(take.shape[9:10], 4, axis=0))
    nothing = gone(performance(), *range(60))
    assert bridge_gaps(nothing) is nothing


def test_outliers_are_found_and_no_other_frames(tracked):
    assert not find_outliers(tracked).any()
    broken = replace(tracked, shape=tracked.shape.copy(), pose=tracked.pose.copy())
    broken.shape[50] += np.random.default_rng(0).normal(0, 0.1, (66, 3))
    broken.pose[100, 2] += 0.5
    broken.pose[150, 4] += 60.0
    broken.pose[200:202, 0] *= 1.4
    broken.shape[0] *= 1.5
    assert np.flatnonzero(find_outliers(broken)).tolist() == [0, 50, 100, 150, 200, 201]
    out = remove_outliers(broken)
    assert np.flatnonzero(~out.found).tolist() == [0, 50, 100, 150, 200, 201]
    mended = bridge_gaps(out)
    assert np.abs(mended.shape - tracked.shape)[1:].max() < 0.1
    check_take(mended)


def test_too_few_frames_have_no_outliers():
    assert not find_outliers(performance(4)).any()


@pytest.mark.skipif(UNDER_WINE, reason="wine has no complex exponential")
@pytest.mark.parametrize("frequency", [1.0, 3.0, 6.0])
def test_the_smoothing_is_that_of_a_butterworth_filter_run_forward_and_backward(frequency):
    times = np.arange(400) / 60.0
    wave = np.sin(2 * np.pi * frequency * times)[:, None]
    filtered = signal.filtfilt(*signal.butter(2, 3.0, fs=60.0), wave[:, 0])
    out = low_pass(times, wave, 3.0)[:, 0]
    np.testing.assert_allclose(out[60:-60], filtered[60:-60], atol=0.02)


def test_smoothing_solves_its_equation_at_uneven_times_and_keeps_lines():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.01, 0.08, 40))
    line = np.column_stack([2.0 * times - 1.0, np.full(40, 7.0)])
    np.testing.assert_allclose(low_pass(times, line, 2.0), line, atol=1e-9)
    values, steps = rng.normal(size=(40, 3)), np.diff(times)
    middle = (steps[1:] + steps[:-1]) / 2
    second = np.zeros((38, 40))
    for i in range(38):
        second[i, i : i + 3] = np.array([1 / steps[i], -1 / steps[i] - 1 / steps[i + 1], 1 / steps[i + 1]]) / middle[i]
    share = np.diag(np.convolve(steps, [0.5, 0.5]))
    matrix = share + second.T @ np.diag(middle) @ second / (2 * np.pi * 2.0) ** 4
    np.testing.assert_allclose(low_pass(times, values, 2.0), np.linalg.solve(matrix, share @ values), atol=1e-9)


def test_zero_phase_smoothing_halves_noise_and_keeps_losses():
    take = gone(performance(100), 60)
    noise = np.random.default_rng(1).normal(0, 0.003, take.shape.shape).astype(np.float32)
    noisy = replace(take, shape=take.shape + noise)
    out = smooth_zero_phase(noisy, dict.fromkeys(SHAPE_PARTS, 3.0))
    check_take(out)
    np.testing.assert_array_equal(out.found, take.found)
    still = slice(0, 25)
    assert (out.shape - take.shape)[still].std() < 0.5 * noise[still].std()
    assert out.info["smoothed"] == "zero-phase" and "smoothed" not in take.info
    seen = out.found
    np.testing.assert_allclose(
        out.landmarks[seen][0], out.pose[seen][0, 0] * out.shape[seen][0, :, :2] + out.pose[seen][0, 4:6], atol=0.1
    )


def test_a_part_with_an_infinite_cutoff_does_not_change():
    take = performance()
    out = smooth_zero_phase(take, dict.fromkeys(CUTOFFS, np.inf))
    np.testing.assert_array_equal(out.shape, take.shape)
    np.testing.assert_allclose(out.pose, take.pose)


@pytest.mark.parametrize("cutoffs", [{"nose": 0.0}, {"ears": 3.0}, {"jaw": np.nan}])
def test_invalid_cutoffs_are_refused(cutoffs):
    with pytest.raises(FacemimeError, match="is not a cutoff"):
        smooth_zero_phase(performance(), cutoffs)


@pytest.mark.parametrize("part", CUTOFFS)
def test_the_curves_of_every_part_show_what_mending_removed(tracked, part):
    curves = before_after(tracked, smooth_zero_phase(tracked, dict.fromkeys(CUTOFFS, 1.0)), part)
    known = np.isfinite(curves.before) & np.isfinite(curves.after)
    rough = [np.abs(np.diff(c[known], n=2)).mean() for c in (curves.before, curves.after)]
    assert rough[1] < 0.5 * rough[0]
    lost = before_after(gone(performance(), *range(60)), performance(), part)
    assert np.isnan(lost.before).all()


def test_mirroring_a_take_twice_restores_it_with_its_neutral(tracked):
    signs = FaceTracker.load().pdm.mirror_signs
    take = renew_neutral(tracked, 0.5)
    once = mirror_take(take, signs)
    twice = mirror_take(once, signs)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(twice, name), getattr(take, name), atol=1e-3)
    assert once.info["mirrored"] and not twice.info["mirrored"]
    before, middle, after = (Neutral.from_dict(t.info["calibration"]) for t in (take, once, twice))
    np.testing.assert_allclose(after.shape, before.shape)
    np.testing.assert_allclose(after.position, before.position)
    np.testing.assert_allclose(middle.position[1], 639.0 - before.position[1])
    check_take(once)


def test_the_chosen_neutral_is_the_face_at_that_time(tracked):
    row = int(np.argmax(mouth_aperture(tracked.shape)))
    time = float(tracked.times[row])
    renewed = renew_neutral(tracked, time)
    stored = Neutral.from_dict(renewed.info["calibration"])
    np.testing.assert_array_equal(calibrate(renewed).shape, stored.shape)
    assert np.abs(calibrate(renewed, 0.5).shape - stored.shape).max() > 0.1
    assert np.abs(stored.shape - tracked.shape[row]).max() < 0.08
    assert abs((stored.start + stored.end) / 2 - time) < 0.1
    with pytest.raises(SourceError, match="Choose another neutral"):
        renew_neutral(tracked, 99.0)


@pytest.mark.thorough
def test_an_anonymous_take_drives_a_head_as_the_take_does(tracked):
    rig = built_in_head()
    told = [drive_take(HeadDriver(rig, calibrate(take)), take).vertices for take in (tracked, anonymise(tracked))]
    unit = np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]].astype(float)))
    assert np.linalg.norm(told[1] - told[0], axis=-1).max() < 0.005 * unit


def test_an_anonymous_take_has_the_average_face_and_no_names(tracked):
    personal = {
        "source": "Jane.mp4",
        "started": "2026-01-01T12:00:00+01:00",
        "seen_by": "Jane's camera",
        "sound": "j.wav",
    }
    take = replace(tracked, info={**tracked.info, **personal, "offset": 3.0, "note": "Jane"})
    out = anonymise(take)
    assert set(out.info) == {"fps", "image_size", "model", "clock", "calibration"}
    np.testing.assert_allclose(calibrate(out).shape, FaceTracker.load().pdm.mean_shape)
    for name in ("shape_params", "landmark_confidence", "pupils"):
        assert np.isnan(getattr(out, name)).all(), name
    for name in ("times", "pose", "gaze", "found", "confidence"):
        np.testing.assert_array_equal(getattr(out, name), getattr(take, name))
    assert not np.isfinite(out.shape[~out.found]).any() and np.isfinite(out.shape[out.found]).all()
    check_take(out)


def test_two_faces_that_move_alike_are_one_anonymous_take():
    """One face is half as high and deep again, brows and mouth included, and moves in proportion."""
    take, larger = performance(80), np.array([1.0, 1.5, 1.5], np.float32)
    neutral = calibrate(take, start=0.0)
    other = replace(neutral, shape=neutral.shape * larger)
    one = anonymise(replace(take, info={**take.info, "calibration": neutral.to_dict()}))
    two = anonymise(replace(take, shape=take.shape * larger, info={**take.info, "calibration": other.to_dict()}))
    np.testing.assert_allclose(two.shape[..., :2], one.shape[..., :2], atol=2e-3)
    np.testing.assert_allclose(two.landmarks, one.landmarks, atol=0.3)


def test_an_anonymous_take_stays_anonymous_and_keeps_how_wide_the_mouth_opens(tracked):
    neutral = replace(calibrate(tracked), open_mouth=0.25)
    once = anonymise(replace(tracked, info={**tracked.info, "calibration": neutral.to_dict()}))
    assert calibrate(once).mouth_gain == pytest.approx(neutral.mouth_gain) != 1.0
    np.testing.assert_allclose(anonymise(once).shape, once.shape, atol=1e-3)


def test_a_take_without_a_face_is_anonymous_too():
    out = anonymise(gone(performance(10), *range(10)))
    assert not out.found.any() and "source" not in out.info


@pytest.mark.parametrize("apart", [1e-3, 1e-6, 1e-9, 1e-12])
def test_nearly_coincident_frames_are_smoothed_like_any_others(apart):
    times = np.sort(np.concatenate([np.arange(40) / 25.0, np.arange(5, 30) / 25.0 + apart]))
    wave = np.sin(2.0 * np.pi * 0.5 * times)[:, None]
    for cutoff in (0.5, 6.0, 20.0):
        smoothed = low_pass(times, wave, cutoff)
        assert np.isfinite(smoothed).all() and np.abs(smoothed).max() < 1.2
    np.testing.assert_allclose(low_pass(times, wave, 20.0), wave, atol=0.05)

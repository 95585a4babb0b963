"""A model of FaceTracker, which the user gives: how its file is read, and how its linear experts track a face."""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.cli.main import main
from facemime.core.errors import ModelError
from facemime.core.face.landmarks import INNER, OUTER_EYE_CORNERS
from facemime.core.files.assets import ASSETS
from facemime.core.files.capture import VideoSource
from facemime.core.takes.file import load_take
from facemime.core.tracking import facetracker_file as reading
from facemime.core.tracking.linear_experts import LinearExpert, LinearView
from facemime.core.tracking.pdm import FittedShape, PointDistributionModel
from facemime.core.tracking.tracker import CASCADES, FaceTracker, TrackingSettings
from tests.helpers.facetracker_files import SCALE, YAWS, facetracker_file, sample_experts, sample_file, small_pdm

PUBLISHED = Path(__file__).parents[4] / "shared/data/models/saragih_facetracker/model/face2.tracker"


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("model") / "face2.tracker"
    file.write_bytes(sample_file())
    return file


@pytest.fixture(scope="module")
def tracker(path) -> FaceTracker:
    return FaceTracker.load(settings=TrackingSettings(CASCADES, str(path)))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_written_in_the_layout_is_read_back_in_the_head_frame(seed, tmp_path):
    rng = np.random.default_rng(seed)
    ours, modes = FaceTracker.load().pdm, int(rng.integers(1, 30))
    pdm = PointDistributionModel(ours.mean_shape, ours.basis[:, :, :modes], ours.eigenvalues[:modes])

    def random_view() -> list[list[LinearExpert]]:
        return [
            [
                LinearExpert(int(rng.integers(3)), *rng.normal(size=2), rng.normal(size=(11, 11)).astype(np.float32))
                for _ in range(rng.integers(4))
            ]
            for _ in range(66)
        ]

    views = [random_view() for _ in YAWS]
    (tmp_path / "a.tracker").write_bytes(facetracker_file(pdm, views))
    model = reading.read_facetracker(tmp_path / "a.tracker", ours)
    np.testing.assert_allclose(model.pdm.mean_shape, ours.mean_shape, atol=1e-6)
    np.testing.assert_allclose(model.pdm.basis, pdm.basis, atol=1e-6)
    np.testing.assert_allclose(model.pdm.eigenvalues, pdm.eigenvalues, rtol=1e-6)
    np.testing.assert_allclose(model.centres, np.column_stack([np.zeros(3), YAWS]))
    assert model.scale == pytest.approx(SCALE)
    for view, own in zip(model.views, views, strict=True):
        assert [len(e) for e in view.experts] == [len(e) for e in own]
        for read, written in zip(chain(*view.experts), chain(*own), strict=True):
            assert (read.kind, read.gain) == (written.kind, pytest.approx(written.gain))
            np.testing.assert_allclose(read.weights, written.weights, rtol=1e-6)


def test_an_expert_finds_its_own_patch_and_is_likely_there_alone():
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0.0, 255.0, (60, 60)).astype(np.float32)
    expert = LinearExpert(0, -20.0, 10.0, pixels[20:31, 30:41])
    maps = LinearView(((expert,), ())).respond(pixels, np.array([[33, 26], [30, 30]]), 5)
    mean = maps.moments[0]
    np.testing.assert_allclose(mean[0], (35.0, 25.0), atol=0.05)
    assert np.ptp(maps.likelihood[1]) == 0.0, "a hidden landmark has no preference"
    np.testing.assert_allclose(maps.likelihood.sum(axis=(1, 2)), 1.0, rtol=1e-5)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_a_flat_image_gives_finite_maps(kind):
    expert = LinearExpert(kind, -1e4, 1e4, np.zeros((11, 11), np.float32))
    maps = LinearView(((expert,),)).respond(np.full((60, 60), 7.0, np.float32), np.array([[30, 30]]), 5)
    assert np.isfinite(maps.likelihood).all()


def test_the_view_is_that_of_the_heads_rotation(tracker):
    linear = tracker._model.linear
    for i, yaw in enumerate(YAWS):
        assert linear.view(np.array([100.0, 0.0, 0.8 * yaw, 0.3, 0.0, 0.0])) is linear.views[i]


def test_the_experts_draw_a_displaced_start_to_the_known_landmarks(tracker):
    truth = np.load(ASSETS / "sample" / "sample_landmarks.npz")["landmarks"].astype(float)
    with VideoSource(ASSETS / "sample" / "sample.mp4") as video:
        image = next(iter(video)).image
    fitted = small_pdm().fit(truth[0])
    eyes = np.linalg.norm(np.diff(truth[0][OUTER_EYE_CORNERS], axis=0))
    off = fitted.pose + np.array([0.0, 0.0, 0.05, 0.03, 0.08 * eyes, -0.06 * eyes])
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    start = FittedShape(off, np.zeros(small_pdm().n_modes))
    found = tracker.fitter.fit_linear(grey, start, (5, 4, 3))

    def error(fit: FittedShape) -> float:
        away = tracker.pdm.project(fit.pose, fit.shape_params) - truth[0]
        return float(np.linalg.norm(away, axis=1)[INNER].mean() / eyes)

    assert error(found) < 0.045 < 0.08 < error(start)


def test_the_settings_of_the_paper_with_a_given_model_track_the_sample(path, tracker):
    truth = np.load(ASSETS / "sample" / "sample_landmarks.npz")["landmarks"].astype(float)
    tracker.reset()
    errors = []
    with VideoSource(ASSETS / "sample" / "sample.mp4") as video:
        for frame, places in zip(video, truth[:25], strict=False):
            result = tracker.track(frame.image)
            assert result.found and result.shape_params.shape == (small_pdm().n_modes,)
            eyes = np.linalg.norm(np.diff(places[OUTER_EYE_CORNERS], axis=0))
            errors.append(np.linalg.norm(result.landmarks - places, axis=1)[INNER].mean() / eyes)
    assert np.mean(errors) < 0.05


def test_a_picture_without_a_face_has_none_for_a_given_model(tracker):
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    tracker.reset()
    assert not tracker.track(noise).found


def test_the_command_tracks_with_the_users_model(path, tmp_path):
    clip = tmp_path / "a.avi"
    with VideoSource(ASSETS / "sample" / "sample.mp4") as video:
        images = [frame.image for frame, _ in zip(video, range(4), strict=False)]
    writer = cv2.VideoWriter(str(clip), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, images[0].shape[1::-1])
    for image in images:
        writer.write(image)
    writer.release()
    out = tmp_path / "a.facetake"
    assert main(["track", str(clip), "-o", str(out), "--detector", "cascades", "--tracker-model", str(path)]) == 0
    take = load_take(out)
    assert take.found.all() and take.shape_params.shape[1] == small_pdm().n_modes
    assert take.info["model"] == FaceTracker.load(path).model_id != FaceTracker.load().model_id


def _changed(find: bytes, to: bytes) -> bytes:
    assert find in sample_file()
    return sample_file().replace(find, to, 1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"8 ", "truncated"),
        (b"8 4 3 0 198 12 6 1 2 3", "truncated"),
        (sample_file()[:-3000][: len(sample_file()) // 2], "truncated"),
        (b"7 4 3", "type of a record"),
        (b"8 4 99999 0", "number of views"),
        (b"8 4 3 0 198 1000000000 6", "the modes"),
        (b"8 4 3 0 99 12 6", "the modes"),
        (b"8 4 3 0 198 12 16", "the modes"),
        (_changed(b"198 12 6 ", b"198 12 6 nan "), "too large"),
        (_changed(b"198 12 6 ", b"198 12 6 1e300 "), "too large"),
        (_changed(b"198 12 6 ", b"198 12 6 word "), "word where a number"),
        (_changed(b"2 0 -14 9 11 11 5", b"2 7 -14 9 11 11 5"), "kind of an expert"),
        (_changed(b"2 0 -14 9 11 11 5", b"2 0 -1e6 9 11 11 5"), "weight above"),
        (_changed(b"2 0 -14 9 11 11 5", b"2 0 -14 9 9999 11 5"), "side of a patch"),
        (b"8" + b" 1" * (reading.MAX_BYTES // 2), "larger than"),
    ],
)
def test_a_damaged_or_hostile_file_is_one_clear_error(content, message, tmp_path):
    (tmp_path / "a.tracker").write_bytes(content)
    with pytest.raises(ModelError, match=f"is not a model of FaceTracker .*{message}"):
        FaceTracker.load(tmp_path / "a.tracker")


def test_points_in_another_order_or_with_other_axes_are_refused(tmp_path):
    ours = FaceTracker.load().pdm
    shuffled = ours.mean_shape[::-1].copy()
    upside_down = ours.mean_shape * (1.0, -1.0, -1.0)
    for mean in (shuffled, upside_down, np.zeros((66, 3))):
        pdm = PointDistributionModel(mean, small_pdm().basis, small_pdm().eigenvalues)
        (tmp_path / "a.tracker").write_bytes(facetracker_file(pdm, sample_experts()))
        with pytest.raises(ModelError, match=r"usual order|too large"):
            FaceTracker.load(tmp_path / "a.tracker")


def test_a_missing_file_is_a_clear_error(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        FaceTracker.load(settings=TrackingSettings(tracker_model=str(tmp_path / "none.tracker")))


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the published model of ../shared/data is not here")
def test_the_published_model_lies_in_our_head_frame_and_tracks_the_sample():
    ours, published = FaceTracker.load(), FaceTracker.load(PUBLISHED)
    away = np.linalg.norm(published.pdm.mean_shape - ours.pdm.mean_shape, axis=1)[INNER]
    assert away.mean() < 0.05
    shown = [[bool(own) for own in view.experts] for view in published._model.linear.views]
    assert all(shown[0]) and not any(shown[1][:8]) and all(shown[1][9:17])
    assert all(shown[2][:8]) and not any(shown[2][9:17])
    with VideoSource(ASSETS / "sample" / "sample.mp4") as video:
        for frame, _ in zip(video, range(10), strict=False):
            one, other = published.track(frame.image), ours.track(frame.image)
            assert one.found
            eyes = other.pose[0]
            assert np.linalg.norm(one.landmarks - other.landmarks, axis=1)[INNER].mean() < 0.04 * eyes
            turned = np.abs(one.head_pose_degrees - other.head_pose_degrees)
            assert turned[0] < 15.0 and turned[1:].max() < 6.0, turned

"""The converter of published sets of face photos, tested with a template whose points lie at known places."""

import cv2
import numpy as np
import pytest

from lab.training.faces import LARGEST_SIDE, convert, landmarks_of_template, main, read_template, reduced
from lab.training.tracker.sources import CLIPS, person_of

BROW, UPPER_LID, LOWER_LID, OUTER_LIPS = range(71, 77), range(18, 23), (18, 28, 29, 30, 22), range(87, 94)


@pytest.fixture
def points():
    """Points of a template on no curve at all, except for a brow, an eye and the bridge of the nose."""
    points = np.random.default_rng(7).uniform((300.0, 500.0), (1000.0, 1400.0), (189, 2))
    points[BROW] = np.stack([[300.0, 310.0, 320.0, 360.0, 390.0, 400.0], np.full(6, 600.0)], axis=1)
    points[UPPER_LID] = [(300.0, 700.0), (300.0, 670.0), (330.0, 670.0), (360.0, 670.0), (360.0, 700.0)]
    points[list(LOWER_LID)] = [(300.0, 700.0), (310.0, 700.0), (320.0, 700.0), (350.0, 700.0), (360.0, 700.0)]
    points[50:55] = np.stack([np.full(5, 600.0), 700.0 + 20.0 * np.arange(5)], axis=1)
    points[56:61] = np.stack([np.full(5, 640.0), 700.0 + 20.0 * np.arange(5)], axis=1)
    points[55] = 620.0, 800.0
    return points


def template(points):
    return "\n".join([str(len(points)), *(f"{x}\t{y}" for x, y in points.tolist()), "1", "0", "2", "0 1"]) + "\n"


def photo(path, points, size=(1350, 1800)):
    """Write a photo with a small disc at the tip of the chin, and the template beside it."""
    image = np.full((*size[::-1], 3), 90, np.uint8)
    cv2.circle(image, np.round(points[129] * 16).astype(int).tolist(), 16 * 9, (255, 255, 255), -1, cv2.LINE_AA, 4)
    cv2.imwrite(str(path), image)
    path.with_suffix(".tem").write_text(template(points))


def no_face(image):
    return np.full((68, 2), np.nan)


def test_landmarks_lie_at_equal_distances_along_the_curves_of_a_template(points):
    landmarks = landmarks_of_template(read_template(template(points)))
    assert landmarks.shape == (68, 2)
    assert np.allclose(landmarks[17:22], [(x, 600.0) for x in (300.0, 325.0, 350.0, 375.0, 400.0)])
    assert np.allclose(landmarks[36:40], [(300.0, 700.0), (310.0, 670.0), (350.0, 670.0), (360.0, 700.0)])
    assert np.allclose(landmarks[40:42], [(340.0, 700.0), (320.0, 700.0)])


def test_the_bridge_of_the_nose_runs_down_the_middle_of_its_sides(points):
    bridge = landmarks_of_template(points)[27:31]
    assert np.allclose(bridge[:, 0], 620.0)
    assert np.allclose(np.diff(bridge[:, 1], n=2), 0.0)
    assert bridge[0, 1] == pytest.approx(713.0) and bridge[3, 1] == pytest.approx(785.0)


def test_jaw_and_outer_lips_begin_and_end_at_points_of_the_template(points):
    landmarks = landmarks_of_template(points)
    assert np.allclose(landmarks[[0, 8, 16]], points[[109, 129, 112]])
    assert np.allclose(landmarks[48:55], points[OUTER_LIPS])
    assert np.allclose(landmarks[[57, 33, 61, 65]], points[[106, 55, 95, 102]])


def test_landmarks_stay_at_their_place_in_a_photo_that_is_cut_and_reduced(tmp_path, points):
    photo(tmp_path / "001_03.jpg", points)
    assert convert([tmp_path / "001_03.jpg"], tmp_path / "set", no_face) == (1, [])
    written = np.load(tmp_path / "set" / "landmarks68.npz")
    assert written["names"].tolist() == ["001_03.jpg"]
    image = cv2.imread(str(tmp_path / "set" / "images" / "001_03.jpg"), cv2.IMREAD_GRAYSCALE).astype(float)
    assert max(image.shape) == LARGEST_SIDE
    light = np.maximum(image - 120.0, 0.0)
    rows, columns = np.indices(image.shape)
    middle = (light * columns).sum() / light.sum(), (light * rows).sum() / light.sum()
    assert np.allclose(middle, written["pts68"][0, 8], atol=0.1)


def test_a_small_photo_stays_as_it_is(points):
    image = np.zeros((216, 169, 3), np.uint8)
    landmarks = landmarks_of_template(points / 10.0)
    assert reduced(image, landmarks)[0] is image
    assert reduced(image, landmarks)[1] is landmarks


def test_photos_that_cannot_be_used_are_left_out_and_named(tmp_path, points):
    photo(tmp_path / "a.jpg", points)
    for name, content in (("b", template(points[:106])), ("c", "189\nnothing"), ("d", template(points * np.nan))):
        photo(tmp_path / f"{name}.jpg", points)
        (tmp_path / f"{name}.tem").write_text(content)
    (tmp_path / "e.jpg").write_text("no image")
    photo(tmp_path / "f.jpg", points)
    (tmp_path / "f.tem").unlink()
    pictures, left_out = convert(sorted(tmp_path.glob("*.jpg")), tmp_path / "set", no_face)
    assert pictures == 1
    assert [reason.partition(" is left out: ")[0] for reason in left_out] == [f"{name}.jpg" for name in "bcdef"]
    assert "its template has 106 points" in left_out[0]
    assert "its template is damaged" in left_out[1]
    assert "its template has points that are not numbers" in left_out[2]
    assert "it is not an image" in left_out[3]
    assert "MediaPipe finds no face" in left_out[4]
    assert np.load(tmp_path / "set" / "landmarks68.npz")["names"].tolist() == ["a.jpg"]


def test_every_third_frame_of_a_clip_is_a_picture_of_one_person(tmp_path):
    clip = cv2.VideoWriter(str(tmp_path / "who_talks.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for shade in range(7):
        clip.write(np.full((48, 64, 3), 30 * shade, np.uint8))
    clip.release()

    def lighter(image):
        return np.full((68, 2), image.mean()) if image.mean() > 10.0 else np.full((68, 2), np.nan)

    pictures, left_out = convert([tmp_path / "who_talks.avi"], tmp_path / "clips", lighter)
    assert (pictures, left_out) == (2, ["who_talks_0000 is left out: MediaPipe finds no face"])
    labels = np.load(tmp_path / "clips" / "landmarks68.npz")
    assert labels["names"].tolist() == ["who_talks_0003.jpg", "who_talks_0006.jpg"]
    assert np.allclose(labels["pts68"][:, 0, 0], [90.0, 180.0], atol=3.0)
    assert {person_of(CLIPS, name) for name in labels["names"]} == {"clips:who_talks"}


def test_a_clip_that_cannot_be_read_is_left_out_and_named(tmp_path):
    (tmp_path / "broken.mp4").write_text("no clip")
    assert convert([tmp_path / "broken.mp4"], tmp_path / "clips", no_face) == (
        0,
        ["broken.mp4 is left out: it is not an image"],
    )


def test_a_folder_without_photos_is_one_clear_error(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["faces", str(tmp_path), "canada", "--data", str(tmp_path)])
    with pytest.raises(SystemExit):
        main()
    assert "There is no *.jpg in" in capsys.readouterr().err

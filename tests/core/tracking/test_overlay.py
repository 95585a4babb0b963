"""Drawn landmarks, contact sheets, and the progress line."""

import io

import numpy as np

from facemime.cli.console import Progress
from facemime.core.heads.built_in import load_head
from facemime.core.tracking.overlay import contact_sheet, draw_face, draw_frame, draw_label, draw_landmarks


def face(scale: float, x: float, y: float) -> np.ndarray:
    """Landmarks (66, 2) of the built-in head, at `scale` pixels per metre, centred on (x, y)."""
    head = load_head()
    points = head.vertices[head.landmarks][:, :2].astype(float)
    return (points - points.mean(axis=0)) * scale + (x, y)


def drawn_centre(picture: np.ndarray) -> np.ndarray:
    """Mean (x, y) of the green lines."""
    rows, columns = np.nonzero((picture[..., 1] > 150) & (picture[..., 0] < 130))
    return np.array([columns.mean(), rows.mean()])


def test_landmarks_are_drawn_on_a_copy():
    image = np.zeros((480, 640, 3), np.uint8)
    points = face(1200.0, 400.0, 200.0)
    picture = draw_landmarks(image, points)
    assert not image.any() and picture.any()
    low, high = points.min(axis=0) - 4, points.max(axis=0) + 4
    rows, columns = np.nonzero(picture.any(axis=2))
    assert low[0] <= columns.min() and columns.max() <= high[0] and low[1] <= rows.min() and rows.max() <= high[1]


def test_lost_faces_are_not_drawn_and_distant_ones_do_no_harm():
    image = np.full((48, 64, 3), 7, np.uint8)
    np.testing.assert_array_equal(draw_landmarks(image, np.full((66, 2), np.nan)), image)
    np.testing.assert_array_equal(draw_landmarks(image, face(100.0, 1e7, -1e7)), image)


def test_landmarks_stay_on_the_face_when_the_image_is_scaled_or_cropped():
    image = np.zeros((240, 320, 3), np.uint8)
    points = face(600.0, 100.0, 120.0)
    image[int(points[:, 1].min()) : int(points[:, 1].max()), int(points[:, 0].min()) : int(points[:, 0].max()), 2] = 255
    for picture in (draw_frame(image, points, 800, 600), draw_face(image, points, 300)):
        rows, columns = np.nonzero(picture[..., 2] > 200)
        red = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
        green = np.array(np.nonzero(picture[..., 1] > 150)[::-1])
        middle = (green.min(axis=1) + green.max(axis=1)) / 2
        assert np.abs(red - middle).max() < 6.0


def test_a_sheet_contains_every_pair_once():
    pairs = [
        (np.full((10, 10, 3), 30 + 20 * i, np.uint8), np.full((10, 10, 3), 40 + 20 * i, np.uint8)) for i in range(5)
    ]
    sheet = contact_sheet(pairs, columns=3, gap=2)
    assert sheet.shape == (2 * 10 + 3 * 2, 3 * 20 + 4 * 2, 3)
    for left, right in pairs:
        assert (sheet == left[0, 0]).all(axis=2).sum() >= 100 and (sheet == right[0, 0]).all(axis=2).sum() >= 100


def test_a_label_is_drawn_on_a_copy():
    image = np.zeros((100, 200, 3), np.uint8)
    assert draw_label(image, "1.25 s").any() and not image.any()


def test_progress_is_one_line_without_a_terminal():
    stream = io.StringIO()
    progress = Progress("Tracking", 10, stream)
    for i in range(10):
        progress.update(i + 1)
    progress.finish("a face in 9 of 10")
    lines = stream.getvalue().splitlines()
    assert len(lines) == 1 and lines[0].startswith("Tracking: 10 frames in") and lines[0].endswith("a face in 9 of 10")


def test_progress_on_a_terminal_shows_count_rate_and_time_left():
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    Progress("Tracking", 200, stream).update(50)
    assert "[#####...............] 50/200" in stream.getvalue() and "s left" in stream.getvalue()

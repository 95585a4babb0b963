"""The benchmark on the user's own labelled faces."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.base.errors import SourceError
from facemime.core.base.landmarks import IBUG68_INDICES
from lab.bench import wild

SAMPLE = Path(__file__).parents[2] / "assets" / "sample"


def write_points(path: Path, landmarks: np.ndarray) -> None:
    """A `.pts` file of (66, 2) landmarks; the two that Facemime does not use are at the corners of the mouth."""
    every = np.full((68, 2), landmarks[48])
    every[IBUG68_INDICES] = landmarks
    lines = "\n".join(f"{x + 1.0:.3f} {y + 1.0:.3f}" for x, y in every)
    path.write_text(f"version: 1\nn_points: 68\n{{\n{lines}\n}}\n", encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three frames of the sample clip in folders, with their exact landmarks."""
    video = cv2.VideoCapture(str(SAMPLE / "sample.mp4"))
    with np.load(SAMPLE / "sample_landmarks.npz", allow_pickle=False) as truth:
        landmarks = truth["landmarks"].astype(np.float64)
    for i in range(3):
        path = tmp_path / ("deeper" if i else ".") / f"{i}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), video.read()[1])
        write_points(path.with_suffix(".pts"), landmarks[i])
    return tmp_path


def test_points_are_read_as_they_were_written(tmp_path: Path) -> None:
    landmarks = np.random.default_rng(0).uniform(0, 500, (66, 2)).round(3)
    write_points(tmp_path / "a.pts", landmarks)
    np.testing.assert_allclose(wild.read_points(tmp_path / "a.pts"), landmarks, atol=1e-9)


def test_a_crop_shows_the_face_with_its_margin_and_translates_landmarks(folder: Path) -> None:
    whole, cut = wild.read_faces(folder, 100.0)[0], wild.read_faces(folder, 0.2)[0]
    size = np.ptp(cut[1], axis=0).max()
    assert max(cut[0].shape[:2]) < 1.5 * size + 3 and whole[0].shape == (480, 640, 3)
    away = (whole[1] - cut[1]).mean(axis=0).round().astype(int)
    shown = whole[0][away[1] : away[1] + cut[0].shape[0], away[0] : away[0] + cut[0].shape[1]]
    np.testing.assert_array_equal(shown, cut[0])


def test_sample_faces_have_their_known_error_and_an_image_without_one_is_lost(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    landmarks = wild.read_faces(folder, 100.0)[0][1]
    cv2.imwrite(str(folder / "none.png"), np.full((480, 640, 3), 120, np.uint8))
    write_points(folder / "none.pts", landmarks)
    assert wild.main([str(folder), "--only", "Facemime", "--json", str(folder / "out.json")]) == 0
    ours = json.loads((folder / "out.json").read_text())["trackers"]["Facemime"]
    assert ours["faces"] == 4 and ours["lost"] == "25.0%"
    assert 2.0 < ours["raw"] < 4.0 and ours["removed"] < 1.0
    assert "| Facemime | 4 |" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "{ 1 2 3 }", "{ a b }", "no braces"])
def test_a_file_without_68_points_is_reported(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.pts").write_text(text, encoding="utf-8")
    with pytest.raises(SourceError, match=r"a\.pts does not contain 68 points"):
        wild.read_points(tmp_path / "a.pts")


def test_a_folder_without_labelled_faces_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no images with \.pts files"):
        wild.read_faces(tmp_path, 1.0)

"""The text and the pictures of the extension's page."""

import re
from pathlib import Path

import cv2
import numpy as np

from tools import release_pictures

FOLDER = Path(__file__).parents[2] / "docs" / "release"


def test_the_page_has_an_icon_a_thumbnail_and_five_pictures():
    icon = cv2.imread(str(FOLDER / "icon.png"), cv2.IMREAD_UNCHANGED)
    assert icon.shape == (256, 256, 4) and icon[0, 0, 3] == 0 and icon[128, 128, 3] == 255
    assert cv2.imread(str(FOLDER / "thumbnail.jpg")).shape == (1080, 1920, 3)
    pictures = re.findall(r"\]\((\.\./\S+\.png)\)", (FOLDER / "README.md").read_text(encoding="utf-8"))
    assert len(set(pictures)) == 5 and all((FOLDER / picture).is_file() for picture in pictures)


def test_the_icon_and_the_thumbnail_are_those_that_the_tool_makes():
    np.testing.assert_allclose(
        cv2.imread(str(FOLDER / "icon.png"), cv2.IMREAD_UNCHANGED).astype(float), release_pictures.icon(), atol=8.0
    )
    thumbnail = cv2.imread(str(FOLDER / "thumbnail.jpg")).astype(float)
    assert np.abs(thumbnail - release_pictures.thumbnail()).mean() < 4.0

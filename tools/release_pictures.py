"""Make the icon and the thumbnail of the extension's page: `python tools/release_pictures.py docs/release`.

The icon is the mean face's landmarks; the thumbnail is the README's first picture on the platform's format.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.core.face.landmarks import EDGES
from facemime.core.heads.rig import built_in_head

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
ICON = 256
THUMBNAIL = (1920, 1080)
_FINE = 4
"""Factor by which the icon is drawn larger, as lines and corners are smooth then."""
_FACE = 0.72
"""Share of the icon's height that the face takes."""
_DARK, _LINE, _POINT = (48, 38, 32), (140, 220, 120), (255, 255, 255)


def icon() -> NDArray[np.uint8]:
    """Draw the landmarks of the built-in head on a dark square with round corners, (256, 256, 4) BGRA."""
    side = ICON * _FINE
    rig = built_in_head()
    points = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks][:, :2]
    points -= (points.min(axis=0) + points.max(axis=0)) / 2.0
    points = points * (_FACE * side / np.ptp(points[:, 1])) + side / 2.0
    picture = np.full((side, side, 3), _DARK, dtype=np.uint8)
    for one, other in EDGES:
        ends = [tuple(np.rint(points[end]).astype(int).tolist()) for end in (one, other)]
        cv2.line(picture, ends[0], ends[1], _LINE, side // 56, cv2.LINE_AA)
    for point in np.rint(points).astype(int).tolist():
        cv2.circle(picture, tuple(point), side // 64, _POINT, cv2.FILLED, cv2.LINE_AA)
    rows, columns = np.mgrid[:side, :side]
    radius = side / 6.0
    away = [np.maximum(np.abs(each - (side - 1) / 2.0) - (side / 2.0 - radius), 0.0) for each in (rows, columns)]
    alpha = np.where(np.hypot(*away) <= radius, 255, 0).astype(np.uint8)
    drawn = np.dstack([picture, alpha])
    return np.asarray(cv2.resize(drawn, (ICON, ICON), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def thumbnail() -> NDArray[np.uint8]:
    """Put the README's picture on a dark ground, (1080, 1920, 3) BGR."""
    real = cv2.imread(str(IMAGES / "real.jpg"))
    size = (THUMBNAIL[0], round(THUMBNAIL[0] * real.shape[0] / real.shape[1]))
    picture = np.full((THUMBNAIL[1], THUMBNAIL[0], 3), real[2, 2], dtype=np.uint8)
    top = (THUMBNAIL[1] - size[1]) // 2
    picture[top : top + size[1]] = cv2.resize(real, size, interpolation=cv2.INTER_CUBIC)
    return picture


def main(folder: Path) -> int:
    """Write both; return the exit status."""
    cv2.imwrite(str(folder / "icon.png"), icon())
    cv2.imwrite(str(folder / "thumbnail.jpg"), thumbnail(), [cv2.IMWRITE_JPEG_QUALITY, 90])
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

"""Labels irises in photos and clips: `build/peers/bin/python -m lab.training.tracker.irises`.

MediaPipe's Face Mesh, which `tools/requirements/peers.txt` installs, reads the centres of irises, where it agrees with
the tracker that ships about the corners of the eyes. Those who are held out from training are left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import OUTER_EYE_CORNERS
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.peers.mediapipe478 import MediaPipe

from ..data import ROOT, add_data_option
from .pupils import PupilSamples, eyes_of
from .samples import canonical_photo
from .sources import AUTOMATIC, CLIPS, HAND_LABELLED, Photo, read_photos, split

IRISES = "irises"
"""Folder of the labelled photos and clips, below that of the workshop's results."""
_OUTER, _CENTRES = (33, 263), (468, 473)
"""MediaPipe's outer corners of the eyes, and the centres of the irises, of which the right eye's are the first."""
_AGREEMENT = 0.12
"""Largest distance between both corners, in outer-eye distances."""

Row = tuple[np.ndarray, np.ndarray, np.ndarray]


class Labeller:
    """Labels the irises of tracked faces."""

    def __init__(self) -> None:
        self._peer = MediaPipe((*_OUTER, *_CENTRES))
        self._tracker = FaceTracker.load()

    def labelled(self, photos: Iterable[Photo]) -> Iterator[Row]:
        """Yield the rows of `PupilSamples` for the faces of photos in which both agree."""
        for photo in photos:
            image = cv2.imread(str(photo.path))
            yield from self._labelled(image, self._tracker.locate(image))

    def _labelled(self, image: np.ndarray, result: TrackResult) -> Iterator[Row]:
        points = self._peer.locate(image)
        if not result.found or not np.isfinite(points).all():
            return
        apart = np.linalg.norm(points[:2] - result.landmarks[OUTER_EYE_CORNERS], axis=1)
        if apart.max() > _AGREEMENT * result.pose[0]:
            return
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        upright, landmarks, _ = canonical_photo(self._tracker.pdm, grey, result.landmarks)
        # The same similarity takes the irises there.
        to = np.linalg.lstsq(_with_ones(result.landmarks), landmarks, rcond=None)[0]
        yield eyes_of(upright, landmarks, _with_ones(points[2:]) @ to)


def _with_ones(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.ones(len(points))])


def main() -> None:
    """Label photos and clips, and write one file for each."""
    parser = argparse.ArgumentParser(prog="python -m lab.training.tracker.irises", description=__doc__.splitlines()[0])
    add_data_option(parser)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "model", help="folder of the results")
    options = parser.parse_args()
    sources = {"photos": (*HAND_LABELLED, *AUTOMATIC)}
    if (options.data / "faces" / CLIPS).is_dir():
        sources["clips"] = (CLIPS,)
    labeller = Labeller()
    for name, folders in sources.items():
        photos, _ = split(read_photos(options.data, *folders))
        labelled = list(labeller.labelled(photos))
        if labelled:
            images, eyes, pupils = zip(*labelled, strict=True)
            samples = PupilSamples(np.stack(images), np.float32(eyes), np.float32(pupils))
            samples.save(options.work / IRISES / f"{name}.npz")
        print(f"{name}: {len(labelled)}")


if __name__ == "__main__":
    sys.exit(main())

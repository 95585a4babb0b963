"""Smiles that last for a whole take: `python -m lab.bench.smiles --data DIR`.

Of people who were photographed both at rest and smiling, the smiling portrait alone is a take, in which nothing rests.
The smile that remains, relative to the neutral face that Facemime estimates, is compared with the difference between
both portraits; and what the portrait at rest alone shows should be nothing. The people are divided into two halves of
alternate ones: what is chosen on one has to hold on the other.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import TakeRecorder, describe
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.expressions import features
from lab.bench.report import Table, finish, parser
from lab.training.tracker.sources import read_photos

_FEATURES = ("smile", "width", "jaw")
_REPEATED = 5
"""Times that a portrait is tracked, after which landmarks have settled."""
_FPS = 25.0


def main() -> int:
    """Measure and print."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with faces/")
    arguments = command.parse_args()
    tracker = FaceTracker.load()
    at_rest, smiling = (_portraits(arguments.data, f"london_{what}", tracker) for what in ("neutral", "smiling"))
    people = sorted(at_rest.keys() & smiling.keys())
    rows = []
    for half, chosen in (("A", people[::2]), ("B", people[1::2])):
        pairs = [(at_rest[person], smiling[person]) for person in chosen]
        for name in _FEATURES:
            true = np.array([features(smile[:1], rest[0])[name][0] for rest, smile in pairs])
            nothing, shown = (
                np.array([features(face[:1], face[1])[name][0] for face in faces]) for faces in zip(*pairs, strict=True)
            )
            error = np.sqrt(np.square(shown - true).mean())
            rows.append((half, name, len(pairs), true.mean(), shown.mean(), error, np.sqrt(np.square(nothing).mean())))
    columns = ("half", "feature", "people", "smile", "shown", "rms error", "shown at rest, rms")
    finish(arguments, [Table("Lasting smiles", columns, rows)], {})
    return 0


def _portraits(data: Path, source: str, tracker: FaceTracker) -> dict[str, np.ndarray]:
    """By person, the shape tracked in a portrait and the neutral face of the take that repeats it, (2, 66, 3)."""
    found = {}
    for photo in read_photos(data, source):
        image = cv2.imread(str(photo.path))
        recorder = TakeRecorder(describe(photo.name, _FPS, image.shape[1::-1], tracker.model_id))
        tracker.reset()
        for frame in range(_REPEATED):
            recorder.append(frame / _FPS, tracker.track(image))
        take = recorder.finish()
        if take.found[-1]:
            found[photo.person] = np.stack([take.shape[-1].astype(np.float64), calibrate(take).shape])
        else:
            print(f"{source} {photo.name} is left out: no face was found", file=sys.stderr)
    return found


if __name__ == "__main__":
    sys.exit(main())

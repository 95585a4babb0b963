"""Labelled faces in the wild: `python -m lab.bench.wild FOLDER`.

The folder, or its subfolders, contains images, each with a `.pts` file of the same name: the 68 points of the iBUG
figure, as in 300-W, AFW, HELEN and LFPW. None of these comes with Facemime.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from facemime.core.errors import FacemimeError, SourceError
from facemime.core.face.landmarks import IBUG68_INDICES
from facemime.core.files.capture import IMAGE_SUFFIXES, read_image
from lab.bench.accuracy import LOST_ABOVE, Located, differences, eye_distances, locate_all
from lab.bench.peers import Peer, add_options, chosen_peers
from lab.bench.report import Table, finish, parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("folder", type=Path)
    add_options(command)
    command.add_argument(
        "--margin",
        type=float,
        default=1.0,
        help="margin to show around a face, relative to its size, as there may be other faces in the image (1)",
    )
    arguments = command.parse_args(argv)
    cv2.setNumThreads(1)
    try:
        faces = read_faces(arguments.folder, arguments.margin)
    except FacemimeError as error:
        command.error(str(error))
    _, peers = chosen_peers(arguments)
    measured = {peer.name: measure(peer, faces) for peer in peers}
    columns = ("tracker", "faces", "error, %", "offset removed, %", "lost", "locate, ms")
    rows = [(name, *m.values()) for name, m in measured.items()]
    finish(arguments, [Table(f"Faces of {arguments.folder.name}", columns, rows)], {"trackers": measured})
    return 0


def read_faces(folder: Path, margin: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return images (H, W, 3) and landmarks (66, 2), in pixels, of every labelled face below `folder`.

    Raises SourceError if there is none, or a file is invalid.
    """
    pictures = sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
    labelled = [p for p in pictures if p.with_suffix(".pts").is_file()]
    if not labelled:
        raise SourceError(f"{folder} has no images with .pts files beside them. Choose a folder of labelled faces.")
    return [_around(read_image(p), read_points(p.with_suffix(".pts")), margin) for p in labelled]


def read_points(path: Path) -> np.ndarray:
    """Landmarks (66, 2) of a `.pts` file, converted from a first pixel of (1, 1) to (0, 0)."""
    try:
        inside = path.read_text(encoding="utf-8").split("{", 1)[1].split("}", 1)[0]
        points = np.array(inside.split(), np.float64).reshape(68, 2) - 1.0
    except (OSError, UnicodeDecodeError, IndexError, ValueError) as error:
        raise SourceError(f"{path} does not contain 68 points ({error}).") from error
    return points[IBUG68_INDICES]


def measure(peer: Peer, faces: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, object]:
    """Results of a tracker; lost faces have the largest error."""
    located: Located = locate_all(peer, (picture for picture, _ in faces))
    truth = np.stack([landmarks for _, landmarks in faces])
    away = differences(located.landmarks, truth, eye_distances(truth))
    raw, removed = away.errors(), away.errors(away.offsets())
    return {
        "faces": len(faces),
        "raw": float(np.median(raw)),
        "removed": float(np.median(removed)),
        "lost": f"{(raw > LOST_ABOVE).mean():.1%}",
        "locate_ms": float(np.median(located.seconds) * 1e3),
    }


def _around(picture: np.ndarray, landmarks: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Crop an image to a face with a `margin`, as a share of its size, and translate its landmarks."""
    low, high = landmarks.min(axis=0), landmarks.max(axis=0)
    reach = (0.5 + margin) * float((high - low).max())
    first = np.maximum((low + high) / 2.0 - reach, 0.0).astype(int)
    last = ((low + high) / 2.0 + reach).astype(int) + 1
    return picture[first[1] : last[1], first[0] : last[0]].copy(), landmarks - first


if __name__ == "__main__":
    sys.exit(main())

"""The labelled photographs: reading, splitting by person, and weighting by trust in their labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import IBUG68_INDICES, MIRROR, OUTER_EYE_CORNERS

HELD_OUT_FILE = Path(__file__).with_name("held_out.txt")
HAND_LABELLED = ("london_neutral", "canada")
AUTOMATIC = ("london_smiling", "congress")
CLIPS = "clips"
"""Frames of clips of people who talk, with automatic labels; they may be missing."""


@dataclass(frozen=True)
class Photo:
    """One labelled photograph.

    Attributes
    ----------
    source, name : str
        Folder below `faces/` and file name.
    person : str
        Equal for every picture of the same person.
    path : Path
    landmarks : (66, 2) float64
        Pixels.
    """

    source: str
    name: str
    person: str
    path: Path
    landmarks: np.ndarray

    @property
    def by_hand(self) -> bool:
        """Whether the landmarks were placed by hand."""
        return self.source in HAND_LABELLED

    def grey(self) -> np.ndarray:
        """(H, W) uint8."""
        image = cv2.imread(str(self.path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise FileNotFoundError(self.path)
        return image

    def eye_distance(self) -> float:
        """Distance of the outer eye corners in pixels."""
        a, b = self.landmarks[OUTER_EYE_CORNERS]
        return float(np.linalg.norm(a - b))


def person_of(source: str, name: str) -> str:
    """Return `london:001` for both images of a London person, `canada:003f`, `congress:001366`, `clips:cap12_edit`."""
    stem = Path(name).stem
    if source == CLIPS:
        return f"{source}:{stem.rpartition('_')[0]}"
    return f"london:{stem.split('_')[0]}" if source.startswith("london") else f"{source}:{stem}"


def read_photos(data: Path, *sources: str) -> list[Photo]:
    """Return every photo in the given folders, in the order of their files."""
    photos = []
    for source in sources:
        folder = data / "faces" / source
        labels = np.load(folder / "landmarks68.npz", allow_pickle=False)
        points = labels["pts68"][:, IBUG68_INDICES].astype(np.float64)
        photos += [
            Photo(source, str(name), person_of(source, str(name)), folder / "images" / str(name), p)
            for name, p in zip(labels["names"], points, strict=True)
        ]
    return photos


def held_out_people() -> set[str]:
    """Return the people whose images no training may see, from `held_out.txt`."""
    lines = HELD_OUT_FILE.read_text(encoding="utf-8").splitlines()
    return {line.strip() for line in lines if line.strip() and not line.startswith("#")}


def split(photos: list[Photo]) -> tuple[list[Photo], list[Photo]]:
    """Return the photos of people to train on, and of those held out."""
    held = held_out_people()
    return [p for p in photos if p.person not in held], [p for p in photos if p.person in held]


def mirrored(image: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image (H, W) flipped left to right, and its landmarks (66, 2)."""
    flipped = landmarks[MIRROR].copy()
    flipped[:, 0] = image.shape[1] - 1 - flipped[:, 0]
    return np.ascontiguousarray(image[:, ::-1]), flipped

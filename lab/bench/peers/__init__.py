"""Other trackers for comparison. None is shipped; those that are not installed are skipped.

All implement `Peer`: `locate` processes an image by itself, `track` follows a face through a clip.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from facemime.core.tracking.tracker import FaceTracker
from lab.training.data import add_data_option


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options that choose the trackers."""
    command.add_argument("--model", type=Path, help="tracker model (the shipped one)")
    add_data_option(command)
    command.add_argument("--only", action="append", metavar="TRACKER", help="use this tracker only; may be repeated")


def chosen_peers(arguments: argparse.Namespace) -> tuple[FaceTracker, list[Peer]]:
    """Return Facemime's tracker and those that the options choose; report which are skipped."""
    tracker = FaceTracker.load(arguments.model)
    peers, absent = available_peers(arguments.data, tracker)
    print(f"model {tracker.model_id}", *absent, sep="\n", file=sys.stderr)
    return tracker, [p for p in peers if not arguments.only or p.name in arguments.only]


class Peer(Protocol):
    """Interface of a tracker."""

    name: str

    def locate(self, image: np.ndarray) -> np.ndarray:
        """Return landmarks (66, 2) of the largest face in a BGR image (H, W, 3), or NaN if it finds no face."""

    def track(self, image: np.ndarray) -> np.ndarray:
        """Return landmarks (66, 2) in the next frame of a clip; NaN if lost."""

    def reset(self) -> None:
        """Forget the clip."""


class Ours:
    """Facemime's tracker as a peer; `result` is its last complete result."""

    name = "Facemime"

    def __init__(self, tracker: FaceTracker) -> None:
        self.tracker = tracker

    def locate(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.locate`."""
        self.result = self.tracker.locate(image)
        return self.result.landmarks

    def track(self, image: np.ndarray) -> np.ndarray:
        """See `Peer.track`."""
        self.result = self.tracker.track(image)
        return self.result.landmarks

    def reset(self) -> None:
        """See `Peer.reset`."""
        self.tracker.reset()


class Live(Ours):
    """Facemime's tracker as it runs live: some work is spread over frames, and half of the networks run beside."""

    name = "Facemime, live"


def available_peers(data: Path, tracker: FaceTracker) -> tuple[list[Peer], list[str]]:
    """Return the installed peers, Facemime's tracker first, and why others are skipped."""
    from .dlib68 import Dlib
    from .mediapipe478 import MediaPipe
    from .saragih import Saragih

    makers: dict[str, Callable[[], Peer]] = {
        Saragih.name: lambda: Saragih(data / "models" / "saragih_facetracker" / "model" / "face2.tracker", tracker),
        Dlib.name: Dlib,
        MediaPipe.name: MediaPipe,
    }
    peers: list[Peer] = [Ours(tracker)]
    absent = []
    for name, make in makers.items():
        try:
            peers.append(make())
        except (ImportError, FileNotFoundError) as reason:
            absent.append(f"{name} is left out: {reason}")
    return peers, absent

"""Frames of a video, and their resampling to a constant rate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """A frame of a video.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR.
    time : float
        Seconds from the first frame.
    index : int
        Number of the frame in the source, from 0.
    """

    image: NDArray[np.uint8]
    time: float
    index: int


def at_constant_rate(frames: Iterable[Frame], fps: float) -> Iterator[Frame]:
    """Resample frames to a constant rate, each moment showing the frame that was on display then, with its index."""
    emitted = 0
    shown: Frame | None = None
    for frame in frames:
        while shown is not None and emitted / fps < frame.time - 0.5 / fps:
            yield Frame(shown.image, emitted / fps, shown.index)
            emitted += 1
        shown = frame
    if shown is not None:
        yield Frame(shown.image, emitted / fps, shown.index)

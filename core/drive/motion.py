"""A whole take driven through one head: what baking, previews and benchmarks read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import SourceError
from ..takes.take import Take
from .driver import HeadDriver


@dataclass(frozen=True)
class HeadMotion:
    """The frames of a take in which a face was found, driven through a head.

    Attributes
    ----------
    times : (N,) float64
        Seconds from the take's first frame. Lost frames are left out: the curves bridge them.
    vertices : (N, V, 3) float32
        Displacements from rest, head frame, the mesh's unit.
    rotation, jaw, gaze : (N, 3, 3) float64
    translation : (N, 3) float64
        As in `HeadFrame`.
    """

    times: FloatArray
    vertices: NDArray[np.float32]
    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray


def drive_take(driver: HeadDriver, take: Take, on_frame: Callable[[int], None] | None = None) -> HeadMotion:
    """Drive every frame of `take` in which a face was found; `on_frame` hears how many are done."""
    found = np.flatnonzero(take.found)
    if len(found) == 0:
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    rest = driver.deformer.rest
    vertices = np.empty((len(found), *rest.shape), dtype=np.float32)
    frames = []
    for row, index in enumerate(found):
        frame = driver.frame(take.result(int(index)))
        np.subtract(frame.vertices, rest, out=vertices[row])
        frames.append(frame)
        if on_frame is not None:
            on_frame(row + 1)
    return HeadMotion(
        times=take.times[found],
        vertices=vertices,
        rotation=np.array([frame.rotation for frame in frames]),
        translation=np.array([frame.translation for frame in frames]),
        jaw=np.array([frame.jaw for frame in frames]),
        gaze=np.array([frame.gaze for frame in frames]),
    )


def most_different(motion: HeadMotion, count: int) -> NDArray[np.intp]:
    """Up to `count` rows of `motion` whose expressions differ most, in order of time.

    Farthest-point sampling on the vertices' displacements, from the frame that is farthest from rest (Gonzalez 1985).
    """
    flat = motion.vertices.reshape(len(motion.times), -1)
    squares = np.square(flat).sum(axis=1)
    chosen = [int(np.argmax(squares))]
    distance = np.full(len(flat), np.inf, dtype=np.float32)
    while len(chosen) < min(count, len(flat)):
        last = chosen[-1]
        np.minimum(distance, np.maximum(squares + squares[last] - 2.0 * (flat @ flat[last]), 0.0), out=distance)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return np.sort(np.array(chosen, dtype=np.intp))

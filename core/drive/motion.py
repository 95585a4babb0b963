"""The motion of a head over a take, for baking, previews and benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import FloatArray
from ..base.errors import SourceError
from ..takes.take import Take
from .driver import HeadDriver


@dataclass(frozen=True)
class HeadMotion:
    """The motion of a head over the frames of a take that have a face.

    Attributes
    ----------
    times : (N,) float64
        Times in seconds from the first frame of the take. Lost frames are omitted; animation curves bridge them.
    vertices : (N, A, 3) float32
        Displacements from rest, ordered as in `HeadFrame`: head frame, unit of the mesh.
    rotation, jaw : (N, 3, 3) float64
    gaze : (N, 2, 3, 3) float64
    translation : (N, 3) float64
    actions : (N, 15) float64
        As in `HeadFrame`.
    """

    times: FloatArray
    vertices: NDArray[np.float32]
    rotation: FloatArray
    translation: FloatArray
    jaw: FloatArray
    gaze: FloatArray
    actions: FloatArray


def drive_take(driver: HeadDriver, take: Take, on_frame: Callable[[int], None] | None = None) -> HeadMotion:
    """Drive a head by all frames of a take that have a face.

    Parameters
    ----------
    driver : HeadDriver
        Driver of the head.
    on_frame : callable, optional
        Called after each frame with the number of frames done.

    Raises
    ------
    SourceError
        If no frame has a face.
    """
    found = np.flatnonzero(take.found)
    if len(found) == 0:
        raise SourceError("No face was found in any frame. Use a video with one face, well lit and towards the camera.")
    rest = driver.rest
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
        actions=np.array([frame.actions for frame in frames]),
    )


def select_distinct_frames(motion: HeadMotion, count: int) -> NDArray[np.intp]:
    """Select frames whose expressions differ most.

    Parameters
    ----------
    count : int
        Largest number of frames.

    Returns
    -------
    (n,) int
        Rows of `motion` in order of time.

    Notes
    -----
    Farthest-point sampling (Gonzalez 1985) of the displacements of the vertices, starting with the frame that is
    farthest from rest.
    """
    flat = motion.vertices.reshape(len(motion.times), -1)
    squares = np.square(flat).sum(axis=1)
    chosen = [int(np.argmax(squares))]
    distance = np.full(len(flat), np.inf, dtype=np.float32)
    while len(chosen) < min(count, len(flat)):
        last = chosen[-1]
        # |a - b|^2 = |a|^2 + |b|^2 - 2 a b; rounding can make it negative.
        np.minimum(distance, np.maximum(squares + squares[last] - 2.0 * (flat @ flat[last]), 0.0), out=distance)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return np.sort(np.array(chosen, dtype=np.intp))

"""Messages from the server to the page, little-endian (viewer.md)."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import cv2
import numpy as np

from ..drive.driver import HeadFrame
from ..numeric.arrays import FloatArray
from .model import ViewerModel

FRAME, CLOCK = 1, 2
"""Kinds of messages."""
CLOCK_REQUEST = struct.Struct("<d")
"""The only message that a page sends: its own time."""
_FRAME_HEADER = struct.Struct("<BBHId")
_CLOCK = struct.Struct("<B7xdd")
_STEP = 2.0**-14
"""Step of displacements, in outer-eye distances."""
_AMOUNT_STEP = 2.0**-13
"""Step of amounts."""


def encode_frame(
    scene: int,
    number: int,
    taken: float,
    models: Sequence[ViewerModel],
    frames: Sequence[HeadFrame],
    follow: tuple[bool, bool],
) -> bytes:
    """Encode a frame of all heads.

    Parameters
    ----------
    scene : int
        Number of the list of heads to which the frame belongs, modulo 65,536.
    number : int
        Number of the frame, modulo 2^32.
    taken : float
        `time.perf_counter()` when the frame arrived.
    frames : sequence of HeadFrame
        A frame for each head; empty if there is no face.
    follow : (bool, bool)
        Whether heads follow the performer's rotation and translation.
    """
    parts = [_FRAME_HEADER.pack(FRAME, len(frames), scene & 0xFFFF, number & 0xFFFFFFFF, taken)]
    for model, frame in zip(models, frames, strict=False):
        moved = frame.displacements / model.unit if model.landmarks else np.empty(0)
        amounts = frame.keys if len(frame.keys) else frame.actions[: model.amounts]
        body = _pose(frame, follow) + _shorts(moved, _STEP) + _shorts(amounts, _AMOUNT_STEP)
        parts += [body, b"\0" * (-len(body) % 4)]
    return b"".join(parts)


def encode_clock(sent: float, now: float) -> bytes:
    """Encode the answer to a request for the time.

    Parameters
    ----------
    sent : float
        Time of the page that asked, from its request.
    now : float
        Time of the server in seconds.
    """
    return _CLOCK.pack(CLOCK, sent, now)


def _pose(frame: HeadFrame, follow: tuple[bool, bool]) -> bytes:
    """Encode 16 float32: rotation vectors of head, jaw, right and left eye; translation; the tongue."""
    turned = frame.rotation if follow[0] else np.eye(3)
    moved = frame.translation if follow[1] else np.zeros(3)
    turns = [_vector(turn) for turn in (turned, frame.jaw, *frame.gaze)]
    return np.concatenate([*turns, moved, [frame.tongue]]).astype("<f4").tobytes()


def _vector(rotation: FloatArray) -> FloatArray:
    return np.array(cv2.Rodrigues(np.asarray(rotation, dtype=np.float64))[0], dtype=np.float64).ravel()


def _shorts(values: FloatArray, step: float) -> bytes:
    steps = np.clip(np.rint(np.ravel(values) / step), -32767, 32767)
    return bytes(steps.astype("<i2").tobytes())

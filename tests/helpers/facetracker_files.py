"""Files in the layout of FaceTracker's model, from Facemime's own shape model and templates of its sample clip."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import islice

import cv2
import numpy as np

from facemime.core.files.assets import ASSETS
from facemime.core.files.capture import VideoSource
from facemime.core.tracking.linear_experts import LinearExpert
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.reference import warp_to_reference
from facemime.core.tracking.tracker import FaceTracker

SCALE = 23.0
"""Pixels per outer-eye distance."""
SIDE = 11
YAWS = (0.0, 0.7, -0.7)
Experts = Sequence[Sequence[Sequence[LinearExpert]]]


def matrix(values: np.ndarray, kind: int = 6) -> str:
    """Write a matrix: rows, columns, type, values."""
    flat = np.atleast_2d(values)
    form = "d" if kind == 4 else ".9g"
    numbers = " ".join(format(int(v) if kind == 4 else v, form) for v in flat.ravel())
    return f"{flat.shape[0]} {flat.shape[1]} {kind} {numbers} "


def facetracker_file(pdm: PointDistributionModel, experts: Experts, yaws: Sequence[float] = YAWS) -> bytes:
    """Write a model whose mean shape is in pixels about its centre, and experts of each view and landmark."""
    centre = pdm.mean_shape.mean(axis=0)
    mean = SCALE * (pdm.mean_shape - centre)
    columns = (SCALE * pdm.basis).transpose(1, 0, 2).reshape(198, -1)
    text = f"8 4 {len(yaws)} 0 " + matrix(columns) + matrix(pdm.eigenvalues) + matrix(mean.T.reshape(-1, 1))
    text += matrix(mean[:, :2].T.reshape(-1, 1))
    text += "".join(matrix(np.array([[0.0], [yaw], [0.0]])) for yaw in yaws)
    text += "".join(matrix(np.array([[int(bool(own))] for own in view]), 4) for view in experts)
    for view in experts:
        for own in view:
            text += f"3 {SIDE} {SIDE} {len(own)} " if own else "3 -1163005939 7 0 "
            text += "".join(f"2 {e.kind} {e.gain:.9g} {e.offset:.9g} " + matrix(e.weights, 5) for e in own)
    detector, checks = "5 2 30 1.0 1.1 0 24 24 ", "7 0 "
    return (text + detector + checks + matrix(mean[:, :2].T.reshape(-1, 1)) + "1 0 0 0 ").encode() + b"\xff \x00 "


@cache
def small_pdm(modes: int = 12) -> PointDistributionModel:
    """The first modes of Facemime's shape model."""
    ours = FaceTracker.load().pdm
    return PointDistributionModel(ours.mean_shape, ours.basis[:, :, :modes], ours.eigenvalues[:modes])


@cache
def sample_experts() -> tuple[tuple[tuple[LinearExpert, ...], ...], ...]:
    """Experts that correlate with the mean patch of each landmark in every tenth frame of the sample clip."""
    truth = np.load(ASSETS / "sample" / "sample_landmarks.npz")["landmarks"].astype(float)
    pdm, size, half = FaceTracker.load().pdm, 120, SIDE // 2
    sums = np.zeros((66, SIDE, SIDE))
    with VideoSource(ASSETS / "sample" / "sample.mp4") as video:
        for frame, places in islice(zip(video, truth, strict=False), 0, None, 10):
            grey = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY), np.uint8)
            seen = warp_to_reference(grey, pdm.fit(places).pose, SCALE, (size, size))
            for i, (x, y) in enumerate(np.round(places @ seen.linear.T + seen.offset).astype(int)):
                patch = seen.pixels[y - half : y + half + 1, x - half : x + half + 1].astype(float)
                sums[i] += (patch - patch.mean()) / (patch.std() + 4.0)
    frontal = tuple((LinearExpert(0, -14.0, 9.0, weights.astype(np.float32)),) for weights in sums)
    return (frontal, frontal, frontal)


@cache
def sample_file() -> bytes:
    """The file of `small_pdm` and `sample_experts`."""
    return facetracker_file(small_pdm(), sample_experts())

"""Symmetry of rigs: controls that mirror each other get effects that mirror each other (method.md, section 9.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import MIRROR, outer_eye_distance, symmetry_plane
from ..heads.symmetry import mirror_images
from ..numeric.arrays import FloatArray, IntArray
from .rig_map import Probe

_EVEN = 0.02
"""Distance of mirrored vertices from the nearest ones, in eye distances, up to which they are their mirror images."""
_MOST = 0.9
"""Share of the vertices of a face that have a mirror image if it is symmetric."""
_ALIKE = 0.8
"""Cosine of the effects of two channels, one mirrored, from which they mirror each other."""


@dataclass(frozen=True)
class Symmetry:
    """The mirror image of each sampled vertex, (S,), and the unit vector (3,) across the face."""

    images: IntArray
    across: FloatArray

    def mirrored(self, moved: FloatArray) -> FloatArray:
        """Mirror displacements (..., S, 3)."""
        images = moved[..., self.images, :]
        return np.asarray(images - 2.0 * (images @ self.across)[..., None] * self.across)


def face_images(vertices: FloatArray, landmarks: IntArray, face: IntArray) -> NDArray[np.intp] | None:
    """Find the mirror image of each vertex of a face, (F,), among them; None if the face is not symmetric.

    `vertices` is (V, 3), and `face` has the indices of those of the face.
    """
    points = vertices[landmarks]
    images, off = mirror_images(vertices[face], *symmetry_plane(points))
    return np.asarray(face[images]) if (off < _EVEN * outer_eye_distance(points)).mean() > _MOST else None


def symmetry_of(vertices: FloatArray, landmarks: IntArray, sample: IntArray) -> Symmetry | None:
    """Return the symmetry of sampled vertices (S,), of which the first are the landmarks.

    Returns None if the face is not symmetric.
    """
    others = sample[len(landmarks) :]
    images = face_images(vertices, landmarks, others)
    if images is None:
        return None
    places = {int(vertex): row for row, vertex in enumerate(others.tolist(), start=len(landmarks))}
    rows = [*MIRROR.tolist(), *(places[int(image)] for image in images.tolist())]
    return Symmetry(np.array(rows, dtype=np.intp), symmetry_plane(vertices[landmarks])[1])


def even_probes(probes: Sequence[Sequence[Probe]], symmetry: Symmetry) -> list[list[Probe]]:
    """Give directions of channels that mirror each other the mean of both effects; a rig is never quite symmetric.

    They are recognised by what they do, not by their names: each is the other's nearest mirror image.
    """
    flat = [probe for probed in probes for probe in probed]
    if not flat:
        return [list(probed) for probed in probes]
    rates = np.array([probe.moved / abs(probe.step) for probe in flat])
    mirrored = symmetry.mirrored(rates)
    rows, images = rates.reshape(len(flat), -1), mirrored.reshape(len(flat), -1)
    sizes = np.maximum(np.linalg.norm(rows, axis=1), 1e-30)
    alike = rows @ images.T / np.outer(sizes, sizes)
    nearest = alike.argmax(axis=1)
    mutual = (nearest[nearest] == np.arange(len(flat))) & (alike.max(axis=1) > _ALIKE)
    even = list(flat)
    for number in np.flatnonzero(mutual).tolist():
        own, other = flat[number], int(nearest[number])
        step = 0.5 * (abs(own.step) + abs(flat[other].step))
        rate = 0.5 * (rates[number] + mirrored[other])
        even[number] = Probe(float(np.copysign(step, own.step)), rate * step)
    left = iter(even)
    return [[next(left) for _ in probed] for probed in probes]

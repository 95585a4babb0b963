"""A mesh with a face becomes a head that can be driven: landmarks, regions and the hinge of the jaw."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import HeadError
from ..heads.proposal import propose_regions
from ..heads.rig import HeadRig, jaw_pivot_of
from ..numeric.arrays import FloatArray, IntArray, as_points
from .bind import bind_landmarks


def bind_head(vertices: FloatArray, faces: IntArray, marks: Mapping[int, int] | None = None) -> HeadRig:
    """Make a head of any mesh with a face.

    Parameters
    ----------
    vertices, faces, marks : (V, 3) array, (F, K) array, mapping of int to int
        As for `bind_landmarks`.

    Returns
    -------
    HeadRig
        The head, turned upright and towards the viewer: head frame, unit of `vertices`. All of the mesh counts as skin.

    Raises
    ------
    HeadError
        As `bind_landmarks`.

    Examples
    --------
    >>> from facemime import bind_head, built_in_head
    >>> mesh = built_in_head()
    >>> head = bind_head(mesh.vertices, mesh.faces)
    >>> head.landmarks.shape, head.region_weights.shape
    ((66,), (3, 1781))
    """
    places = as_points(vertices, "vertices", error=HeadError)
    polygons = np.asarray(faces)
    binding = bind_landmarks(places, polygons, marks)
    upright = places @ binding.rotation.T
    landmarks = binding.landmarks
    return HeadRig(
        upright,
        landmarks,
        propose_regions(upright, polygons, landmarks),
        jaw_pivot_of(upright[landmarks]),
        faces=polygons,
    )

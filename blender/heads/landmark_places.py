"""Positions of a head's landmarks in a viewport."""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.numeric import linalg
from ..meshes import mesh_of, read_landmarks

NEAR = 24.0
"""Maximum distance of a click from a landmark, pixels at a resolution scale of 1."""


class Places(NamedTuple):
    """Positions of points in a viewport.

    Attributes
    ----------
    pixels : (N, 2) float
        Pixels from the lower left corner of the region.
    facing : (N,) bool
        Whether the skin there is in front of the viewer and faces it.
    """

    pixels: NDArray[np.float64]
    facing: NDArray[np.bool_]


def landmark_places(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, view: NDArray[np.float64], size: tuple[int, int]
) -> Places:
    """Project the landmarks of a head, as it is displayed with its modifiers and transform.

    Parameters
    ----------
    view : (4, 4) array
        World to clip space: `perspective_matrix` of the region.
    size : tuple of int
        Width and height of the region, pixels.

    Raises
    ------
    HeadError
        If the head has no landmarks, or a modifier removes vertices.
    """
    landmarks = read_landmarks(obj)
    evaluated = obj.evaluated_get(depsgraph)
    vertices = mesh_of(evaluated).vertices
    if len(vertices) < len(mesh_of(obj).vertices):
        raise HeadError("A modifier of {name} removes vertices. Disable it to show the landmarks.", name=obj.name)
    seen = [vertices[i] for i in landmarks.tolist()]
    world = np.array(evaluated.matrix_world)
    places = np.array([vertex.co for vertex in seen]) @ world[:3, :3].T + world[:3, 3]
    normals = np.array([vertex.normal for vertex in seen]) @ np.asarray(linalg.inv(world[:3, :3]))
    return project(places, normals, view, size)


def project(
    places: NDArray[np.float64], normals: NDArray[np.float64], view: NDArray[np.float64], size: tuple[int, int]
) -> Places:
    """Project points into a viewport.

    Parameters
    ----------
    places, normals : (N, 3) array
        Positions and normals in world space.
    view, size
        As for `landmark_places`.
    """
    clip = np.hstack([places, np.ones((len(places), 1))]) @ view.T
    before = clip[:, 3] > 1e-9
    flat = clip[:, :2] / np.where(before, clip[:, 3], 1.0)[:, None]
    ahead = np.hstack([places + 1e-3 * normals, np.ones((len(places), 1))]) @ view.T
    nearer = ahead[:, 2] * clip[:, 3] < clip[:, 2] * ahead[:, 3]
    return Places((flat + 1.0) / 2.0 * np.array(size), before & nearer)


def nearest_landmark(places: Places, pixel: tuple[float, float], reach: float = NEAR) -> int:
    """Return the landmark nearest to a pixel among those that face the viewer.

    Parameters
    ----------
    pixel : (float, float)
        From the lower left corner of the region.
    reach : float
        Maximum distance, pixels.

    Returns
    -------
    int
        Index of the landmark; -1 if none is within `reach`.
    """
    away = np.linalg.norm(places.pixels - np.array(pixel), axis=1)
    away[~places.facing] = np.inf
    nearest = int(away.argmin())
    return nearest if away[nearest] <= reach else -1

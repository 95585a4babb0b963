"""The built-in head as an unlabelled mesh, another of the same topology, and a performer of other proportions."""

import numpy as np

from facemime.core.face.landmarks import OUTER_EYE_CORNERS, from_ibug
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import HeadRig

HEAD = load_head()
VERTICES = HEAD.vertices.astype(float)
POINTS = VERTICES[HEAD.landmarks]
UNIT = float(np.linalg.norm(np.subtract(*POINTS[OUTER_EYE_CORNERS])))


def performer(rig: HeadRig) -> np.ndarray:
    """A narrower and longer face than the head's, in outer-eye distances."""
    points = rig.vertices[rig.landmarks].astype(float)
    unit = np.linalg.norm(points[from_ibug([36])] - points[from_ibug([45])])
    return points / unit * (1.0, 1.15, 1.0)


def stylised() -> np.ndarray:
    """The head with a wide skull, a long chin and large eyes."""
    places = VERTICES.copy()
    places[:, 0] *= 1.25
    below = np.maximum(places[:, 1] - POINTS[from_ibug([33])[0], 1], 0.0)
    places[:, 1] += 0.4 * below
    for corner in ((36, 39), (42, 45)):
        centre = POINTS[from_ibug(corner)].mean(axis=0) * [1.25, 1, 1]
        reach = np.exp(-np.square(np.linalg.norm(places - centre, axis=1) / (0.25 * UNIT)))
        places[:, :2] += 0.3 * reach[:, None] * (places - centre)[:, :2]
    return places

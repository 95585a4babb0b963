"""Reported places of landmarks, relative to the hand labels that the experts learn from.

Brows and lips are marked in two ways. The hand labels end the row along a brow's upper rim at the *lower* corner of its
inner end, and space the points of the lower lip evenly. The iBUG figure ends the row at the *upper* corner, and places
the points of the lower lip below those of the upper lip. The reported places are a quarter of the way from the labels
to the figure, which is about as far as the median error on held-out hand labels allows without increasing.
"""

from __future__ import annotations

import numpy as np

from facemime.core.face.landmarks import MIRROR, N_LANDMARKS, from_ibug

SHARE = 0.25
_BROW_END = from_ibug((21,))
_LIPS = tuple(from_ibug(numbers) for numbers in ((58, 50, 57), (59, 49, 58), (61, 50, 62), (67, 50, 66)))
"""Landmarks on the viewer's left: a landmark, the one of the upper lip above it in the figure, and the next one towards
the middle, along the line to which it is moved."""


def definition_offset(mean: np.ndarray, ict_to_labels: np.ndarray) -> np.ndarray:
    """Return the offsets (66, 3) from the labels to the reported landmarks: head frame, outer-eye distances.

    `mean` (66, 3) is that of the labelled faces. `ict_to_labels` (66, 3) leads from the landmarks of ICT-FaceKit, which
    are the figure's on its mesh, to the labels. It is used for the end of the brow; on the lips, the mesh has a spacing
    of its own.
    """
    out = np.zeros((N_LANDMARKS, 3))
    out[_BROW_END] = -ict_to_labels[_BROW_END]
    for landmark, above, inward in _LIPS:
        way = mean[inward] - mean[landmark]
        out[landmark] = (mean[above, 0] - mean[landmark, 0]) / way[0] * way
    out += np.where(out == 0.0, out[MIRROR] * (-1.0, 1.0, 1.0), 0.0)
    return SHARE * out

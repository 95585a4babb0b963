"""Where a landmark is reported, against where the hand labels that the experts learn from have it.

Brows and the lower lip are marked in two ways. The hand labels end the row along a brow's upper rim at the *lower*
corner of its inner end, and space the lower lip's five points evenly. The iBUG figure ends the row at the *upper*
corner, and draws the middle three of the lip together under the dip of the upper one. Reported is a quarter of the way
from the labels to the figure: about as far as the median error on held-out hand labels stays what it is without.
"""

from __future__ import annotations

import numpy as np

from facemime.core.landmarks import MIRROR, N_LANDMARKS

SHARE = 0.25
TO_IBUG = {
    17: (-0.8, -2.2),
    18: (-0.4, 0.0),
    19: (-2.0, 0.0),
    20: (-2.8, -1.8),
    21: (1.7, -6.5),
    58: (3.3, 0.5),
    59: (2.5, 1.3),
    60: (1.3, 0.7),
    65: (1.5, 1.0),
}
"""For landmarks on the viewer's left, to the middle of the face and down, in percent of the outer-eye distance: the
way from the hand labels to the iBUG figure. It is the mean distance, over the training people's photos, between the
labels and the points of a tracker that was taught by the figure (dlib's), rounded, and looked at on enlargements."""


def definition_offset() -> np.ndarray:
    """(66, 3) from the labels to the reported landmarks, head frame, outer-eye distances."""
    out = np.zeros((N_LANDMARKS, 3))
    for landmark, (inward, down) in TO_IBUG.items():
        out[landmark] = np.array([inward, down, 0.0]) * SHARE / 100.0
        out[MIRROR[landmark]] = out[landmark] * (-1.0, 1.0, 1.0)
    return out

"""Anatomy of the base mesh hm08: the landmark vertices, and the rings of lids and lips, by vertex number.

They were chosen by eye on front and side views with numbered vertices, on the performer's left half (x > 0); the right
half follows by mirror symmetry. iBUG numbers name the landmarks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facemime.core.base.landmarks import MIRROR, N_LANDMARKS, from_ibug

LEFT_LANDMARKS: dict[int, int] = {
    **{8: 5225, 9: 11831, 10: 7618, 11: 7594, 12: 7596, 13: 11850, 14: 7574, 15: 7573, 16: 7575},
    **{22: 6983, 23: 6980, 24: 6979, 25: 6981, 26: 6987},
    **{27: 132, 28: 131, 29: 164, 30: 294, 33: 317, 34: 7054, 35: 7057},
    **{42: 6850, 43: 6838, 44: 6784, 45: 6805, 46: 13372, 47: 13368},
    **{51: 455, 52: 7210, 53: 11956, 54: 7189, 55: 7235, 56: 7241, 57: 492},
    **{62: 474, 63: 7226, 65: 7236, 66: 493},
}
"""iBUG number to vertex of hm08, for the midline and the performer's left."""

UPPER_LID_EDGE = (6850, 6847, 6886, 6844, 6841, 6838, 6784, 6790, 6793, 6796, 6799, 6802, 6805)
"""Front edge of the left upper lid, inner to outer corner; the lashes grow here."""

LOWER_LID_EDGE = (6850, 6853, 6856, 6837, 11695, 6834, 6831, 6828, 6825, 6820, 6817, 6814, 6811, 6808, 6805)
"""Front edge of the left lower lid, inner to outer corner."""

UPPER_LIP_BORDER = (455, 7214, 7210, 7215, 7169, 11956, 7170, 7171, 7168, 7167, 10404, 7185, 7189)
"""Upper vermilion border, midline to the left corner."""

LOWER_LIP_BORDER = (492, 7241, 7235, 7130, 7165, 7164, 10371, 7186, 7189)
"""Lower vermilion border, midline to the left corner."""

UPPER_LIP_LINE = (474, 7229, 7228, 7227, 7226, 11964, 7225, 7179, 7178, 7189)
"""Where the upper lip meets the lower, midline to the left corner."""

LOWER_LIP_LINE = (493, 7242, 7236, 7230, 7197, 7189)
"""Where the lower lip meets the upper, midline to the left corner."""

UPPER_LIP_INSIDE = (520, 7267, 7268, 7261, 7262, 11962, 7263, 7181, 7180)
LOWER_LIP_INSIDE = (523, 7264, 7265, 7266, 7206)
"""The next rows behind the lip lines, which round the lips off where the mouth opens."""

MOUTH_CORNER = 7189


def landmark_vertices(mirror: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices of hm08 for all landmarks, (66,); those of the right half by `mirror`, (N,) the opposite vertex."""
    vertices = np.full(N_LANDMARKS, -1)
    for ibug, vertex in LEFT_LANDMARKS.items():
        position = from_ibug([ibug])[0]
        vertices[position] = vertex
        vertices[MIRROR[position]] = mirror[vertex]
    return vertices

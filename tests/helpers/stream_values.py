"""Values for tests of streams."""

import numpy as np
from hypothesis import strategies as st

from facemime.core.face.names import COEFFICIENT_INDEX, N_COEFFICIENTS

SHARES = st.lists(st.floats(0.0, 1.0, width=32), min_size=N_COEFFICIENTS, max_size=N_COEFFICIENTS)
ANGLES = st.tuples(*[st.floats(-1.2, 1.2)] * 3)


def value_of(face, name):
    return face.coefficients[COEFFICIENT_INDEX[name]]


def distinct() -> np.ndarray:
    """Coefficients that all differ, so that none can be mistaken for another."""
    return np.arange(1, N_COEFFICIENTS + 1) / 100.0

"""The head that the tests of driving move."""

from __future__ import annotations

import pytest

from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import HeadRig


@pytest.fixture(scope="session")
def rig() -> HeadRig:
    """The built-in head."""
    head = load_head()
    return HeadRig(head.vertices, head.landmarks, head.regions, head.jaw_pivot)

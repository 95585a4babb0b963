"""What several tests of core and of the command share."""

from pathlib import Path

import pytest

from facemime.core.takes.file import save_take
from takes import performance


@pytest.fixture
def take(tmp_path) -> Path:
    """A take of 60 frames."""
    save_take(performance(), tmp_path / "take.facetake")
    return tmp_path / "take.facetake"

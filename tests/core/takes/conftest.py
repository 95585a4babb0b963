"""Fixtures: a take's file."""

import pytest

from facemime.core.takes.file import save_take
from tests.helpers.takes import performance


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> bytes:
    """The file of a take of 60 frames at 25 per second, one of them lost: three chunks of frames."""
    path = tmp_path_factory.mktemp("take") / "take.facetake"
    save_take(performance(), path)
    return path.read_bytes()

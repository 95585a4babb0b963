"""Fixtures shared by tests of core and of the command line."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.core.takes.file import save_take
from facemime.core.tracking.tracker import FaceTracker
from tests.helpers.links import free_port
from tests.helpers.takes import performance


@pytest.fixture
def take(tmp_path) -> Path:
    """A take of 60 frames."""
    save_take(performance(), tmp_path / "take.facetake")
    return tmp_path / "take.facetake"


@pytest.fixture(scope="module")
def tracker() -> FaceTracker:
    """A tracker with the shipped model, which the tests of a module share."""
    return FaceTracker.load()


@pytest.fixture
def opened() -> Iterator[Callable[..., StreamSource]]:
    """Make a source on a free port that skips no frame on a busy machine; all are closed at the end."""
    sources: list[StreamSource] = []

    def make(protocol: str = "own", **settings) -> StreamSource:
        settings = {"port": free_port()} | settings
        sources.append(StreamSource(StreamSettings(protocol, **settings), every=True))
        sources[-1].read(0.0)
        return sources[-1]

    yield make
    for source in sources:
        source.close()

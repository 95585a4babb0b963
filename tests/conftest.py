"""Fixtures and options shared by all tests."""

from __future__ import annotations

import argparse
import ctypes
import re
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from facemime.core.takes.face_space import FaceSpace
from tests.helpers.owners import UNDER_WINE

# A shell ignores Ctrl-C for background processes, and so would the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_DENORMALS = 0x03000000
"""_MCW_DN of Microsoft's C library."""
_PLACE = re.compile(r"\b(4\.2|4\.5|5\.0|5\.2|trixie|sid|windows-\w+)\b")
"""Versions of Blender, platforms whose Blender has a window, and what runs in one process on Windows."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--share", type=_share, metavar="K/N", help="run only a share of the thorough tests, the K-th of N"
    )


def _share(text: str) -> tuple[int, int]:
    if not re.fullmatch(r"\d+/[1-9]\d*", text):
        raise argparse.ArgumentTypeError(f"{text} is not a share such as 3/12")
    chosen, of = text.split("/")
    return int(chosen), int(of)


def pytest_configure(config: pytest.Config) -> None:
    """Let no property test fail on a busy machine; environments with only Blender have no hypothesis."""
    if config.pluginmanager.hasplugin("hypothesispytest"):
        from hypothesis import settings

        settings.register_profile("untimed", deadline=None)
        settings.load_profile("untimed")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the thorough tests of other shares; tests that start the same Blender are in the same share."""
    if not (share := config.getoption("--share")):
        return
    chosen, of = share

    def group(item: pytest.Item) -> tuple[str, ...]:
        return item.path.as_posix(), *_PLACE.findall(item.name.partition("[")[2])

    groups = sorted({group(item) for item in items if item.get_closest_marker("thorough")})
    kept = set(groups[chosen % of :: of])
    left = [item for item in items if item.get_closest_marker("thorough") and group(item) not in kept]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if item not in set(left)]


def pytest_runtest_teardown() -> None:
    """Let numbers below the normal range be numbers again, as wine does not after an exception of OpenCV's networks."""
    if UNDER_WINE:
        ctypes.CDLL("ucrtbase")._controlfp_s(ctypes.byref(ctypes.c_uint()), 0, _DENORMALS)


@pytest.fixture(scope="session", autouse=True)
def _each_performance_explained_once() -> Iterator[None]:
    """Keep the slowest part of a calibration, as many tests calibrate the same performance."""
    explain, known = FaceSpace.explain, {}

    def explained(space: FaceSpace, shapes: np.ndarray, weights: np.ndarray) -> np.ndarray:
        key = space.units.tobytes(), shapes.tobytes(), weights.tobytes()
        if key not in known:
            known[key] = explain(space, shapes, weights)
        return known[key].copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FaceSpace, "explain", explained)
        yield

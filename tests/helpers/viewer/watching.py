"""A viewer whose heads a test drives frame by frame, and what its page shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import monotonic, perf_counter

import numpy as np
from playwright.sync_api import Page

from facemime.core.drive.driver import HeadDriver, HeadFrame
from facemime.core.face.names import COEFFICIENT_INDEX, N_ACTIONS, N_COEFFICIENTS
from facemime.core.heads.appearance import Appearance, Material, Patch, built_in_appearance
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.puppet.outputs import KeyDriver
from facemime.core.takes.measured import coefficient_face
from facemime.core.tracking.result import TrackResult
from facemime.core.viewer.server import ViewerServer
from facemime.core.viewer.viewer_settings import ViewerSettings
from tests.helpers.clocks import PATIENCE

NEUTRAL = coefficient_face().neutral
_LOADED = "!!globalThis.viewer && viewer.room && !viewer.loading && viewer.loaded === viewer.stream.scene"


def built_in() -> tuple[HeadDriver, Appearance]:
    return HeadDriver(built_in_head(lashes=True), NEUTRAL), built_in_appearance()


def plain(rig: HeadRig, name: str = "Head") -> Appearance:
    """A head of one colour."""
    return Appearance(name, (Patch(Material(), rig.all_faces),))


def face(seed: int | None = None, **values: float) -> TrackResult:
    """A face with the given coefficients; with a seed, random ones that also turn the head and act all actions."""
    rng = np.random.default_rng(seed)
    amounts = np.zeros(N_COEFFICIENTS) if seed is None else rng.uniform(0.0, 0.8, N_COEFFICIENTS)
    for name, value in values.items():
        amounts[COEFFICIENT_INDEX[name]] = value
    angles = np.zeros(3) if seed is None else rng.uniform(-0.5, 0.5, 3)
    actions = np.zeros(N_ACTIONS) if seed is None else rng.uniform(0.0, 1.0, N_ACTIONS)
    return replace(coefficient_face().result(amounts, angles), actions=actions)


class Watched:
    """A server with heads.

    Parameters
    ----------
    *heads : (HeadDriver or KeyDriver, Appearance)
        The built-in head by default.
    **settings
        Of the server.
    """

    def __init__(self, *heads: tuple[HeadDriver | KeyDriver, Appearance], **settings) -> None:
        heads = heads or (built_in(),)
        self.drivers = [driver for driver, _ in heads]
        self.server = ViewerServer(ViewerSettings(**{"port": 0} | settings), [looks for _, looks in heads])

    @property
    def address(self) -> str:
        return self.server.address

    def show(self, result: TrackResult) -> Sequence[HeadFrame]:
        """Show a face on all heads, and return their frames."""
        frames = [driver.frame(result) for driver in self.drivers]
        self.server.show(perf_counter(), self.drivers, frames)
        return frames

    def close(self) -> None:
        self.server.close()


def until(page: Page, expression: str) -> None:
    """Wait until something is true on a page, whose policy forbids the browser driver to wait there itself."""
    end = monotonic() + PATIENCE
    while not page.evaluate(expression):
        assert monotonic() < end, f"{expression} is not true: {page.inner_text('body')}"
        page.wait_for_timeout(20)


def loaded(page: Page) -> Page:
    """Wait until a page has loaded its heads."""
    until(page, _LOADED)
    return page


def shown_on(page: Page, number: int) -> None:
    """Wait until a page has drawn the frame of that number."""
    until(page, f"viewer.shown === {number}")


def vertices_of(page: Page, head: int = 0) -> np.ndarray:
    """Read a head's vertices back from the graphics card, (N, 3), head frame."""
    values = page.evaluate(f"Array.from(viewer.avatars[{head}].read(viewer.renderer))")
    return np.array(values).reshape(-1, 3)

"""Fixtures: Debian's Chromium without a screen, and a server that is driven frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.helpers.programs import program
from tests.helpers.viewer.watching import Watched

ROOT = Path(__file__).resolve().parents[2]
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
"""Draws without a graphics card; the sandbox needs another user than root."""


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Return a browser; skip with a reason if there is none."""
    path = program("chromium")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=SOFTWARE)
        yield started
        started.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[[str], Page]]:
    """Open pages; a script's error on any of them fails the test."""
    errors: list[str] = []
    context = browser.new_context(viewport={"width": 160, "height": 160}, locale="en-GB")

    def opened(address: str) -> Page:
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        return page

    yield opened
    context.close()
    assert errors == []


@pytest.fixture
def watched() -> Iterator[Callable[..., Watched]]:
    """Serve heads that the test drives; all servers are closed at the end."""
    served: list[Watched] = []

    def serve(*arguments, **settings) -> Watched:
        served.append(Watched(*arguments, **settings))
        return served[-1]

    yield serve
    for one in served:
        one.close()

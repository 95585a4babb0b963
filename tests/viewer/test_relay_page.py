"""The page from a static web server, moved through a relay, in a real browser."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from facemime.core.drive.driver import HeadDriver
from facemime.core.viewer.relay import RelaySender
from tests.helpers.clocks import wait_for
from tests.helpers.relays import new_site, relaying
from tests.helpers.viewer.watching import built_in, face, loaded, until, vertices_of


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Keep the output of the tests free of requests."""


@contextmanager
def published(folder: Path) -> Iterator[str]:
    """Publish a folder with Python's web server; yields its address."""
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.thorough
def test_a_static_page_shows_what_the_relay_passes_on_and_returns_after_a_restart(tmp_path, open_page):
    site, (driver, looks) = new_site(tmp_path), built_in()
    with closing(RelaySender(site, [looks])) as sender, published(site.public) as address:
        with relaying(site):
            page = open_page(f"{address}/{site.page.name}/")
            assert _distance(page, sender, driver, 1) < 1e-3
            assert page.inner_text("#message") == ""
        until(page, "!viewer.stream.connected")
        with relaying(site):
            assert _distance(page, sender, driver, 2) < 1e-3


def _distance(page: Page, sender: RelaySender, driver: HeadDriver, seed: int) -> float:
    """Largest distance on the page from a frame that is sent, in outer-eye distances."""
    frame = driver.frame(face(seed))
    ready = "!!globalThis.viewer && viewer.room && viewer.stream.scene && viewer.loaded === viewer.stream.scene"

    def send() -> None:
        sender.show(0.0, [driver], [frame])
        page.wait_for_timeout(50)

    wait_for(lambda: page.evaluate(ready), send)
    loaded(page)
    before = page.evaluate("viewer.shown")
    wait_for(lambda: page.evaluate(f"viewer.shown > {before}"), send)
    away = np.linalg.norm(vertices_of(page)[: len(frame.vertices)] - frame.vertices, axis=1)
    return float(away.max() / driver.rig.eye_distance)

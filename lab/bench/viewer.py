"""The viewer in a real browser: updates, bytes, and distance of its vertices from the deformer's."""

from __future__ import annotations

import base64
import shutil
import threading
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.appearance import Appearance, Material, Patch, built_in_appearance
from facemime.core.heads.rig import HeadRig, built_in_head
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.viewer.server import ViewerServer
from facemime.core.viewer.viewer_settings import ViewerSettings
from lab.bench.deform_speed import finer

_RATE = 60.0
_COMPARED = 40
_SIZE = {"width": 640, "height": 480}
_SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_READ = """() => {
    const bytes = new Uint8Array(viewer.avatars[0].read(viewer.renderer).buffer);
    let text = "";
    for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
    return btoa(text);
}"""
_LOADED = "performance.getEntriesByType('resource').reduce((sum, { transferSize }) => sum + transferSize, 0)"
"""Bytes that the page has loaded, as they came over the network."""
_READY = "!!globalThis.viewer && viewer.room && !viewer.loading && viewer.loaded === viewer.stream.scene"


@dataclass(frozen=True)
class Viewed:
    """Measurements of a head in a browser.

    Attributes
    ----------
    vertices : int
        Number of vertices of the head.
    updates_per_s, moved_per_s : float
        Updates that reached the page, and those that it computed, on a processor in place of a graphics card.
    bytes_per_s, loaded_bytes : float
        Bytes of the stream per second, and of the page and the head, which are loaded once.
    worst_vertex : float
        Largest distance of a vertex from the deformer's, in outer-eye distances.
    latency_ms : float
        Median time from passing on a frame to the moved vertices on the page.
    """

    vertices: int
    updates_per_s: float
    moved_per_s: float
    bytes_per_s: float
    loaded_bytes: int
    worst_vertex: float
    latency_ms: float


def view(take: Take, seconds: float) -> list[Viewed]:
    """Show a take on the built-in head, and on one of more than 100,000 vertices; [] without a browser."""
    program = shutil.which("chromium")
    if program is None:
        print("Chromium was not found. Run make programs.")
        return []
    from playwright.sync_api import sync_playwright

    rig = built_in_head()
    dense = finer(finer(finer(rig)))
    heads = (
        (built_in_head(lashes=True), built_in_appearance()),
        (dense, Appearance("Dense", (Patch(Material(), dense.faces),))),
    )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(_SOFTWARE))
        found = [_viewed(browser, take, head, looks, seconds) for head, looks in heads]
        browser.close()
    return found


def _viewed(browser, take: Take, rig: HeadRig, looks: Appearance, seconds: float) -> Viewed:
    driver = HeadDriver(rig, calibrate(take))
    with ViewerServer(ViewerSettings(port=0), [looks]) as server:
        page = browser.new_page(viewport=_SIZE)
        page.goto(server.address)
        server.show(perf_counter(), [driver], [driver.frame(take.result(0))])
        while not page.evaluate(_READY):
            page.wait_for_timeout(50)
        worst = max(_difference(page, server, driver, take, number) for number in _compared(take))
        rates, latency = _streamed(page, server, driver, take, seconds)
        loaded = page.evaluate(_LOADED)
        page.close()
    return Viewed(len(rig.vertices), *rates, loaded, worst / rig.eye_distance, latency)


def _compared(take: Take) -> NDArray[np.int64]:
    return np.linspace(0, len(take) - 1, _COMPARED).astype(int)


def _difference(page, server: ViewerServer, driver: HeadDriver, take: Take, number: int) -> float:
    """Largest distance of a vertex on the page from the driver's, for a frame of a take."""
    frame = driver.frame(take.result(int(number)))
    server.show(perf_counter(), [driver], [frame])
    while page.evaluate("viewer.shown") != server.sent:
        page.wait_for_timeout(5)
    shown = np.frombuffer(base64.b64decode(page.evaluate(_READ)), "<f4").reshape(-1, 3)
    return float(np.linalg.norm(shown[: len(frame.vertices)] - frame.vertices, axis=1).max())


def _streamed(
    page, server: ViewerServer, driver: HeadDriver, take: Take, seconds: float
) -> tuple[tuple[float, float, float], float]:
    """Updates, computed updates and bytes per second of a stream at 60 frames per second, and the median latency."""
    over = threading.Event()
    frames = [driver.frame(take.result(number)) for number in range(0, len(take), max(1, len(take) // 64))]

    def feed() -> None:
        began, number = perf_counter(), 0
        while not over.wait(max(0.0, began + number / _RATE - perf_counter())):
            server.show(perf_counter(), [driver], [frames[number % len(frames)]])
            number += 1

    thread = threading.Thread(target=feed)
    thread.start()
    counted = "[viewer.stream.received, viewer.updates, viewer.stream.bytes, performance.now() / 1000, viewer.latency]"
    page.wait_for_timeout(1500)
    before = np.array(page.evaluate(counted), dtype=float)
    latencies = []
    while (after := np.array(page.evaluate(counted), dtype=float))[3] - before[3] < seconds:
        latencies.append(after[4])
        page.wait_for_timeout(100)
    over.set()
    thread.join()
    change = after - before
    return tuple((change[:3] / change[3]).tolist()), float(np.nanmedian(latencies))

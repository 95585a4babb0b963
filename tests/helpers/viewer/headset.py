"""An emulated headset, in a real room that was captured with one, for pages that show augmented reality."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from tests.helpers.viewer.watching import loaded, until

_EMULATOR = Path(__file__).resolve().parents[3] / "build" / "viewer" / "node_modules"
_SCRIPTS = ("iwer/build/iwer.min.js", "@iwer/sem/build/iwer-sem.min.js")
ROOM = "meeting_room"
"""A table 0.73 m high, 2 m in front of the place where the headset was when it captured the room."""
_HELPERS = Path(__file__).with_suffix(".js")


def with_headset(
    browser: Browser, position: Sequence[float], look_at: Sequence[float], room: str = ROOM
) -> BrowserContext:
    """Open a browser whose pages find a headset in a room, as `headset`; skip the test where none can be emulated."""
    if not all((_EMULATOR / script).exists() for script in _SCRIPTS):
        pytest.skip("the emulated headset is missing: make viewer")
    context = browser.new_context(viewport={"width": 640, "height": 480}, locale="en-GB")
    for script in (*(_EMULATOR / script for script in _SCRIPTS), _HELPERS):
        context.add_init_script(path=script)
    captured = (_EMULATOR / "@iwer" / "sem" / "captures" / f"{room}.json").read_text(encoding="utf-8")
    context.add_init_script(
        "globalThis.headset = new IWER.XRDevice(IWER.metaQuest3, { ipd: 0 });"
        "headset.installRuntime({ forceInstall: true }); headset.installSEM(IWER_SEM.SyntheticEnvironmentModule);"
        f"headset.sem.loadEnvironment({json.dumps(json.loads(captured))});"
        "globalThis.asked = []; const ask = navigator.xr.requestSession.bind(navigator.xr);"
        "navigator.xr.requestSession = (...given) => (asked.push(given), ask(...given));"
        f"pose(headset, {list(position)}, {list(look_at)});"
    )
    return context


def entered(context: BrowserContext, address: str) -> Page:
    """Open the viewer's page and press its button for augmented reality."""
    page = context.new_page()
    page.goto(address)
    loaded(page)
    until(page, "!document.getElementById('immersive').hidden")
    page.evaluate("document.getElementById('immersive').click()")
    until(page, "viewer.renderer.xr.isPresenting && viewer.immersion._sources.size > 2")
    return page

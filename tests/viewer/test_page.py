"""The page in a real browser: it draws the heads, moves them as Blender does, and reconnects by itself."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import UPPER_LIDS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import KeyMap, KeyRow
from facemime.core.heads.rig import FaceParts, Part, built_in_head
from facemime.core.puppet.outputs import KeyDriver, LiveKeys
from tests.helpers.parted_heads import with_gums, with_parts
from tests.helpers.viewer.watching import NEUTRAL, built_in, face, loaded, plain, shown_on, until, vertices_of

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-3
"""Of the outer-eye distance."""
EXACT_TOLERANCE = 2e-3
"""The same where the paper's interpolation is exact: its weights are larger and cancel, and are sent with 11 bits."""


def with_lashes():
    """The built-in head with parts, and lashes that ride on its upper lids."""
    rig = with_parts()
    roots = rig.vertices[rig.landmarks[list(UPPER_LIDS)]]
    lashes = np.concatenate([roots, roots + (0.004, 0.0, -0.01), roots + (0.0, -0.002, -0.01)]).astype(np.float32)
    first, count = len(rig.all_vertices), len(roots)
    faces = first + np.arange(count)[:, None] + count * np.arange(3)
    padded = np.pad(faces, ((0, 0), (0, rig.parts.faces.shape[1] - 3)), constant_values=-1)
    kinds = np.concatenate([rig.parts.kinds, np.full(3 * count, Part.ON_SKIN, dtype=np.int8)])
    others = np.concatenate([rig.parts.others, lashes])
    return replace(rig, parts=FaceParts(kinds, others, np.concatenate([rig.parts.faces, padded])))


def with_keys():
    """The built-in head, driven by its face units as shape keys."""
    head, rig = load_head(), built_in_head()
    names = head.unit_names
    table = KeyMap("ARKit", tuple(KeyRow(name, name) for name in names))
    keys = LiveKeys(table, dict(zip(names, head.units, strict=True)), dict.fromkeys(names, (0.0, 1.0)))
    return KeyDriver(HeadDriver(rig, NEUTRAL), NEUTRAL, keys), plain(rig)


def of_the_paper():
    """The built-in head as in the paper: in the plane, and without contact of the eyes."""
    rig = built_in_head()
    paper = DriveSettings(mode="planar", kernel="gaussian", borders="sharp", exact=True, contact=False)
    return HeadDriver(rig, NEUTRAL, paper), plain(rig)


def picture(page) -> np.ndarray:
    """The canvas alone, (160, 160, 3), BGR."""
    page.evaluate("for (const text of document.querySelectorAll('p, footer')) text.style.display = 'none'")
    return cv2.imdecode(np.frombuffer(page.locator("canvas").screenshot(), np.uint8), 1).astype(int)


def test_the_page_draws_a_head_that_moves_with_the_stream(open_page, watched):
    shown = watched()
    shown.show(face())
    page = loaded(open_page(shown.address))
    shown_on(page, 1)
    rest = picture(page)
    middle, corner = rest[60:90, 60:100].mean(axis=(0, 1)), rest[:10, :10].mean(axis=(0, 1))
    assert middle[2] > middle[0] + 20, "skin is redder than blue"
    assert np.abs(corner - (43, 38, 35)).max() < 4, "the background is behind it"
    shown.show(face(jawOpen=0.9, eyeBlinkLeft=1.0))
    shown_on(page, 2)
    changed = np.abs(picture(page) - rest).max(axis=2) > 25
    assert 0.005 < changed.mean() < 0.2
    assert changed[:40].mean() < 0.01, "the forehead stays"


@pytest.mark.thorough
def test_vertices_on_the_graphics_card_are_those_of_the_driver(open_page, watched):
    lashes = with_lashes()
    shown = watched(built_in(), (HeadDriver(lashes, NEUTRAL), plain(lashes)), with_keys(), of_the_paper())
    shown.show(face())
    page = loaded(open_page(shown.address))
    unit, head = built_in_head().eye_distance, load_head()
    rest = shown.drivers[1].rest
    for number, seed in enumerate((1, 2, 3), start=2):
        frames = shown.show(face(seed, eyeBlinkLeft=1.0, eyeBlinkRight=1.0, tongueOut=1.0))
        shown_on(page, number)
        for place, frame in enumerate(frames):
            off = vertices_of(page, place)[: len(frame.vertices)] - frame.vertices
            allowed = EXACT_TOLERANCE if place == len(frames) - 1 else TOLERANCE
            assert np.linalg.norm(off, axis=1).max() < allowed * unit
            assert np.linalg.norm(frame.vertices - rest[: len(frame.vertices)], axis=1).max() > 0.1 * unit
        attached = vertices_of(page)[len(frames[0].vertices) :]
        assert np.linalg.norm(attached - attached_to(head, frames[0]), axis=1).max() < TOLERANCE * unit


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["mouthRollLower", "mouthSmileLeft"])
def test_gums_on_the_graphics_card_stay_behind_a_lip_that_is_drawn_back(open_page, watched, name):
    rig = with_gums(0.03)
    shown = watched((HeadDriver(rig, NEUTRAL), plain(rig)))
    (frame,) = shown.show(face(**{name: 1.0}))
    page = loaded(open_page(shown.address))
    shown_on(page, 1)
    assert np.abs(vertices_of(page)[: len(frame.vertices)] - frame.vertices).max() < TOLERANCE * rig.eye_distance
    teeth = rig.kinds == Part.TEETH_LOWER
    turned = rig.jaw_pivot + (rig.all_vertices[teeth] - rig.jaw_pivot) @ frame.jaw.T
    assert (frame.vertices[teeth] - turned)[:, 2].max() > 0.005 * rig.eye_distance


def attached_to(head, frame) -> np.ndarray:
    """Where eyes, teeth, tongue and hair of the built-in head are."""
    turns = {"eye_right": frame.gaze[0], "eye_left": frame.gaze[1], "teeth_lower": frame.jaw, "tongue": frame.jaw}
    parts, row = [part for part in head.parts if part.name != "lashes"], head.unit_names.index("tongueOut")
    rests = [part.vertices + (frame.tongue * part.units[row] if part.name == "tongue" else 0.0) for part in parts]
    pairs = zip(parts, rests, strict=True)
    return np.concatenate([p.pivot + (rest - p.pivot) @ turns.get(p.name, np.eye(3)).T for p, rest in pairs])


@pytest.mark.thorough
def test_normals_point_out_of_the_head(open_page, watched):
    shown = watched()
    shown.show(face(2))
    page = loaded(open_page(shown.address))
    shown_on(page, 1)
    read = "a.normalTarget, 0, 0, a.normalTarget.width, a.normalTarget.height, v"
    values = page.evaluate(
        "(() => { const a = viewer.avatars[0], v = new Float32Array(4 * a.normalTarget.width * a.normalTarget.height);"
        f"viewer.renderer.readRenderTargetPixels({read}); return Array.from(v); }})()"
    )
    rig = built_in_head()
    normals = np.array(values).reshape(-1, 4)[: len(rig.vertices), :3]
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert normals[rig.landmarks][:, 2].mean() < -0.5, "the face looks along -z"


@pytest.mark.thorough
def test_the_page_reconnects_when_the_server_is_restarted(open_page, watched):
    shown = watched(token="a-token-that-is-kept")
    shown.show(face())
    page = loaded(open_page(shown.address))
    port = int(shown.address.split(":")[2].split("/")[0])
    shown.close()
    until(page, "!viewer.stream.connected && document.getElementById('message').textContent !== ''")
    again = watched(token="a-token-that-is-kept", port=port)
    again.show(face())
    until(page, "viewer.stream.connected")
    loaded(page)
    (frame,) = again.show(face(3))
    shown_on(page, 2)
    assert np.abs(vertices_of(page)[: len(frame.vertices)] - frame.vertices).max() < TOLERANCE
    assert page.inner_text("#message") == ""


@pytest.mark.thorough
def test_five_viewers_see_the_same(open_page, watched):
    shown = watched()
    shown.show(face())
    pages = [open_page(shown.address) for _ in range(5)]
    for page in pages:
        loaded(page)
    assert shown.server.viewers == 5
    shown.show(face(4))
    for page in pages:
        shown_on(page, 2)
    first, *others = (vertices_of(page) for page in pages)
    assert all(np.array_equal(first, other) for other in others)
    pages[0].close()
    until(pages[1], "viewer.stream.connected")


@pytest.mark.thorough
def test_several_heads_are_placed_around_a_table(open_page, watched):
    shown = watched(built_in(), built_in(), built_in())
    shown.show(face())
    page = loaded(open_page(shown.address))
    shown_on(page, 1)
    places = np.array(page.evaluate("viewer.avatars.map((a) => a.object.position.toArray())"))
    away = np.linalg.norm(places[:, [0, 2]], axis=1)
    assert np.ptp(away) < 1e-6 and np.allclose(places[:, 1], places[0, 1])
    assert np.linalg.norm(places[0] - places[1]) > 0.4
    facing = np.array(
        page.evaluate("viewer.avatars.map((a) => a.object.getWorldDirection(a.neck.position.clone()).toArray())")
    )
    assert (np.einsum("nc,nc->n", facing[:, [0, 2]], places[:, [0, 2]]) < -0.9 * away).all(), "they face the middle"


@pytest.mark.thorough
def test_a_head_that_changes_is_loaded_again(open_page, watched):
    shown = watched()
    shown.show(face())
    page = loaded(open_page(shown.address))
    rig = built_in_head()
    shown.drivers = [HeadDriver(replace(rig, vertices=1.5 * rig.vertices), NEUTRAL)]
    (frame,) = shown.show(face(6))
    until(page, "viewer.stream.scene?.scene === 2")
    loaded(page)
    shown.show(face(6))
    shown_on(page, 3)
    assert np.abs(vertices_of(page)[: len(frame.vertices)] - frame.vertices).max() < TOLERANCE


@pytest.mark.thorough
def test_the_page_reports_its_speed(open_page, watched):
    shown = watched()
    shown.show(face())
    page = loaded(open_page(shown.address))
    until(page, "viewer.stream.since(0) !== null")
    shown.show(face(1))
    until(page, "/\\d+ fps +\\d+ ms/.test(document.getElementById('numbers').textContent)")


@pytest.mark.thorough
def test_the_keyboard_orbits_zooms_and_resets_the_view(open_page, watched):
    shown = watched()
    shown.show(face())
    page = loaded(open_page(shown.address))
    assert page.get_attribute("canvas", "aria-label").startswith("3D view. Arrow keys orbit")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "picture"
    way = "viewer.camera.position.clone().sub(viewer.controls.target)"

    def camera() -> np.ndarray:
        return np.array(page.evaluate(f"{way}.toArray()"))

    start = camera()
    for key, sign, axis in (("ArrowRight", 1, 0), ("ArrowLeft", -1, 0), ("ArrowUp", 1, 1), ("ArrowDown", -1, 1)):
        before = camera()
        page.keyboard.press(key)
        until(page, f"{way}.distanceTo({{x: {before[0]}, y: {before[1]}, z: {before[2]}}}) > 0.01")
        moved = camera()
        assert sign * (moved - before)[axis] > 0.01, key
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(start))
    page.keyboard.press("+")
    until(page, f"{way}.length() < {0.95 * np.linalg.norm(start)}")
    page.keyboard.press("Home")
    until(page, f"{way}.distanceTo({{x: {start[0]}, y: {start[1]}, z: {start[2]}}}) < 1e-6")


@pytest.mark.thorough
def test_buttons_are_large_enough_for_a_finger(browser, watched):
    shown = watched()
    context = browser.new_context(viewport={"width": 320, "height": 480}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(shown.address)
    until(page, "document.getElementById('reset').textContent !== ''")
    box = page.locator("#reset").bounding_box()
    assert box["width"] >= 44 and box["height"] >= 44
    context.close()


@pytest.mark.thorough
def test_a_page_loads_little_once_and_misses_nothing(browser, watched):
    shown = watched()
    shown.show(face())
    context = browser.new_context(viewport={"width": 160, "height": 160})
    page, answers = context.new_page(), []
    page.on("response", lambda answer: answers.append((answer.url, answer.status)))
    page.goto(shown.address)
    size = "performance.getEntriesByType('resource').reduce((sum, { transferSize }) => sum + transferSize, 0)"
    first = loaded(page).evaluate(size)
    assert len(answers) >= 9 and [url for url, status in answers if status != 200] == []
    document = (ROOT / "docs" / "guides" / "viewer.md").read_text(encoding="utf-8")
    (stated,) = re.findall(r"A page of the built-in head loads (\d\.\d\d) MB", document)
    assert first == pytest.approx(1e6 * float(stated), rel=0.02)
    page.goto(shown.address)
    assert loaded(page).evaluate(size) < 5_000, "everything else is kept by the browser"
    context.close()


@pytest.mark.thorough
def test_without_augmented_reality_the_page_gives_the_reason(open_page, watched):
    shown = watched()
    page = open_page(shown.address)
    until(page, "document.getElementById('reason').textContent !== ''")
    assert "augmented reality" in page.inner_text("#reason")
    assert not page.is_visible("#immersive")


@pytest.mark.thorough
def test_an_iphone_is_told_that_it_has_no_augmented_reality_rather_than_to_use_https(browser, watched):
    shown = watched()
    iphone = "Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) AppleWebKit/605.1.15 Version/18.0 Mobile/15E148"
    context = browser.new_context(user_agent=iphone, locale="en-GB")
    page = context.new_page()
    page.goto(shown.address)
    until(page, "document.getElementById('reason').textContent !== ''")
    assert "iPhones and iPads" in page.inner_text("#reason") and not page.is_visible("#immersive")
    context.close()

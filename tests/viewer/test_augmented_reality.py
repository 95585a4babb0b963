"""In an emulated headset, in a room captured with a real one, heads stand on real surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from tests.helpers.viewer.headset import entered, with_headset
from tests.helpers.viewer.watching import built_in, face, shown_on, until, vertices_of

pytestmark = pytest.mark.thorough
TABLE, FLOOR = 0.73, 0.0
"""Heights of the room's table and floor in metres, as its capture states them."""
SPOT, OTHER = (0.1, TABLE, -2.2), (0.5, TABLE, -1.6)
"""Two marks on the table, world."""
EYES = (0.0, 1.6, 0.0)
AWAY = (1.1, 1.3, -3.4)
"""Where a headset is at first, and where another one is, world."""
CLOSE = 0.012
"""In metres: the captured table is not quite level."""
PICTURES = Path(__file__).resolve().parents[2] / "build" / "viewer" / "pictures"


def aim(page: Page, point: Sequence[float]) -> None:
    """Point the right controller at a point, world, and wait until the page has drawn that."""
    page.evaluate(
        "const hand = headset.position, right = headset.controllers.right;"
        f"pose(right, [hand.x + 0.2, hand.y - 0.3, hand.z], {list(point)})"
    )
    drawn(page)


def trigger(page: Page, *, pressed: bool) -> None:
    page.evaluate(f"headset.controllers.right.updateButtonValue('trigger', {int(pressed)})")
    drawn(page)


def drawn(page: Page, frames: int = 3) -> None:
    count = page.evaluate("viewer.drawn")
    until(page, f"viewer.drawn > {count + frames - 1}")


def placed(page: Page, point: Sequence[float], front: Sequence[float] | None = None) -> None:
    """Press at a point, and release there or at a second one."""
    aim(page, point)
    trigger(page, pressed=True)
    if front is not None:
        aim(page, front)
    trigger(page, pressed=False)


def neck(page: Page) -> float:
    """Distance in metres of the head's lowest vertex below its face."""
    rest = np.array(page.evaluate("Array.from(viewer.avatars[0].rest)")).reshape(-1, 3)
    face, unit = page.evaluate("[viewer.avatars[0].header.face, viewer.avatars[0].header.unit]")
    return 0.09 * (rest[:, 1].max() - face[1]) / unit


def pictured(page: Page, position: Sequence[float], name: str) -> None:
    """Take a picture to look at, of what the headset sees of the place."""
    page.evaluate(f"pose(headset, {list(position)}, {[SPOT[0], 1.0, SPOT[2]]})")
    drawn(page)
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}.png")


def in_world(page: Page, what: str) -> np.ndarray:
    """Position and rotation of an object of the page in the real room, (4, 4)."""
    values = page.evaluate(f"inWorld({what})")
    return np.array(values).reshape(4, 4).T


@pytest.fixture
def enter(browser) -> Iterator[Callable[..., Page]]:
    """A function that opens a page in a headset of its own, which looks level from where it is."""
    contexts = []

    def opened(address: str, position: Sequence[float] = EYES, look_at: Sequence[float] = (0.0, 1.6, -2.0)) -> Page:
        contexts.append(with_headset(browser, position, look_at))
        return entered(contexts[-1], address)

    yield opened
    for context in contexts:
        context.close()


def test_a_headset_shows_the_head_in_the_room_and_gives_it_back(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    ((mode, options),) = page.evaluate("asked.map(([mode, { optionalFeatures }]) => [mode, optionalFeatures])")
    assert mode == "immersive-ar"
    assert options == ["dom-overlay", "hit-test", "anchors"], "only what the page uses"
    until(page, "document.getElementById('immersive').textContent === 'Leave'")
    assert page.evaluate("viewer.scene.background === null")
    placed(page, SPOT)
    page.evaluate("document.getElementById('immersive').click()")
    until(page, "!viewer.renderer.xr.isPresenting && viewer.scene.background !== null")
    until(page, "document.getElementById('immersive').textContent === 'Augmented Reality'")
    assert page.evaluate("viewer.room.group.position.toArray()") == [0, 0, 0]
    assert page.evaluate("viewer.room.group.quaternion.toArray()") == [0, 0, 0, 1]
    page.evaluate("document.getElementById('immersive').click()")
    until(page, "viewer.renderer.xr.isPresenting && viewer.immersion.finds")
    assert page.evaluate("viewer.immersion.place") is None, "each session starts unplaced"


def test_a_press_puts_the_head_on_the_table_facing_the_viewer(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    assert page.evaluate("viewer.immersion.place") is None
    aim(page, SPOT)
    until(page, "viewer.immersion._mark.visible")
    placed(page, SPOT)
    head = in_world(page, "viewer.avatars[0].object")
    assert np.linalg.norm(head[[0, 2], 3] - (SPOT[0], SPOT[2])) < CLOSE
    assert abs(head[1, 3] - neck(page) - TABLE) < CLOSE, "its neck stands on the table"
    eyes = EYES - head[:3, 3]
    eyes[1] = 0.0
    assert head[:3, 2] @ eyes / np.linalg.norm(eyes) > 0.999, "it faces the viewer"
    assert head[:3, 1] @ (0.0, 1.0, 0.0) > 0.9999, "it is upright"
    assert not page.evaluate("viewer.immersion._mark.visible")
    (frame,) = shown.show(face(1))
    shown_on(page, 2)
    assert np.abs(vertices_of(page)[: len(frame.vertices)] - frame.vertices).max() < 1e-3
    pictured(page, (0.0, 1.3, -1.2), "ar_head")


def test_two_viewers_who_use_the_same_two_points_see_the_same_place(enter, watched):
    shown = watched(*[built_in() for _ in range(3)])
    shown.show(face())
    first = enter(shown.address)
    second = enter(shown.address, position=AWAY, look_at=(0.1, 1.3, -2.2))
    for page in (first, second):
        placed(page, SPOT, OTHER)
    poses = [[in_world(page, f"viewer.avatars[{i}].object") for i in range(3)] for page in (first, second)]
    for here, there in zip(*poses, strict=True):
        assert np.linalg.norm(here[:3, 3] - there[:3, 3]) < 2 * CLOSE
        assert np.arccos(np.clip((np.trace(here[:3, :3].T @ there[:3, :3]) - 1) / 2, -1, 1)) < np.radians(2.0)
    front = in_world(first, "viewer.room.group")[:3, 2]
    way = np.subtract(OTHER, SPOT) / np.linalg.norm(np.subtract(OTHER, SPOT))
    assert front @ way > 0.999, "the table's front is towards the second point"
    pictured(first, (0.5, 1.5, -0.7), "ar_first")
    pictured(second, (1.5, 1.4, -2.3), "ar_second")


def test_a_sand_table_stands_on_a_real_table_and_brings_its_own_to_the_floor(enter, watched):
    shown = watched(built_in(), built_in())
    shown.show(face())
    page = enter(shown.address)
    placed(page, SPOT)
    assert page.evaluate("viewer.immersion.on") == "table"
    assert in_world(page, "viewer.room.group")[1, 3] + 0.72 == pytest.approx(TABLE, abs=CLOSE)
    placed(page, (0.9, FLOOR, -1.0))
    assert page.evaluate("viewer.immersion.on") == "floor"
    assert in_world(page, "viewer.room.group")[1, 3] == pytest.approx(FLOOR, abs=5 * CLOSE), (
        "the captured floor is rough"
    )


def test_walls_carry_nothing(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    placed(page, (0.0, 1.7, -6.0))
    assert page.evaluate("viewer.immersion.place") is None


def test_the_place_follows_its_anchor_when_the_headset_corrects_its_map(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    placed(page, SPOT)
    until(page, "viewer.immersion._anchor !== null && viewer.immersion._offset !== null")
    before = in_world(page, "viewer.room.group")
    page.evaluate("shift(viewer.immersion._anchor, [0.05, 0, -0.02])")
    drawn(page)
    moved = in_world(page, "viewer.room.group")
    assert moved[:3, 3] - before[:3, 3] == pytest.approx((0.05, 0.0, -0.02), abs=1e-4)
    placed(page, OTHER)
    assert np.linalg.norm(in_world(page, "viewer.room.group")[[0, 2], 3] - (OTHER[0], OTHER[2])) < CLOSE


def test_other_heads_stand_where_the_last_ones_did(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    placed(page, SPOT, OTHER)
    before = in_world(page, "viewer.room.group")
    shown.drivers = [built_in()[0]]
    shown.show(face(6))
    until(page, "viewer.stream.scene?.scene === 2 && !viewer.loading && viewer.loaded === viewer.stream.scene")
    drawn(page)
    assert np.allclose(in_world(page, "viewer.room.group"), before, atol=1e-5)


def test_without_surfaces_the_head_stays_in_front_of_the_viewer(enter, watched, browser):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    page.evaluate("for (const source of [...viewer.immersion._sources.keys()]) viewer.immersion._forget(source)")
    placed(page, SPOT)
    assert page.evaluate("viewer.immersion.place") is None
    head = in_world(page, "viewer.avatars[0].object")[:3, 3]
    assert head == pytest.approx((0.0, 1.5, -0.8), abs=1e-3)
    assert page.inner_text("#reason") == ""


def test_on_a_phone_a_touch_anywhere_places_what_the_middle_of_the_screen_points_at(enter, watched):
    shown = watched()
    shown.show(face())
    page = enter(shown.address)
    page.evaluate("for (const hand of Object.values(headset.controllers)) hand.connected = false")
    page.evaluate(f"pose(headset, {list(EYES)}, {list(SPOT)})")
    until(page, "viewer.immersion._sources.size === 1")
    drawn(page)
    for name in ("selectstart", "selectend"):
        touch = f"Object.assign(new Event('{name}'), {{ inputSource: {{ targetRayMode: 'screen' }} }})"
        page.evaluate(f"viewer.immersion.session.dispatchEvent({touch}); 0")
    drawn(page)
    head = in_world(page, "viewer.avatars[0].object")
    assert np.linalg.norm(head[[0, 2], 3] - (SPOT[0], SPOT[2])) < CLOSE

"""The sidebar tab Facemime, operated by mouse.

Blender offers no way to query the positions of its buttons. But Ctrl-C over a button copies its Python command, over a
property its value, and Shift-Ctrl-C the path of the property, so the mouse probes its way down the sidebar.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.helpers.gui.window import Blender, GuiError, wait

TAB = "Facemime"
_REGION = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "{kind}")
value = [region.x, bpy.context.window.height - region.y - region.height, region.width, region.height]
"""
_CATEGORY = _REGION.format(kind="UI") + 'value = region.active_panel_category if region.width > 1 else ""\n'
_PANELS = """
panels = [cls for cls in bpy.types.Panel.__subclasses__() if getattr(cls, "bl_category", "") == "Facemime"]
panels = [cls for cls in panels if cls.is_registered and cls.__name__ != "FACEMIME_PT_start"]
for cls in panels:
    if not hasattr(cls, "watched"):
        cls.draw, cls.watched = watched(cls.__name__, cls.draw), True
top = [cls for cls in panels if not getattr(cls, "bl_parent_id", "")]
top.sort(key=lambda cls: getattr(cls, "bl_order", 0))
value = [cls.__name__ for cls in top if not hasattr(cls, "poll") or cls.poll(bpy.context)]
"""
_CHILDREN = (
    "[cls.__name__ for cls in panels if getattr(cls, 'bl_parent_id', '') == {name!r}"
    " and (not hasattr(cls, 'poll') or cls.poll(bpy.context))]"
)
_WATCH = """
drawn = set()
def watched(name, draw):
    def drawing(self, context):
        drawn.add(name)
        draw(self, context)
    return drawing
"""
"""Blender does not say which panels are open either, but draws only those."""
_TAG = """
for area in bpy.context.window.screen.areas:
    for region in area.regions:
        if region.type == "UI":
            region.tag_redraw()
"""
_HEADER = 1.344
"""Height of a collapsed panel, in interface units."""
_BOX, _STEPS = 7.15, (4.9, 5.95, 7.6)
"""Usual height of the box on top of the tab, and the middles of its large buttons without and with a file, and of the
buttons below, in interface units."""
_LINK, _FROM_RIGHT = "wm.url_open", 3.1
"""Button at the right of a header, by which the first header is found, and its distance from the right."""
_HAS_BOX = "hasattr(bpy.types, 'FACEMIME_PT_start')"
_STEP = 0.75
"""Distance between probes, relative to the height of a button."""
_NOTHING = "(nothing)"
_PASTE = f"value, bpy.context.window_manager.clipboard = bpy.context.window_manager.clipboard, {_NOTHING!r}"
_KNOWN: dict[tuple[float, ...], dict[str, list[tuple[float, float]]]] = {}
"""Where buttons were found in a window of some size and resolution scale: tried first, as each probe costs a redraw."""
_PLACES = 4
"""Places that are remembered of a button, the last one first."""


@dataclass(frozen=True)
class Box:
    """A rectangle in the window, pixels from the top left."""

    x: int
    y: int
    width: int
    height: int


class Sidebar:
    """Opens the tab and its panels, and clicks their buttons."""

    def __init__(self, blender: Blender) -> None:
        self.blender = blender
        self._box = _BOX if blender.get(_HAS_BOX) else 0.0
        self._top = 1.0
        self.unit = 20.0 * blender.get("bpy.context.preferences.system.ui_scale")
        self._known = _KNOWN.setdefault((*blender.size, self.unit), {})
        blender.do(_WATCH)
        self.show()

    def box(self, kind: str = "UI") -> Box:
        """Return the rectangle of a region of the largest viewport: "UI" is the sidebar, "WINDOW" the view."""
        return Box(*self.blender.do(_REGION.format(kind=kind)))

    def view(self, right: float = 0.4, down: float = 0.6) -> tuple[float, float]:
        """Return a position in the viewport, relative to its width and height."""
        view = self.box("WINDOW")
        return view.x + right * view.width, view.y + down * view.height

    def show(self) -> None:
        """Open the sidebar by its key and the tab by a click."""
        wait(self._shown, "the sidebar")
        if self.blender.do(_CATEGORY) == TAB:
            return
        tabs, known = self.box(), self._known.setdefault(TAB, [])
        probed = range(tabs.y + round(self.unit), tabs.y + tabs.height, round(self.unit))
        for place in (*known, *((tabs.x + tabs.width - self.unit / 2, y) for y in probed)):
            self.blender.click(*place)
            self.blender.redraw()
            if self.blender.do(_CATEGORY) == TAB:
                known[:] = [place]
                return
        raise GuiError(f"The sidebar has no tab {TAB}.")

    def _shown(self) -> bool:
        if self.box().width > 1:
            return True
        self.blender.move(*self.view(0.39))
        self.blender.move(*self.view())
        self.blender.key("n")
        self.blender.redraw()
        return self.box().width > 1

    def widen(self, by: float) -> None:
        """Drag the sidebar's edge to the left, where panels are: below them Blender takes the mouse for the view's."""
        box = self.box()
        start = (box.x + 1, box.y + self.unit)
        self.blender.drag(start, (start[0] - by / 2, start[1]), (start[0] - by, start[1]))

    def under_mouse(self, x: float, y: float, keys: str = "ctrl+c") -> str:
        """Return what the button at a position copies to the clipboard.

        When the mouse comes from another button, Blender has to see it twice, and sees only the last of several moves
        in a row. Hence a meaningless key is pressed between two moves.
        """
        x, y = round(x), round(y)
        self.blender.input("mousemove", x - 1, y, "key", "shift", "mousemove", x, y, "key", keys)
        self.blender.do("pass")  # Blender reads events, answers this, handles the events, answers the next
        return str(self.blender.do(_PASTE))

    def places(self) -> Iterator[tuple[float, float]]:
        """Yield positions of possible buttons: the large ones of the box on top, the first rows, most of whose buttons
        reach the middle, then column by column.
        """
        box, columns = self.box(), (0.45, 0.2, 0.8, 0.9)
        for step in _STEPS if self._box else ():
            for column in (0.25, 0.8):
                yield box.x + column * (box.width - self.unit), box.y + self.unit * step
        rows = range(int((box.height / self.unit - self._top) / _STEP))
        middle, *others = columns
        first = [(middle, row) for row in rows[:10]] + [(column, row) for row in rows[:5] for column in others]
        rest = [(column, row) for column in columns for row in rows if (column, row) not in first]
        for column, row in first + rest:
            yield box.x + column * (box.width - self.unit), box.y + self.unit * (self._top + _STEP * row)

    def panels(self) -> list[str]:
        """Return the panels of the tab in order."""
        return list(self.blender.do(_PANELS))

    def open_panel(self, name: str, children: bool = False) -> None:
        """Collapse all panels but one by clicks on their headers; `children` also expands its subpanels."""
        box = self.box()
        self.blender.input("mousemove", box.x + 60, box.y + 60, "click", "--repeat", 60, "--delay", 2, 4)
        self._measure_box()
        panels, opened = self.panels(), self._open()
        self._top = self._box + 0.6 + _HEADER * (panels.index(name) + 1)
        if opened.intersection(panels) != {name}:
            if len(opened.intersection(panels)) > 2:
                opened = self._fold_most(panels)
            for panel in (panel for panel in panels if panel in opened):
                self._toggle(panel, panels.index(panel), False)
            self._toggle(name, panels.index(name), True)
        below = self.blender.get(_CHILDREN.format(name=name)) if children else []
        if below and not self._open().issuperset(below):
            for _ in range(1 + bool(self._open().intersection(below))):
                self._click_header(panels.index(name), "ctrl")
            wait(lambda: self._open().issuperset(below), f"the subpanels of {name} expand", 10.0)

    def _measure_box(self) -> None:
        """Find the first header, as the box on top has as many lines as there is to say."""
        box = self.box()
        x = box.x + box.width - _FROM_RIGHT * self.unit
        for step in np.arange(_BOX + 0.6, 3 * _BOX, 0.5) if self._box else ():
            if _LINK in self.under_mouse(x, box.y + step * self.unit):
                self._box = step - 0.6
                return

    def scroll_down(self, steps: int = 60) -> None:
        """Scroll by steps of the wheel, by default to the end of the tab; `open_panel` scrolls back."""
        box = self.box()
        self.blender.input("mousemove", box.x + 60, box.y + 300, "click", "--repeat", steps, "--delay", 5, 5)
        self.blender.redraw()

    def open_presets(self) -> None:
        """Open the menu in the header of Expression, with all panels above collapsed."""
        box, place = self.box(), self.panels().index("FACEMIME_PT_expression")
        x = box.x + box.width - 2.95 * self.unit
        self.blender.click(x, box.y + (self._box + 0.85 + _HEADER * place) * self.unit)
        self.blender.redraw()

    def _fold_most(self, panels: list[str]) -> set[str]:
        """Collapse all panels but the second, which has no subpanels, by Ctrl-click; return the open panels."""
        if panels[0] in self._open():
            self._toggle(panels[0], 0, False)
        self._click_header(1, "ctrl")
        return self._open()

    def _open(self) -> set[str]:
        """Return the open panels."""
        self.blender.do("drawn.clear()")
        self.blender.do(_TAG)
        self.blender.redraw()
        return set(self.blender.get("sorted(drawn)"))

    def _toggle(self, panel: str, place: int, opens: bool, key: str | None = None) -> None:
        """Click the header below `place` collapsed ones to expand or collapse its panel."""
        self._click_header(place, key)
        wait(lambda: (panel in self._open()) == opens, f"panel {panel} folds or unfolds", 10.0)

    def header(self, place: int) -> tuple[float, float]:
        """Return the position of the header below `place` collapsed ones."""
        box = self.box()
        return box.x + 3 * self.unit, box.y + (self._box + 0.85 + _HEADER * place) * self.unit

    def _click_header(self, place: int, key: str | None = None) -> None:
        self.blender.move(*self.header(place))
        self.blender.redraw()
        if not key:
            self.blender.input("click", 1)
            return
        self.blender.input("keydown", key, "click", 1)
        for _ in range(2):  # a slow window asks whether the key is held only when it handles the click
            self.blender.redraw()
        self.blender.input("keyup", key)

    def find(self, name: str) -> tuple[float, float]:
        """Return the position of an operator's button or a property's field; raises GuiError if it is not drawn.

        `name` is an operator with its arguments as Blender writes them, or their beginning, or the path of a property.
        """
        keys = "ctrl+c" if name.startswith("bpy.ops.") else "ctrl+shift+c"
        seen = []
        self.blender.move(*next(self.places()))
        self.blender.redraw()
        self.blender.do(_PASTE)
        known = self._known.setdefault(name, [])
        for again in (False, True):
            if again:  # the box on top may have become lower
                self._top = max(self._top - 3.0, 1.0)
            for place in (*known, *self.places()):
                found = self.under_mouse(*place, keys)
                if name in found:
                    known[:] = [place, *(other for other in known if other != place)][:_PLACES]
                    return place
                seen.append(found)
        raise GuiError(f"No button of the sidebar is {name}; there are {sorted({*seen} - {_NOTHING})}")

    def press(self, name: str) -> None:
        """Click a button or field; see `find`."""
        self.blender.click(*self.find(name))
        self.blender.redraw()

"""Every panel, operator and property leads to a page of the documentation that exists."""

import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from bl_operators.wm import WM_OT_doc_view_manual

from facemime.ui.documentation import PANELS, address, manual_map

DOCS = Path(__file__).resolve().parents[2] / "docs"


def headings(page: Path) -> set[str]:
    """Return the anchors that Sphinx gives the headings of a page."""
    lines = [line.lstrip("# ").lower() for line in page.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]
    return {re.sub(r"[^a-z0-9]+", "-", line).lstrip("-0123456789").rstrip("-") for line in lines}


@pytest.mark.parametrize("page", sorted({*PANELS.values(), *(page for _, page in manual_map()[1])}))
def test_pages_and_their_headings_exist(page):
    name, _, anchor = page.partition("#")
    source = (DOCS / name).with_suffix(".md")
    assert source.is_file() and (not anchor or anchor in headings(source))


def links(panel: type[bpy.types.Panel], context: object) -> list[str]:
    """Return the addresses to which the header of a panel leads."""
    buttons = []

    def operator(name: str, **_: object) -> SimpleNamespace:
        assert name == "wm.url_open"
        buttons.append(SimpleNamespace(url=""))
        return buttons[-1]

    layout = SimpleNamespace(operator=operator, menu=lambda *_, **__: None)
    members = {name: getattr(panel, name, "") for name in ("bl_label", "bl_parent_id", "header_icons")}
    panel.draw_header_preset(type(panel.__name__, (), members | {"layout": layout})(), context)
    return [button.url for button in buttons]


def test_the_header_of_every_panel_links_to_its_page():
    panels = [panel for panel in bpy.types.Panel.__subclasses__() if panel.__name__.startswith("FACEMIME")]
    shown = [panel for panel in panels if "HIDE_HEADER" not in panel.bl_options]
    assert {panel.__name__ for panel in shown} == set(PANELS)
    for panel in shown:
        assert links(panel, bpy.context) == [address(PANELS[panel.__name__])]


def test_the_link_leaves_a_header_in_which_it_would_cover_the_title():
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
    for width, fits in ((160, {"FACEMIME_PT_head", "FACEMIME_PT_regions"}), (400, set(PANELS))):
        context = SimpleNamespace(region=SimpleNamespace(width=width), preferences=preferences)
        panels = {f"FACEMIME_PT_{name}" for name in ("head", "regions", "control_points", "expression", "bake")}
        assert {name for name in panels if links(getattr(bpy.types, name), context)} == fits & panels


def test_the_online_manual_knows_every_operator_and_setting():
    names = [f"bpy.ops.facemime.{name}" for name in dir(bpy.ops.facemime)]
    groups = [cls for cls in bpy.types.PropertyGroup.__subclasses__() if cls.__name__.startswith("Facemime")]
    names += [f"bpy.types.{cls.__name__}.{prop.identifier}" for cls in groups for prop in cls.bl_rna.properties]
    assert len(names) > 80
    for name in names:
        assert WM_OT_doc_view_manual._lookup_rna_url(name, verbose=False).startswith(address("")), name

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


def test_the_header_of_every_panel_links_to_its_page():
    panels = [panel for panel in bpy.types.Panel.__subclasses__() if panel.__name__.startswith("FACEMIME")]
    shown = [panel for panel in panels if "HIDE_HEADER" not in panel.bl_options]
    assert {panel.__name__ for panel in shown} == set(PANELS)
    for panel in shown:
        button, drawn = SimpleNamespace(url=""), []
        layout = SimpleNamespace(
            operator=lambda name, drawn=drawn, button=button, **_: drawn.append(name) or button,
            menu=lambda *_, **__: None,
        )
        panel.draw_header_preset(type(panel.__name__, (), {"layout": layout})(), bpy.context)
        assert drawn == ["wm.url_open"] and button.url == address(PANELS[panel.__name__])


def test_the_online_manual_knows_every_operator_and_setting():
    names = [f"bpy.ops.facemime.{name}" for name in dir(bpy.ops.facemime)]
    groups = [cls for cls in bpy.types.PropertyGroup.__subclasses__() if cls.__name__.startswith("Facemime")]
    names += [f"bpy.types.{cls.__name__}.{prop.identifier}" for cls in groups for prop in cls.bl_rna.properties]
    assert len(names) > 80
    for name in names:
        assert WM_OT_doc_view_manual._lookup_rna_url(name, verbose=False).startswith(address("")), name

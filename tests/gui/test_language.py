"""In another language Facemime's words keep their meaning, whatever Blender's own catalogue says of the same words."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.gui.conftest import SUITES, install, place_of
from tests.helpers.gui.catalogues import LANGUAGE, WRONG, write_catalogue
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.window import Blender

pytestmark = pytest.mark.thorough
_SHOWN = """
import inspect
t = bpy.app.translations
def rna_of(cls):
    if not issubclass(cls, bpy.types.Operator):
        return cls.bl_rna
    return getattr(bpy.ops.facemime, cls.bl_idname.rpartition(".")[2]).get_rna_type()
bases = (bpy.types.Operator, bpy.types.Panel, bpy.types.Menu, bpy.types.PropertyGroup)
ours = [cls for base in bases for cls in base.__subclasses__() if ".facemime." in cls.__module__ and cls.is_registered]
value = {}
for cls in ours:
    rna = rna_of(cls)
    if getattr(cls, "bl_label", ""):
        value[cls.bl_label] = t.pgettext(cls.bl_label, rna.translation_context)
    for prop in rna.properties:
        if prop.identifier in {name for base in cls.__mro__ for name in inspect.get_annotations(base)}:
            value[prop.name] = t.pgettext(prop.name, prop.translation_context)
"""


@pytest.fixture(params=SUITES)
def blender(request) -> Iterator[Blender]:
    """A Blender whose catalogue gives every text of Facemime another meaning."""
    source = place_of(request.param)
    with tempfile.TemporaryDirectory(prefix="language-", dir=source.parent) as folder:
        place = Path(folder) / source.name
        subprocess.run(["cp", "--archive", "--link", source, place], check=True)
        write_catalogue(place / "usr" / "share" / "locale")
        with Blender(place, f"{request.param}/language", size=(1100, 1080)) as window:
            install(window)
            yield window


def test_no_text_of_the_panels_has_the_meaning_that_blender_gives_it(blender):
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    blender.do("view = bpy.context.preferences.view")
    blender.do(f"view.language = {LANGUAGE!r}; view.use_translate_interface = view.use_translate_tooltips = True")
    blender.redraw()
    assert blender.get("bpy.app.translations.pgettext('Expression')") == WRONG
    shown = blender.do(_SHOWN)
    assert len(shown) > 100 and shown["Expression"] == "表情"
    assert [text for text, other in shown.items() if other == WRONG] == []
    sidebar = Sidebar(blender)
    blender.do("bpy.ops.facemime.add_head()")
    for panel in sidebar.panels():
        sidebar.open_panel(panel, children=True)
        blender.shot(panel.removeprefix("FACEMIME_PT_"))
    assert "Traceback" not in blender.printed()

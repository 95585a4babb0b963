"""Facemime's words are translated in a separate context, so that Blender's meanings of them do not take precedence."""

from inspect import get_annotations
from types import SimpleNamespace

import bpy
import pytest

import facemime.registration as registration
from facemime.blender.heads.new_heads import add_head
from facemime.blender.messages import CONTEXT, interface, load_languages, texts
from facemime.blender.registering import classes_of

CLASSES = [cls for module in registration._MODULES for cls in classes_of(module)]
TYPES = (bpy.types.Operator, bpy.types.Panel, bpy.types.Menu)


def test_labels_of_classes_and_names_of_properties_are_in_the_context():
    for cls in CLASSES:
        if issubclass(cls, TYPES):
            assert cls.bl_rna.translation_context == CONTEXT, cls
        is_operator = issubclass(cls, bpy.types.Operator)
        rna = getattr(bpy.ops.facemime, cls.bl_idname.partition(".")[2]).get_rna_type() if is_operator else cls.bl_rna
        for prop in rna.properties:
            if prop.identifier in _own(cls):
                assert prop.translation_context == CONTEXT, (cls, prop.identifier)


def _own(cls: type) -> set[str]:
    return {name for base in cls.__mro__ for name in get_annotations(base)}


def test_every_text_is_registered_in_the_context():
    known = load_languages()["zh_HANS"]
    registered = texts()["zh_HANS"]
    assert {english: registered[CONTEXT, english] for english in known} == known


class Layout:
    """Substitute for a layout: records texts that Blender would translate in its own context."""

    def __init__(self):
        self.astray = []

    def __getattr__(self, name):
        def call(*arguments, text="", heading="", translate=True, text_ctxt="", heading_ctxt="", **_):
            in_type = name in {"operator", "operator_menu_enum"}
            for shown, context in ((text, text_ctxt), (heading, heading_ctxt)):
                if shown.strip() and translate and not in_type and context != CONTEXT:
                    self.astray.append((name, shown))
            return self

        return call


@pytest.mark.parametrize("prepare", [lambda: None, lambda: add_head(bpy.context)], ids=["empty", "head"])
def test_panels_and_menus_translate_what_they_show_in_the_context(prepare):
    prepare()
    layout = Layout()
    for cls in CLASSES:
        drawn = issubclass(cls, (bpy.types.Panel, bpy.types.Menu))
        if drawn and (getattr(cls, "poll", None) is None or cls.poll(bpy.context)):
            cls.draw(SimpleNamespace(layout=layout, entries=getattr(cls, "entries", ())), bpy.context)
    assert layout.astray == []


def test_a_text_without_a_translation_is_shown_in_english():
    assert interface("No such text") == "No such text"

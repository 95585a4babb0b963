"""Messages with values, such as errors of `core`, are shown in the language of Blender's interface."""

import importlib.util
import re

import bpy
import pytest

from facemime.blender import messages
from facemime.blender.heads.new_heads import add_head
from facemime.blender.messages import NESTED, Templates, load_languages, translated
from tests.helpers.blenders import ROOT

_SPEC = importlib.util.spec_from_file_location("strings", ROOT / "tools" / "strings.py")
strings = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(strings)
CHINESE = load_languages()["zh_HANS"]
_PLACEHOLDER = re.compile(r"\{(\w+)[^}]*\}")


def lookup(text: str) -> str:
    """Look up a text as Blender does when its interface is in Chinese; the module has no languages."""
    return CHINESE.get(text, text)


def test_every_message_with_values_is_recognised_and_its_values_are_kept():
    templates = Templates(CHINESE)
    for template in (text for text in strings.wanted() if _PLACEHOLDER.search(text)):
        values = {name: f"<{name}>" for name in _PLACEHOLDER.findall(template)}
        message = _PLACEHOLDER.sub(lambda match, values=values: values[match[1]], template)
        expected = _PLACEHOLDER.sub(lambda match, values=values: values[match[1]], CHINESE[template])
        assert templates.translate(message, lookup) == expected, template


def test_texts_within_messages_are_translated_and_names_are_not():
    known = {"{name} is hidden. {advice}": "{name} 被隐藏。{advice}", "Show it.": "请显示。", "Head": "头部"}
    assert "advice" in NESTED and "name" not in NESTED
    shown = Templates(known).translate("Head is hidden. Show it.", lambda text: known.get(text, text))
    assert shown == "Head 被隐藏。请显示。"


def test_reasons_within_messages_are_translated():
    reason = CHINESE["its frames cannot be unpacked: {error}"].format(error=CHINESE["its archive is damaged"])
    message = (
        "The packed take Take is damaged (its frames cannot be unpacked: its archive is damaged). Import it again."
    )
    template = CHINESE["The packed take {name} is damaged ({error}). Import it again."]
    assert Templates(CHINESE).translate(message, lookup) == template.format(name="Take", error=reason)


def test_no_template_is_compared_in_english(monkeypatch):
    monkeypatch.setattr(Templates, "_find", lambda *_: pytest.fail("a template was compared"))
    message = "head.tri cannot be read. Choose another file."
    assert Templates(CHINESE).translate(message, lambda text: text) == message


def test_an_unknown_message_is_left_unchanged():
    assert translated("No template matches this.") == "No template matches this."


def test_an_error_of_core_is_reported_in_chinese(monkeypatch, tmp_path):
    monkeypatch.setattr(messages, "pgettext_rpt", lambda text, context: lookup(text))
    add_head(bpy.context)
    bpy.context.scene.facemime.source.kind = "TAKE"
    bpy.context.scene.facemime.source.take = str(tmp_path / "none.facetake")
    with pytest.raises(RuntimeError, match="没有"):
        bpy.ops.facemime.puppet()

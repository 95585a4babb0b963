"""Messages with values, such as errors of `core`, are shown in the language of Blender's interface."""

import bpy
import pytest

from facemime.blender import messages
from facemime.blender.heads.new_heads import add_head
from facemime.blender.messages import load_languages, translated
from facemime.core.errors import DataError, Message, SourceError

CHINESE = load_languages()["zh_HANS"]


def lookup(text: str) -> str:
    """Look up a text as Blender does when its interface is in Chinese; the module has no languages."""
    return CHINESE.get(text, text)


def test_values_are_inserted_into_the_translation():
    known = {"{name} is {share:.1f} % hidden.": "{share:.1f} % 的 {name} 被隐藏。", "Head": "头部"}
    message = Message("{name} is {share:.1f} % hidden.", name="Head", share=12.34)
    assert translated(message, lambda text: known.get(text, text)) == "12.3 % 的 Head 被隐藏。"


def test_messages_within_messages_are_translated_and_names_are_not():
    known = {"{name} is hidden. {advice}": "{name} 被隐藏。{advice}", "Show it.": "请显示。", "Head": "头部"}
    message = Message("{name} is hidden. {advice}", name="Head", advice=Message("Show it."))
    assert translated(message, lambda text: known.get(text, text)) == "Head 被隐藏。请显示。"


def test_reasons_within_errors_are_translated():
    damaged = DataError("its frames cannot be unpacked: {error}", error=DataError("its archive is damaged"))
    template = "The packed take {name} is damaged ({error}). Import it again."
    reason = CHINESE["its frames cannot be unpacked: {error}"].format(error=CHINESE["its archive is damaged"])
    message = str(SourceError(template, name="Take", error=damaged))
    assert translated(message, lookup) == CHINESE[template].format(name="Take", error=reason)


def test_texts_without_a_translation_are_left_unchanged():
    for text in ("No translation has this.", Message("No translation has this {name}.", name="text")):
        assert translated(text) == text


def test_an_error_of_core_is_reported_in_chinese(monkeypatch, tmp_path):
    monkeypatch.setattr(messages, "pgettext_rpt", lambda text, context: lookup(text))
    add_head(bpy.context)
    bpy.context.scene.facemime.source.kind = "TAKE"
    bpy.context.scene.facemime.source.take = str(tmp_path / "none.facetake")
    with pytest.raises(RuntimeError, match="没有"):
        bpy.ops.facemime.puppet()

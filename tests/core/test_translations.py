"""Every text of the interface can be translated, and is translated into Chinese."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_SPEC = importlib.util.spec_from_file_location("strings", ROOT / "tools" / "strings.py")
strings = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(strings)
LANGUAGES = sorted(strings.TRANSLATIONS.glob("*.json"))


def test_no_chinese_translation_is_missing():
    assert strings.lacking("zh_HANS") == []


def test_the_texts_are_found_in_the_sources():
    wanted = strings.wanted()
    for text in ("Start Puppet", "No face in view", "Sample Clip", "Leave Edit Mode first", "Calibration"):
        assert text in wanted


def test_the_functions_that_return_messages_are_in_the_sources():
    modules = [path.read_text(encoding="utf-8") for path in strings.message_sources()]
    for name in strings._FUNCTIONS:
        assert any(f"def {name}(" in module for module in modules), name


@pytest.mark.parametrize("path", LANGUAGES, ids=lambda path: path.stem)
def test_translations_keep_the_placeholders(path):
    for english, other in json.loads(path.read_text(encoding="utf-8")).items():
        assert sorted(re.findall(r"\{[^}]*\}", english)) == sorted(re.findall(r"\{[^}]*\}", other)), english
        assert english.count("%") == other.count("%"), english


def test_tooltips_of_operators_end_without_a_full_stop():
    for path in strings.sources():
        for text in strings.strings(path):
            assert "\n" not in text, text
            assert not (text.endswith(".") and path.parent.name == "operators" and ". " not in text), text

"""Every text of the interface can be translated, and is translated into Chinese."""

import ast
import importlib.util
import json
import re
from pathlib import Path
from string import Formatter

import pytest

ROOT = Path(__file__).resolve().parents[2]
_SPEC = importlib.util.spec_from_file_location("strings", ROOT / "tools" / "strings.py")
strings = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(strings)
LANGUAGES = sorted(strings.TRANSLATIONS.glob("*.json"))
SOURCES = [*strings.message_sources(), *strings._modules("cli/**/*.py")]


def test_no_chinese_translation_is_missing():
    assert strings.lacking("zh_HANS") == []


def test_the_texts_are_found_in_the_sources():
    wanted = strings.wanted()
    for text in ("Start Puppet", "No face in view", "Sample Clip", "Leave Edit Mode first", "Calibration"):
        assert text in wanted


def test_messages_and_errors_of_every_kind_are_collected(tmp_path):
    """Constants, templates, either of two, constants of the module, and tables; but no names, and no other texts."""
    module = tmp_path / "module.py"
    module.write_text(
        """
LOST = "The face was lost."
TABLE = messages({1: "Chin"} | {2: "Tip of the nose"})
raise SourceError(LOST if gone else text)
raise MisnamedError("{path} is missing.", path=shown("a path"))
raise DataError("it has no rows" if empty else "it has {count} rows", count=count)
report(self, "Written to {path}", path=path)
Message(LOST)
print("Done already")
"""
    )
    assert set(strings.messages(module)) == {
        *("The face was lost.", "Chin", "Tip of the nose", "{path} is missing.", "Written to {path}"),
        *("it has no rows", "it has {count} rows"),
    }


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_messages_are_given_the_values_that_their_templates_name(path):
    makers = strings._makers()
    for call in (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)):
        given = {word.arg for word in call.keywords}
        for template in call.args[makers.get(strings._name(call.func), len(call.args)) :][:1]:
            named = {name for text in strings._texts(template) for _, name, *_ in Formatter().parse(text) if name}
            if list(strings._texts(template)) and None not in given:
                assert named == given, f"line {call.lineno}"


def test_a_message_is_no_f_string(tmp_path):
    module = tmp_path / "module.py"
    module.write_text('note = Message(f"{count} rows")')
    with pytest.raises(AssertionError, match="not a template"):
        list(strings.messages(module))


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

"""The texts that Blender's interface shows of Facemime, out of its sources; prints those that a language still lacks.

Usage: python tools/strings.py [LANGUAGE]; zh_HANS by default. Blender looks texts up as they stand in the sources:
labels, tooltips (of operators their docstrings), enumeration items, `text=` of buttons, and what goes through `_()` or
`labels()`.
"""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TRANSLATIONS = ROOT / "assets" / "translations"
_ATTRIBUTES = {"bl_label", "bl_description"}
_KEYWORDS = {"name", "description", "text", "heading", "title", "message"}
_CALLS = {"_", "pgettext_iface", "pgettext_rpt", "labels", "label", "poll_message_set"}
_SETTINGS = {"setting", "Choice"}
"""Their first argument is a value."""
_NOT_SHOWN = {"WINDOW", "Facemime"}


def sources() -> list[Path]:
    """The modules whose texts users see in Blender."""
    patterns = ("operators/*.py", "ui/*.py", "settings/*.py", "core/*/settings.py")
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


def strings(path: Path) -> Iterator[str]:
    """The texts of one module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield from _of_class(node)
        elif isinstance(node, ast.Call):
            yield from _of_call(node)


def _of_class(node: ast.ClassDef) -> Iterator[str]:
    if "_OT_" in node.name and (text := ast.get_docstring(node)):
        yield text
    for statement in node.body:
        if isinstance(statement, ast.Assign) and getattr(statement.targets[0], "id", "") in _ATTRIBUTES:
            yield from _texts(statement.value)


def _of_call(node: ast.Call) -> Iterator[str]:
    called = getattr(node.func, "id", getattr(node.func, "attr", ""))
    if any(word.arg == "translate" for word in node.keywords):
        return
    for word in node.keywords:
        if word.arg in _KEYWORDS:
            yield from _texts(word.value)
        elif word.arg == "items":
            yield from _of_items(word.value)
    if called in _CALLS or called in _SETTINGS:
        for argument in node.args[called in _SETTINGS :]:
            yield from _texts(argument)


def _of_items(node: ast.expr) -> Iterator[str]:
    for item in getattr(node, "elts", ()):
        for text in getattr(item, "elts", ())[1:3]:
            yield from _texts(text)


def _texts(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value.strip()) > 1:
        if not node.value.isupper() and node.value not in _NOT_SHOWN:
            yield node.value
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body)
        yield from _texts(node.orelse)


def wanted() -> list[str]:
    """All texts, each once, in the order of the sources."""
    return list(dict.fromkeys(text for path in sources() for text in strings(path)))


def lacking(language: str) -> list[str]:
    """What `language` has no translation of."""
    known = json.loads((TRANSLATIONS / f"{language}.json").read_text(encoding="utf-8"))
    return [text for text in wanted() if not known.get(text)]


if __name__ == "__main__":
    print(json.dumps(lacking(*sys.argv[1:] or ["zh_HANS"]), indent=0, ensure_ascii=False))

"""Collect the texts that Facemime shows in Blender from its sources, and print those that a language lacks.

Usage: python tools/strings.py [LANGUAGE] [--unused]; zh_HANS by default. With --unused it prints the translations of
texts that are no longer in the sources. There are two kinds of texts. Blender looks up constant texts:
labels, tooltips (the docstrings of operators), items of enumerations, `text=` of buttons, and the arguments of `_()`
and `labels()`. Messages such as errors contain values: what is collected are the templates from which `Message`, errors
and `report` make them, and the tables of `messages()`.
"""

from __future__ import annotations

import argparse
import ast
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TRANSLATIONS = ROOT / "assets" / "translations"
_ATTRIBUTES = {"bl_label", "bl_description"}
_KEYWORDS = {"name", "description", "text", "heading", "title"}
_CALLS = {"StreamProtocol", "_", "pgettext_iface", "pgettext_rpt", "labels", "label", "require"}
_SETTINGS = {"setting", "Choice"}
"""Their first argument is a value."""
_NOT_SHOWN = {"WINDOW", "Facemime", "3D View"}


def sources() -> list[Path]:
    """Return the modules with texts that Blender looks up; in core, these are the ones that define settings."""
    defining = [path for path in _modules("core/*/*.py") if _SETTINGS & _imported(path)]
    return [*_modules("operators/*.py", "ui/*.py", "settings/*.py", "blender/*properties.py"), *defining]


def message_sources() -> list[Path]:
    """Return the modules with messages."""
    return _modules(*(f"{room}/**/*.py" for room in ("core", "blender", "settings", "sessions", "operators", "ui")))


def _modules(*patterns: str) -> list[Path]:
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


@cache
def _nodes(path: Path) -> list[ast.AST]:
    """All nodes of a module, the module itself first."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def _imported(path: Path) -> set[str]:
    """Return the names that a module imports from others."""
    return {name.name for node in _nodes(path) if isinstance(node, ast.ImportFrom) for name in node.names}


@cache
def _assigned(path: Path) -> dict[str, ast.expr]:
    """Return what a module assigns to its constants."""
    made = (node for node in ast.iter_child_nodes(_nodes(path)[0]) if isinstance(node, ast.Assign))
    return {node.targets[0].id: node.value for node in made if isinstance(node.targets[0], ast.Name)}


def strings(path: Path) -> Iterator[str]:
    """Yield the texts of a module that Blender looks up."""
    for node in _nodes(path):
        if isinstance(node, ast.ClassDef):
            yield from _of_class(node)
        elif isinstance(node, ast.Call):
            yield from _of_call(node, _assigned(path))


def _of_class(node: ast.ClassDef) -> Iterator[str]:
    if "_OT_" in node.name and (text := ast.get_docstring(node)):
        yield text
    for statement in node.body:
        if isinstance(statement, ast.Assign) and getattr(statement.targets[0], "id", "") in _ATTRIBUTES:
            yield from _texts(statement.value)


def _of_call(node: ast.Call, assigned: dict[str, ast.expr]) -> Iterator[str]:
    called = _name(node.func)
    if any(word.arg == "translate" for word in node.keywords):
        return
    for word in node.keywords:
        if word.arg in _KEYWORDS:
            yield from _texts(word.value)
        elif word.arg == "items":
            yield from _of_items(assigned.get(_name(word.value), word.value))
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


def messages(path: Path) -> Iterator[str]:
    """Yield the constants and templates of a module's messages."""
    assigned, makers = _assigned(path), _makers()
    for node in (node for node in _nodes(path) if isinstance(node, ast.Call)):
        called = _name(node.func)
        for template in node.args[makers.get(called, len(node.args)) :][:1]:
            assert not isinstance(template, ast.JoinedStr), f"{path}:{node.lineno} is an f-string, not a template"
            yield from _texts(assigned.get(_name(template), template))
        for table in ast.walk(node) if called == "messages" else ():
            for value in getattr(table, "values", ()):
                yield from _texts(value)


@cache
def _makers() -> dict[str, int]:
    """Return the names of what makes messages, and the place of the template among their arguments.

    These are the classes of core/errors.py, and those of errors that are derived from them.
    """
    names = {node.name for node in _nodes(ROOT / "core" / "errors.py") if isinstance(node, ast.ClassDef)}
    classes = [node for path in message_sources() for node in _nodes(path) if isinstance(node, ast.ClassDef)]
    while more := {node.name for node in classes if names & set(map(_name, node.bases))} - names:
        names |= more
    return dict.fromkeys(names, 0) | {"report": 1}


def _name(node: ast.expr) -> str:
    return str(getattr(node, "id", getattr(node, "attr", "")))


@cache
def wanted() -> list[str]:
    """Return all texts and templates, each once, in the order of the sources."""
    texts = [text for path in sources() for text in strings(path)]
    texts += [text for path in message_sources() for text in messages(path)]
    return list(dict.fromkeys(texts))


def lacking(language: str) -> list[str]:
    """Return the texts that `language` does not translate."""
    known = json.loads((TRANSLATIONS / f"{language}.json").read_text(encoding="utf-8"))
    return [text for text in wanted() if not known.get(text)]


def unused(language: str) -> list[str]:
    """Return the texts that `language` translates and that are no longer in the sources."""
    known = json.loads((TRANSLATIONS / f"{language}.json").read_text(encoding="utf-8"))
    current = set(wanted())
    return [text for text in known if text not in current]


def main() -> None:
    """Print the texts as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("language", nargs="?", default="zh_HANS", help="as Blender names it (zh_HANS)")
    parser.add_argument("--unused", action="store_true", help="print translations that are no longer used")
    arguments = parser.parse_args()
    texts = unused(arguments.language) if arguments.unused else lacking(arguments.language)
    print(json.dumps(texts, indent=0, ensure_ascii=False))


if __name__ == "__main__":
    main()

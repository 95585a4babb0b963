"""Collect the texts that Facemime shows in Blender from its sources, and print those that a language lacks.

Usage: python tools/strings.py [LANGUAGE] [--unused]; zh_HANS by default. With --unused it prints the translations of
texts that are no longer in the sources. There are two kinds of texts. Blender looks up constant texts:
labels, tooltips (the docstrings of operators), items of enumerations, `text=` of buttons, and the arguments of `_()`
and `labels()`. Messages such as errors contain values: the template of an f-string is collected, with the name of each
value in braces, and `blender/messages.py` compares messages with it.
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
_KEYWORDS = {"name", "description", "text", "heading", "title", "message"}
_CALLS = {"StreamProtocol", "_", "pgettext_iface", "pgettext_rpt", "labels", "label", "require"}
_SETTINGS = {"setting", "Choice"}
"""Their first argument is a value."""
_ERRORS = {
    "FacemimeError",
    "SourceError",
    "ModelError",
    "HeadError",
    "OutputError",
    "MisnamedError",
    "VertexTakenError",
}
_MESSAGES = {"report", "Finding", "Quality", "_chosen"}
_FUNCTIONS = {
    *("doubt", "explain_failure", "missing_parts", "summary", "turn_note", "problem"),
    *("nobody_receives", "nothing_came", "_faceless", "_foreign", "_refusal"),
}
"""Functions that return messages."""
_TABLES = {
    "MARKS",
    "START",
    "PART_NAMES",
    "_OWN_PARTS",
    "_DESCRIPTIONS",
    "BONES",
    "_EXPLANATIONS",
    "_STAGES",
    "_TASKS",
    "BUILT_IN",
    "REFUSALS",
}
"""Dictionaries, or tuples of them, whose values are messages."""
_ITEMS = {"_POSES"}
"""Variables to which items of enumerations are assigned."""
_LABELS = {"MARKS"}
"""Those that are shown with a capital letter."""
_VARIABLES = {"reason", "recovered", "warning"}
"""Variables, attributes and items to which messages are assigned."""
_NOT_SHOWN = {"WINDOW", "Facemime", "3D View"}


def sources() -> list[Path]:
    """Return the modules with texts that Blender looks up."""
    return _modules("operators/*.py", "ui/*.py", "settings/*.py", "core/*/*settings.py")


def message_sources() -> list[Path]:
    """Return the modules with messages."""
    return _modules(*(f"{room}/**/*.py" for room in ("core", "blender", "settings", "sessions", "operators", "ui")))


def _modules(*patterns: str) -> list[Path]:
    return sorted(path for pattern in patterns for path in ROOT.glob(pattern))


@cache
def _nodes(path: Path) -> list[ast.AST]:
    """All nodes of a module, the module itself first."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def strings(path: Path) -> Iterator[str]:
    """Yield the texts of a module that Blender looks up."""
    for node in _nodes(path):
        if isinstance(node, ast.ClassDef):
            yield from _of_class(node)
        elif isinstance(node, ast.Call):
            yield from _of_call(node)
        elif isinstance(node, ast.Assign) and _target(node) in _ITEMS:
            yield from _of_items(node.value)


def _of_class(node: ast.ClassDef) -> Iterator[str]:
    if "_OT_" in node.name and (text := ast.get_docstring(node)):
        yield text
    for statement in node.body:
        if isinstance(statement, ast.Assign) and getattr(statement.targets[0], "id", "") in _ATTRIBUTES:
            yield from _texts(statement.value)


def _of_call(node: ast.Call) -> Iterator[str]:
    called = _name(node.func)
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


def messages(path: Path) -> Iterator[str]:
    """Yield the messages of a module, and the templates of those that contain values."""
    constants = dict(_constants(_nodes(path)[0]))
    for node in _nodes(path):
        if isinstance(node, ast.Call) and _makes_message(node.func):
            found = [*node.args, *(word.value for word in node.keywords if word.arg in ("message", "reason"))]
        elif isinstance(node, ast.FunctionDef) and node.name in _FUNCTIONS:
            found = [part.value for part in ast.walk(node) if isinstance(part, ast.Return) and part.value is not None]
        elif isinstance(node, ast.Assign) and _target(node) in _VARIABLES:
            found = [node.value]
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value and _target(node) in _TABLES:
            shown = str.capitalize if _target(node) in _LABELS else str
            yield from map(shown, _of_table(node.value))
            continue
        else:
            continue
        for part in found:
            yield from _templates(part, constants)


def _target(node: ast.Assign | ast.AnnAssign) -> str:
    """Return the name of what is assigned to; of an item its key."""
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    if isinstance(target, ast.Subscript) and isinstance(target.slice, ast.Constant):
        return str(target.slice.value)
    return _name(target)


def _of_table(node: ast.expr) -> Iterator[str]:
    for part in ast.walk(node):
        if isinstance(part, ast.Dict):
            for value in part.values:
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    yield value.value


def _makes_message(func: ast.expr) -> bool:
    """Return whether a call creates an error or shows a message; `type(error)(...)` does so, too."""
    if isinstance(func, ast.Call):
        return _name(func.func) == "type"
    return _name(func) in _ERRORS | _MESSAGES


def _constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the names and values of the constants of a module, which templates contain as text."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield _name(node.targets[0]), node.value.value


def _templates(node: ast.expr, constants: dict[str, str]) -> Iterator[str]:
    if isinstance(node, ast.JoinedStr):
        if " " in (text := _template(node, constants)):
            yield text
    elif isinstance(node, ast.IfExp | ast.List | ast.Tuple):
        for part in (node.body, node.orelse) if isinstance(node, ast.IfExp) else node.elts:
            yield from _templates(part, constants)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
        yield node.value
    elif isinstance(node, ast.Name) and " " in (text := constants.get(node.id, "")):
        yield text


def _template(node: ast.JoinedStr, constants: dict[str, str]) -> str:
    text = ""
    used: dict[str, int] = {}
    for part in node.values:
        if isinstance(part, ast.Constant):
            text += str(part.value)
            continue
        assert isinstance(part, ast.FormattedValue)
        if (raw := _name(part.value)) in constants:
            text += constants[raw]
            continue
        name = _value_name(part.value)
        used[name] = used.get(name, 0) + 1
        text += "{" + name + (str(used[name]) if used[name] > 1 else "") + "}"
    return text


def _value_name(node: ast.expr) -> str:
    """Return a name for a value, from the expression that computes it."""
    if isinstance(node, ast.Name | ast.Attribute):
        return _name(node).strip("_")
    if isinstance(node, ast.Call):
        owner = node.func.value if isinstance(node.func, ast.Attribute) else node.func
        return _value_name(node.args[0] if node.args else owner)
    if isinstance(node, ast.BinOp):
        return _value_name(node.left if not isinstance(node.left, ast.Constant) else node.right)
    if isinstance(node, ast.Subscript):
        return _value_name(node.slice if isinstance(node.slice, ast.Name) else node.value)
    return next((_value_name(part) for part in ast.walk(node) if isinstance(part, ast.Name | ast.Attribute)), "value")


@cache
def _assigned(path: Path) -> dict[str, ast.expr]:
    """Return what a module assigns to its constants."""
    made = (node for node in _nodes(path) if isinstance(node, ast.Assign))
    return {node.targets[0].id: node.value for node in made if isinstance(node.targets[0], ast.Name)}


def made_messages(path: Path) -> Iterator[str]:
    """Yield the constants and templates of a module's messages."""
    for node in _nodes(path):
        if not isinstance(node, ast.Call) or not node.args:
            continue
        if (called := _name(node.func)) in _made() or called == "Message":
            yield from _texts(_assigned(path).get(_name(node.args[0]), node.args[0]))
        elif called == "messages":
            for part in ast.walk(node.args[0]):
                for value in getattr(part, "values", ()):
                    yield from _texts(value)


@cache
def _made() -> set[str]:
    """Return the names of the classes of errors, which are made like messages: those of core/base/errors.py, and others
    that are derived from them.
    """
    names = {node.name for node in _nodes(ROOT / "core" / "base" / "errors.py") if isinstance(node, ast.ClassDef)}
    classes = [node for path in message_sources() for node in _nodes(path) if isinstance(node, ast.ClassDef)]
    while more := {node.name for node in classes if names & set(map(_name, node.bases))} - names:
        names |= more
    return names


def _name(node: ast.expr) -> str:
    return str(getattr(node, "id", getattr(node, "attr", "")))


@cache
def wanted() -> list[str]:
    """Return all texts and templates, each once, in the order of the sources."""
    texts = [text for path in sources() for text in strings(path)]
    texts += [text for path in message_sources() for text in made_messages(path)]
    texts += [text for path in message_sources() if "core" not in path.parts for text in messages(path)]
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

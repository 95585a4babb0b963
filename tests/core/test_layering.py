"""Who may know whom."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CORE = sorted((ROOT / "core").rglob("*.py"))
FORBIDDEN = {"bpy", "bmesh", "mathutils", "scipy"}


def imports(path: Path) -> list[tuple[int, str]]:
    """(level, module) of every import in a file; `from . import a` counts as a."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(0, name.name) for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module] if node.module else [name.name for name in node.names]
            found += [(node.level, module) for module in modules]
    return found


@pytest.mark.parametrize("path", CORE, ids=lambda p: str(p.relative_to(ROOT)))
def test_core_knows_neither_blender_nor_the_rest_of_the_house(path):
    depth = len(path.relative_to(ROOT).parts) - 1
    for level, module in imports(path):
        assert level or module.split(".")[0] not in FORBIDDEN, module
        assert level <= depth, f"{module} lies outside core"


def test_the_command_and_all_of_core_can_be_imported_without_blender():
    modules = [".".join(["facemime", *p.relative_to(ROOT).with_suffix("").parts]) for p in CORE]
    names = [*(module.removesuffix(".__init__") for module in modules), "facemime.cli.main"]
    code = (
        "import sys, importlib\n"
        "for name in ('bpy', 'bmesh', 'mathutils', 'scipy'): sys.modules[name] = None\n"
        f"for name in {names}: importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT.parent)


def test_modules_import_each_other_relatively_so_that_they_work_as_an_extension():
    for folder in ("batch", "blender", "cli", "core", "operators", "scene", "sessions", "ui"):
        for path in (ROOT / folder).rglob("*.py"):
            assert all(level or module.split(".")[0] != "facemime" for level, module in imports(path)), path

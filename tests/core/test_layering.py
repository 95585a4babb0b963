"""Layers of packages: modules import only from layers below."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FLOORS = (
    "core",
    "core/numeric",
    "core/files",
    "core/face",
    "core/mesh",
    "core/tracking",
    "core/heads",
    "core/rigs",
    "core/takes",
    "core/deform",
    "core/drive",
    "core/control_points",
    "core/bake",
    "core/puppet",
    "core/streams/protocols",
    "core/streams/transport",
    "core/streams",
    "core/viewer",
    "blender",
    "blender/heads",
    "blender/controls",
    "blender/animation",
    "cli",
    "settings",
    "sessions",
    "operators",
    "ui",
    "registration",
)
"""From the bottom up; a folder without the packages in it, or a module of the root. Layers import from those below."""
ROOMS = tuple(path.name for path in ROOT.iterdir() if path.is_dir() and f"{path.name}" in FLOORS)
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
LIBRARIES = {"numpy", "scipy", "threadpoolctl", "cv2", "websockets", "Cryptodome"}
BLENDERS = {"bpy", "bpy_extras", "bmesh", "mathutils", "gpu", "gpu_extras", "blf", "aud"}


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


def floor_of(module: Path) -> str:
    """The layer of a module, given by its path in the repository without suffix: the longest matching prefix."""
    names = [module.as_posix(), *(parent.as_posix() for parent in module.parents)]
    return next(name for name in names if name in FLOORS)


def known(path: Path) -> set[str]:
    """The layers from which a module imports."""
    inside = path.relative_to(ROOT)
    return {
        floor_of(Path(*inside.parent.parts[: len(inside.parent.parts) - level + 1], *module.split(".")))
        for level, module in imports(path)
        if level
    }


def ident(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_every_package_has_a_layer():
    folders = {path.parent.relative_to(ROOT).as_posix() for path in MODULES}
    assert folders == {floor for floor in FLOORS if (ROOT / floor).is_dir()}


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_modules_import_only_from_their_layer_and_those_below(path):
    own = FLOORS.index(floor_of(path.relative_to(ROOT).with_suffix("")))
    assert not [floor for floor in known(path) if FLOORS.index(floor) > own]


def test_there_are_no_circular_imports():
    edges = {path.relative_to(ROOT).with_suffix(""): _modules(path) for path in MODULES}
    while free := [module for module, below in edges.items() if not below & edges.keys()]:
        for module in free:
            del edges[module]
    assert not edges, {ident(ROOT / module): sorted(map(str, below & edges.keys())) for module, below in edges.items()}


def _modules(path: Path) -> set[Path]:
    """Return the modules that are imported together with a module, not later by one of its functions."""
    inside, found = path.relative_to(ROOT), set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            base = Path(*inside.parent.parts[: len(inside.parent.parts) - node.level + 1])
            module = base.joinpath(*node.module.split(".")) if node.module else base
            found |= {module, *(module / name.name for name in node.names)}
    return found


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_core_imports_only_a_few_libraries(path):
    room = path.relative_to(ROOT).parts[0]
    roots = {module.split(".")[0] for level, module in imports(path) if not level}
    assert "facemime" not in roots, "inside, imports are relative, so that they work in an extension too"
    if room == "core":
        assert roots <= LIBRARIES | set(sys.stdlib_module_names)


def test_the_command_and_all_of_core_can_be_imported_without_blender_and_scipy_is_loaded_later():
    core = [path for path in MODULES if path.is_relative_to(ROOT / "core")]
    modules = [".".join(["facemime", *path.relative_to(ROOT).with_suffix("").parts]) for path in core]
    names = [*(module.removesuffix(".__init__") for module in modules), "facemime.cli.main"]
    code = (
        "import sys, importlib\n"
        f"for name in {sorted(BLENDERS | {'scipy'})}: sys.modules[name] = None\n"
        f"for name in {names}: importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT.parent)

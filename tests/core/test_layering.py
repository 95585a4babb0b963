"""Who may know whom: the house has floors, and whoever imports looks down."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FLOORS = (
    "core",
    "core/mesh",
    "core/heads",
    "core/tracking",
    "core/takes",
    "core/deform",
    "core/drive",
    "core/control_points",
    "core/bake",
    "core/puppet",
    "core/live",
    "blender",
    "blender/media",
    "blender/heads",
    "blender/animation",
    "cli/terminal",
    "cli/puppet",
    "cli/batch",
    "cli",
    "settings",
    "sessions",
    "operators",
    "ui",
    "registration",
)
"""From the ground up; a folder without those in it, or a module of the root. A room knows itself and what is below."""
ROOMS = tuple(path.name for path in ROOT.iterdir() if path.is_dir() and f"{path.name}" in FLOORS)
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
LIBRARIES = {"numpy", "cv2"}
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
    """The floor of a module, a path within the repository without its suffix: the longest that it begins with."""
    names = [module.as_posix(), *(parent.as_posix() for parent in module.parents)]
    return next(name for name in names if name in FLOORS)


def known(path: Path) -> set[str]:
    """The floors that a module imports from."""
    inside = path.relative_to(ROOT)
    return {
        floor_of(Path(*inside.parent.parts[: len(inside.parent.parts) - level + 1], *module.split(".")))
        for level, module in imports(path)
        if level
    }


def ident(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_every_room_has_its_floor():
    folders = {path.parent.relative_to(ROOT).as_posix() for path in MODULES}
    assert folders == {floor for floor in FLOORS if (ROOT / floor).is_dir()}


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_a_module_imports_from_its_own_floor_and_those_below_alone(path):
    own = FLOORS.index(floor_of(path.relative_to(ROOT).with_suffix("")))
    assert not [floor for floor in known(path) if FLOORS.index(floor) > own]


def test_no_module_imports_itself_in_a_circle():
    edges = {path.relative_to(ROOT).with_suffix(""): _modules(path) for path in MODULES}
    while free := [module for module, below in edges.items() if not below & edges.keys()]:
        for module in free:
            del edges[module]
    assert not edges, {ident(ROOT / module): sorted(map(str, below & edges.keys())) for module, below in edges.items()}


def _modules(path: Path) -> set[Path]:
    """The modules that are imported with a module, not in one of its functions later."""
    inside, found = path.relative_to(ROOT), set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            base = Path(*inside.parent.parts[: len(inside.parent.parts) - node.level + 1])
            module = base.joinpath(*node.module.split(".")) if node.module else base
            found |= {module, *(module / name.name for name in node.names)}
    return found


@pytest.mark.parametrize("path", MODULES, ids=ident)
def test_core_knows_numpy_and_opencv_and_blenders_modules_only_who_needs_them(path):
    room = path.relative_to(ROOT).parts[0]
    roots = {module.split(".")[0] for level, module in imports(path) if not level}
    assert "facemime" not in roots, "inside, imports are relative, so that they work in an extension too"
    assert "scipy" not in roots
    if room == "core":
        assert roots <= LIBRARIES | set(sys.stdlib_module_names)


def test_the_command_and_all_of_core_can_be_imported_without_blender():
    core = [path for path in MODULES if path.is_relative_to(ROOT / "core")]
    modules = [".".join(["facemime", *path.relative_to(ROOT).with_suffix("").parts]) for path in core]
    names = [*(module.removesuffix(".__init__") for module in modules), "facemime.cli.main"]
    code = (
        "import sys, importlib\n"
        f"for name in {sorted(BLENDERS | {'scipy'})}: sys.modules[name] = None\n"
        f"for name in {names}: importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT.parent)

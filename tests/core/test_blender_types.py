"""The plugin that tells the type checker what Blender does at run time."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WRONG = (
    "scene.facemime.nothing",
    "scene.facemime.performer + ''",
    "scene.facemime.kernel + 1",
    "scene.facemime.source.loop.real.x",
    "scene.facemime.posing.object.name",
    "scene.facemime_takes.items[0].name + 1",
    "scene.facemime_takes.bake.start = 'nowhere'",
    "scene.objects.get('Head').name",
    "scene.objects['Head'].animation_data.action",
    "bpy.context.object.name",
)
RIGHT = (
    "scene.facemime.performer + 1",
    "scene.facemime_takes.bake.start = 'current'",
    "bpy.context.scene.facemime.posing.rotation_strength + 1.0",
    "'facemime' in scene",
    "scene.facemime_takes.items[0].name + ''",
)


@pytest.mark.thorough
def test_wrong_uses_of_properties_of_blender_are_found_and_right_ones_are_not(tmp_path: Path) -> None:
    (tmp_path / "facemime").symlink_to(ROOT)
    before = ("import bpy", "import facemime.settings.properties, facemime.settings.takes_properties")
    lines = [*before, "def use(scene: bpy.types.Scene) -> None:", *(f"    {line}" for line in (*RIGHT, *WRONG))]
    (tmp_path / "use.py").write_text("\n".join(lines) + "\n")
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", ROOT / "pyproject.toml", tmp_path / "use.py"],
        check=False,
        cwd=ROOT,
        env={**os.environ, "MYPYPATH": str(tmp_path), "MYPY_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
    )
    found = {int(line.split(":")[1]) for line in checked.stdout.splitlines() if "use.py:" in line}
    first = len(lines) - len(WRONG) + 1
    assert found == set(range(first, len(lines) + 1)), checked.stdout + checked.stderr

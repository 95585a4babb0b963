"""Damaged files of characters are bound, or refused in a line: no traceback, no death without a word."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from random import Random

import pytest

from tests.fuzz.mutators import mutated_bytes
from tests.helpers.commands import START

bpy = pytest.importorskip("bpy")
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and time are limited on Linux only"),
]
COUNT = int(os.environ.get("FACEMIME_FUZZ_CHARACTERS", "30"))
KINDS = ("glb", "vrm", "abc", "fbx", "usdc", "ply", "stl", "obj", "blend")
WRITER = """
import sys, bpy
from facemime.blender.heads.new_heads import add_head
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
head = add_head(bpy.context, units=True)
for child in list(head.children):
    bpy.data.objects.remove(child)
jaw = head.data.shape_keys.key_blocks["jawOpen"]
for frame, value in ((1, 0.0), (12, 1.0)):
    jaw.value = value
    jaw.keyframe_insert("value", frame=frame)
bpy.context.scene.frame_end = 12
bpy.ops.object.select_all(action="SELECT")
{
    "glb": lambda path: bpy.ops.export_scene.gltf(filepath=path),
    "abc": lambda path: bpy.ops.wm.alembic_export(filepath=path, as_background_job=False),
    "fbx": lambda path: bpy.ops.export_scene.fbx(filepath=path),
    "usdc": lambda path: bpy.ops.wm.usd_export(filepath=path, export_animation=True),
    "ply": lambda path: bpy.ops.wm.ply_export(filepath=path),
    "stl": lambda path: bpy.ops.wm.stl_export(filepath=path),
    "obj": lambda path: bpy.ops.wm.obj_export(filepath=path),
    "blend": lambda path: bpy.ops.wm.save_as_mainfile(filepath=path, compress=False),
}[sys.argv[1].rpartition(".")[2]](sys.argv[1])
import os
os._exit(0)
"""


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_of_characters_are_bound_or_refused_in_a_line(kind, tmp_path, capsys):
    whole = tmp_path / f"whole.{'glb' if kind == 'vrm' else kind}"
    subprocess.run([sys.executable, "-c", WRITER, str(whole)], check=True, capture_output=True)
    outcomes: Counter[str] = Counter()
    for case in range(COUNT):
        rng = Random(f"{kind} {case}")
        path = tmp_path / f"case.{kind}"
        path.write_bytes(mutated_bytes(rng, whole.read_bytes()))
        outcomes[_outcome(rng.choice(("bind", "import")), path, tmp_path)] += 1
    with capsys.disabled():
        print(f"\n{kind}: {dict(outcomes)}")
    assert not outcomes.keys() - {"read", "refused"}


def _outcome(command: str, path: Path, folder: Path) -> str:
    output = folder / ("out.blend" if command == "bind" else "out.facetake")
    done = subprocess.run([*START, command, path, "-o", output], capture_output=True, text=True, check=False)
    told = [line for line in done.stderr.splitlines() if line.startswith("facemime: ")]
    if "Traceback" in done.stdout + done.stderr:
        return f"a traceback: {done.stderr[-500:]}"
    if done.returncode in (0, 3):
        return "read"
    refusals = [line for line in told if "This face is unusual" not in line]  # it comes before the refusal
    return (
        "refused" if (done.returncode, len(refusals)) == (1, 1) else f"status {done.returncode}: {done.stderr[-500:]}"
    )

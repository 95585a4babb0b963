"""Characters that others made, by mouse: from the importer's own selection in the default scene to an export.

They are in ../shared/data/characters, beside the repository; without them, a character of the tests' own is imported.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import HEAD, start, stop
from tests.helpers.gui.window import ROOT, Blender

pytestmark = pytest.mark.thorough
STRANGERS = ROOT.parent / "shared" / "data" / "characters"
_EXPORT = """
import bpy, sys
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.ops.object.select_all(action="SELECT")
bpy.context.view_layer.objects.active = next(o for o in bpy.context.selected_objects if o.type == "ARMATURE")
bpy.ops.export_scene.gltf(filepath=sys.argv[2], export_format="GLB")
"""
_WIDEST = "max((a for a in bpy.context.window.screen.areas if a.type == 'VIEW_3D'), key=lambda a: a.width)"
_BONES = f"{_WIDEST}.spaces.active.overlay.show_bones"
_COLOURS = f"{_WIDEST}.spaces.active.shading.color_type"
_VALUES = f"max(key.value for key in {HEAD}.data.shape_keys.key_blocks[1:])"


def import_character(blender: Blender, name: str) -> None:
    """Import a character with Blender's own importer, which leaves its own selection."""
    if name == "own":
        source = blender.folder / "character.blend"
        subprocess.run(
            [sys.executable, "-m", "tests.helpers.characters", source], cwd=ROOT, check=True, capture_output=True
        )
        command = [sys.executable, "-c", _EXPORT, source, blender.folder / "own.glb"]
        subprocess.run(command, check=True, capture_output=True)
    elif not (STRANGERS / f"{name}.glb").exists():
        pytest.skip(f"../shared/data/characters/{name}.glb is missing")
    else:
        shutil.copy(STRANGERS / f"{name}.glb", blender.folder)
    path = str(blender.inside / f"{name}.glb")
    blender.do(f"bpy.ops.import_scene.gltf(filepath={path!r})")
    blender.redraw()


def record_preview_bake_and_export(blender: Blender, sidebar: Sidebar, output: Path) -> None:
    """Record, then follow the box: preview, bake, export."""
    sidebar.press("bpy.ops.facemime.record_take(")
    blender.wait_for("getattr(Session.current.recorder.recording, 'frames', 0) > 20")
    blender.shot("recording")
    sidebar.press("bpy.ops.facemime.record_take(")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1 and Session.current.recorder.recording is None")
    blender.redraw()
    blender.shot("recorded")
    sidebar.find("bpy.ops.facemime.trim_take(")
    stop(sidebar)
    sidebar.press("bpy.ops.facemime.show_take(")
    blender.wait_for("Session.current is not None")
    blender.do("bpy.context.scene.frame_set(15)")
    blender.redraw()
    blender.shot("previewed")
    sidebar.press("bpy.ops.facemime.show_take(")
    blender.wait_for("Session.current is None")
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    sidebar.press("bpy.ops.facemime.bake_take(")
    blender.wait_for(f"{HEAD}.data.shape_keys is not None and {HEAD}.data.shape_keys.animation_data is not None")
    blender.do("bpy.context.scene.frame_set(15)")
    blender.shot("baked")
    inside = str(blender.inside / output.name)
    blender.do(f"bpy.ops.facemime.export_gltf(filepath={inside!r})")
    assert output.stat().st_size > 10_000


@pytest.mark.parametrize("name", ["own", "rigged"])
def test_an_imported_character_without_known_keys_is_bound_by_its_face_and_driven(blender, sidebar, name):
    import_character(blender, name)
    assert blender.get("bpy.context.active_object.type") == "ARMATURE"
    blender.shot(f"{name}-imported")
    sidebar.press("bpy.ops.facemime.bind_landmarks(")
    blender.wait_for(f"{HEAD} is not None and {HEAD}.type == 'MESH' and 'facemime_landmarks' in {HEAD}.data")
    blender.wait_for("bpy.ops.facemime.accept_points.poll()")
    assert not blender.get(_BONES), "the bones do not hide the face that is to be checked"
    blender.shot(f"{name}-checked")
    sidebar.press("bpy.ops.facemime.accept_points(")
    blender.wait_for(_BONES)
    start_moving(sidebar)
    assert not blender.get(_BONES)
    blender.shot(f"{name}-driven")
    record_preview_bake_and_export(blender, sidebar, blender.folder / f"{name}-out.glb")
    assert blender.get(_BONES)


@pytest.mark.parametrize("name", ["rigged", "vroid"])
def test_an_imported_character_with_known_keys_is_driven_by_their_values(blender, sidebar, name):
    import_character(blender, name)
    blender.shot(f"{name}-imported")
    before = blender.get(_COLOURS)
    sidebar.press("bpy.ops.facemime.bind_keys(")
    blender.wait_for(f"{HEAD} is not None and {HEAD}.type == 'MESH' and 'facemime_keys' in {HEAD}.data")
    blender.redraw()
    blender.shot(f"{name}-keys")
    sidebar.press("bpy.ops.facemime.puppet(")
    blender.wait_for(f"Session.current is not None and {_VALUES} > 0.1")
    assert blender.get(_COLOURS) == "TEXTURE" and not blender.get(_BONES)
    blender.shot(f"{name}-driven-by-keys")
    record_preview_bake_and_export(blender, sidebar, blender.folder / f"{name}-out.glb")
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    assert blender.get(_COLOURS) == before


def test_discarding_a_face_that_was_found_takes_the_binding_back(blender, sidebar):
    import_character(blender, "own")
    sidebar.press("bpy.ops.facemime.bind_landmarks(")
    blender.wait_for("bpy.ops.facemime.discard_points.poll()")
    sidebar.press("bpy.ops.facemime.discard_points(")
    blender.wait_for("not any('facemime_landmarks' in mesh for mesh in bpy.data.meshes)")
    blender.redraw()
    assert blender.get("bpy.context.active_object.type") == "ARMATURE"
    assert blender.get(f"{_WIDEST}.spaces.active.local_view is None")
    blender.shot("taken-back")


def start_moving(sidebar: Sidebar) -> None:
    """Start the puppet and wait until the head moves, by its skin or by the values of its keys."""
    if sidebar.blender.get(f"{HEAD}.data.shape_keys is None"):
        start(sidebar)
        return
    sidebar.press("bpy.ops.facemime.puppet(")
    moving = f"moved({HEAD}) > 1e-3 or {_VALUES} > 0.1"
    sidebar.blender.wait_for(f"Session.current is not None and ({moving})")

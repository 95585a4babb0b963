"""A head exported as glTF: one clip that plays what Blender shows, with the names and order of its keys."""

import json
import struct
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.animation.exporting import export_gltf
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError, OutputError
from facemime.core.mesh.surface import NearestPoints
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from tests.helpers.characters import make_character
from tests.helpers.commands import run
from tests.helpers.takes import performance

FRAMES = (1, 20, 40)


def baked(head: bpy.types.Object, **options) -> bpy.types.Object:
    bpy.context.scene.render.fps = 25
    puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(**options), translation=True))
    return head


def content(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def shown(frames=FRAMES) -> list[np.ndarray]:
    """Vertices (V, 3) of all meshes of the scene in world space, at some frames."""
    out = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        meshes = []
        for obj in bpy.context.scene.objects:
            if obj.type == "MESH":
                seen = obj.evaluated_get(graph)
                flat = np.empty(3 * len(seen.data.vertices), np.float32)
                seen.data.vertices.foreach_get("co", flat)
                world = np.array(seen.matrix_world)
                meshes.append(flat.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
        out.append(np.concatenate(meshes))
    return out


def reopened(path: Path) -> list[np.ndarray]:
    """The same for a file that is imported into an empty scene, in which it begins at frame 0."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 25
    bpy.ops.import_scene.gltf(filepath=str(path))
    for key in (key for keys in bpy.data.shape_keys for key in keys.key_blocks):
        key.slider_min, key.slider_max = -10.0, 10.0  # to which Blender clamps; glTF has no limits
    return shown([frame - 1 for frame in FRAMES])


def largest_distance(wanted: list[np.ndarray], got: list[np.ndarray]) -> float:
    """Distance of expected vertices from the nearest exported one; these are split at texture seams."""
    pairs = zip(wanted, got, strict=True)
    return max(float(np.linalg.norm(b[NearestPoints(b).query(a)[0].ravel()] - a, axis=1).max()) for a, b in pairs)


@pytest.mark.parametrize("keys", ["new", "named"])
def test_the_clip_shows_what_blender_shows(tmp_path, keys):
    head = baked(add_head(bpy.context, units=keys == "named"), keys=keys)
    names = [block.name for block in head.data.shape_keys.key_blocks][1:]
    wanted, path = shown(), tmp_path / "head.glb"
    export_gltf([head], path)
    stated = content(path)
    (mesh,) = [mesh for mesh in stated["meshes"] if mesh["name"] == head.data.name]
    assert mesh["extras"]["targetNames"] == names and len(stated["animations"]) == 1
    assert "cameras" not in stated
    assert np.abs(wanted[0] - wanted[2]).max() > 1e-3
    assert largest_distance(wanted, reopened(path)) < 2e-5


def test_a_character_is_exported_with_bones_and_parts_and_the_selection_is_kept(tmp_path):
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    bpy.ops.object.camera_add()
    camera = bpy.context.object
    baked(head)
    wanted, path = shown(), tmp_path / "character.glb"
    export_gltf([head], path)
    assert bpy.context.view_layer.objects.active == camera and bpy.context.selected_objects == [camera]
    stated = content(path)
    assert len(stated["skins"]) == 1 and len(stated["animations"]) == 1
    assert largest_distance(wanted, reopened(path)) < 1e-4


def test_a_cache_is_refused_and_a_file_that_cannot_be_replaced_is_kept(tmp_path):
    head, path = baked(add_head(bpy.context), keys="cache", path=tmp_path / "a.pc2"), tmp_path / "head.glb"
    path.write_bytes(b"before")
    with pytest.raises(HeadError, match="in a cache"):
        export_gltf([head], path)
    assert path.read_bytes() == b"before"
    with pytest.raises(OutputError):
        export_gltf([add_head(bpy.context)], tmp_path / "head.glb" / "inside.glb")


def test_the_operator_writes_the_selected_head(tmp_path):
    baked(add_head(bpy.context))
    assert bpy.ops.facemime.export_gltf("EXEC_DEFAULT", filepath=str(tmp_path / "head")) == {"FINISHED"}
    assert content(tmp_path / "head.glb")["meshes"]


@pytest.mark.thorough
def test_the_command_writes_it_beside_the_blend_file(tmp_path):
    save_take(performance(), tmp_path / "a.facetake")
    out, path = tmp_path / "out.blend", tmp_path / "out.glb"
    done = run("puppet", tmp_path / "a.facetake", "-o", out, "--gltf", path, "--keys", "named")
    assert done.returncode == 0, done.stderr
    assert len(content(path)["animations"]) == 1 and out.exists()
    done = run("puppet", tmp_path / "a.facetake", "-o", out, "--gltf", tmp_path / "out.txt")
    assert done.returncode == 1 and ".glb" in done.stderr

"""A head exported as glTF: one clip that plays what Blender shows, with the names and order of its keys."""

import json
import struct
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.animation import exporting
from facemime.blender.animation.exporting import export_gltf
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.gltf_seconds import inverted_base
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rendering import set_rate
from facemime.blender.timeline import rate_of
from facemime.cli import character_files
from facemime.cli.character_files import open_file
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError, OutputError
from facemime.core.heads.character_files import duration_of_gltf
from facemime.core.mesh.surface import NearestPoints
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from tests.helpers.characters import make_character
from tests.helpers.commands import run
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

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


def reopened(path: Path, *, cut_off: bool = False) -> list[np.ndarray]:
    """The same for a file that is imported into an empty scene, in which it begins at frame 0.

    Blender gives imported keys values of 0 to 1, and other values are `cut_off`; glTF has no limits.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 25
    bpy.ops.import_scene.gltf(filepath=str(path))
    for key in (key for keys in bpy.data.shape_keys for key in keys.key_blocks if not cut_off):
        key.slider_min, key.slider_max = -10.0, 10.0
    return shown([frame - 1 for frame in FRAMES])


def largest_distance(wanted: list[np.ndarray], got: list[np.ndarray]) -> float:
    """Distance of expected vertices from the nearest exported one; these are split at texture seams."""
    pairs = zip(wanted, got, strict=True)
    return max(float(np.linalg.norm(b[NearestPoints(b).query(a)[0].ravel()] - a, axis=1).max()) for a, b in pairs)


def blinking_box() -> bpy.types.Object:
    """A box whose key has a single peak in frame 51 of 101."""
    bpy.ops.mesh.primitive_cube_add()
    box, scene = bpy.context.object, bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 101
    box.shape_key_add(name="Basis")
    key = box.shape_key_add(name="Blink", from_mix=False)
    key.points[0].co.x = 2.0
    for frame, value in ((1, 0.0), (50, 0.0), (51, 1.0), (52, 0.0), (101, 0.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    return box


@pytest.mark.parametrize("keys", first_of(["new", "named"]))
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


def test_positive_values_show_the_same_where_negative_ones_are_cut_off(tmp_path):
    distances = []
    for positive in (True, False):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        head = baked(add_head(bpy.context, units=False), keys="new", positive=positive)
        wanted, path = shown(), tmp_path / "head.glb"
        assert all(key.slider_min == (0.0 if positive else -1.0) for key in head.data.shape_keys.key_blocks[1:])
        export_gltf([head], path)
        distances.append(largest_distance(wanted, reopened(path, cut_off=True)))
    assert distances[0] < 2e-5 and distances[1] > 1e-3


@pytest.mark.parametrize("add_on", ["installed", "dividing"])
@pytest.mark.parametrize("rate", first_of([24 / 1.001, 30 / 1.001, 60 / 1.001, 25.0, 29.325], 2))
def test_a_clip_lasts_as_long_as_in_blender_whatever_the_rate(rate, add_on, tmp_path, monkeypatch):
    scene, box = bpy.context.scene, blinking_box()
    set_rate(scene, rate)
    if add_on == "dividing":  # as a later version may

        def divided(work):
            def done(path):
                with inverted_base(bpy.context.scene):
                    work(path)

            return done

        monkeypatch.setattr(exporting, "_write_gltf", divided(exporting._write_gltf))
        importers = character_files._IMPORTERS
        monkeypatch.setattr(character_files, "_IMPORTERS", importers | {".glb": divided(importers[".glb"])})
    base, path = scene.render.fps_base, tmp_path / "box.glb"
    export_gltf([box], path)
    assert scene.render.fps_base == base
    assert duration_of_gltf(path) == pytest.approx(100 / rate, rel=1e-5)
    open_file(path)
    (curve,) = curves_of(bpy.data.shape_keys[0])
    (peak,) = [point.co[0] for point in curve.keyframe_points if point.co[1] > 0.9]
    assert peak / rate_of(bpy.context.scene) == pytest.approx(50 / rate, rel=1e-5)


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

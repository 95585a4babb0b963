"""Files for other programs hold everything of a head, whatever hides it in Blender, and its keys as they look."""

import json
import struct
from contextlib import nullcontext

import bpy
import numpy as np
import pytest

from facemime.blender.animation import exporting
from facemime.blender.animation.exporting import export_gltf, keys_as_shown, selected_for_export
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import OutputError
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.characters import make_character
from tests.helpers.hiding import HIDING
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def bake(head, keys="new", path=None):
    puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys=keys, path=path)))


def state(objects):
    """What hides and selects objects, after an update."""
    bpy.context.view_layer.update()
    layer = bpy.context.view_layer
    flags = [(obj.hide_viewport, obj.hide_select, obj.name in layer.objects and obj.hide_get()) for obj in objects]
    places = [layer.layer_collection]
    for place in places:
        places += place.children
        flags.append((place.exclude, place.hide_viewport, place.collection.hide_viewport, place.collection.hide_select))
    return flags, [obj.name for obj in layer.objects if obj.select_get()], layer.objects.active


def content(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def hide_by_keyframes(obj):
    obj.hide_viewport = True
    obj.keyframe_insert("hide_viewport", frame=1)


def hide_by_drivers(obj):
    obj.driver_add("hide_viewport").driver.expression = "1"


@pytest.mark.parametrize("hide", first_of([hide_by_keyframes, hide_by_drivers]))
def test_files_hold_what_animation_and_drivers_hide(hide, tmp_path):
    head, scene = add_head(bpy.context), bpy.context.scene
    bake(head)
    hide(head)
    scene.frame_set(1)
    export_gltf([head], tmp_path / "a.glb")
    assert head.name in {node["name"] for node in content(tmp_path / "a.glb")["nodes"] if "mesh" in node}
    bake(head, "alembic", tmp_path / "a.abc")
    scene.frame_set(1)
    assert head.hide_viewport
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.alembic_import(filepath=str(tmp_path / "a.abc"), as_background_job=False)
    assert len(bpy.data.objects["Facemime_Head"].data.vertices)


def test_a_head_in_several_scenes_is_exported_once_with_the_clip_of_its_scene(tmp_path):
    head = add_head(bpy.context)
    bake(head)
    for name in ("A", "Z"):
        bpy.data.scenes.new(name).collection.objects.link(head)
        head.select_set(True, view_layer=bpy.data.scenes[name].view_layers[0])
    export_gltf([head], tmp_path / "a.glb")
    stated = content(tmp_path / "a.glb")
    assert [node["name"] for node in stated["nodes"]].count(head.name) == 1
    assert [clip["name"] for clip in stated["animations"]] == [bpy.context.scene.name]


@pytest.mark.thorough
@pytest.mark.parametrize("hide", HIDING)
def test_gltf_holds_every_mesh_of_a_character_and_its_armature_however_they_are_hidden(hide, tmp_path):
    head, _ = bind_character(make_character(rig=True)["head"])
    bake(head)
    objects = [obj for obj in bpy.context.scene.objects if obj != head]
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    bpy.context.scene.collection.objects.link(cube)
    bpy.context.view_layer.objects.active = cube
    cube.select_set(True)
    HIDING[hide]([head, *objects])
    before = state([head, *objects])
    export_gltf([head], tmp_path / "a.glb")
    assert state([head, *objects]) == before
    stated = content(tmp_path / "a.glb")
    names = {node["name"] for node in stated["nodes"] if "mesh" in node}
    assert names == {obj.name for obj in [head, *objects] if obj.type == "MESH"} and len(stated["skins"]) >= 1


@pytest.mark.thorough
@pytest.mark.parametrize("hide", HIDING)
def test_alembic_holds_the_moving_head_however_it_is_hidden(hide, tmp_path):
    head = add_head(bpy.context)
    HIDING[hide]([head, *head.children])
    bpy.context.view_layer.update()
    bake(head, "alembic", tmp_path / "a.pc2")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.alembic_import(filepath=str(tmp_path / "a.abc"), as_background_job=False)
    found = {obj.name: obj for obj in bpy.data.objects if obj.type == "MESH"}
    assert len(found) == 8
    shapes = []
    for frame in (1, 40):
        bpy.context.scene.frame_set(frame)
        mesh = found["Facemime_Head"].evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        shapes.append(np.array([vertex.co for vertex in mesh.vertices]))
    assert np.abs(shapes[1] - shapes[0]).max() > 1e-3


def test_an_object_that_cannot_be_selected_is_named(monkeypatch):
    head = add_head(bpy.context)
    monkeypatch.setattr(exporting, "revealed", lambda *_: nullcontext())
    head.hide_select = True
    with pytest.raises(OutputError, match=head.name), selected_for_export([head]):
        pytest.fail("it was exported")


def test_keys_are_exported_as_they_look():
    head = add_head(bpy.context, units=True)
    keys = head.data.shape_keys.key_blocks
    group = head.vertex_groups.new(name="Left")
    group.add([vertex.index for vertex in head.data.vertices if vertex.co.x > 0.0], 0.5, "REPLACE")
    keys["jawOpen"].vertex_group = "Left"
    keys["mouthFunnel"].relative_key = keys["jawOpen"]
    keys["mouthSmileLeft"].mute = True
    keys["mouthSmileLeft"].value = 0.7
    keys["mouthSmileLeft"].keyframe_insert("value", frame=1)
    rest = np.array([point.co for point in keys[0].data])

    def looks():
        found = {}
        for name in ("jawOpen", "mouthFunnel", "mouthSmileLeft"):
            for key in keys:
                key.value = float(key.name == name)
            bpy.context.view_layer.update()
            mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
            found[name] = np.array([vertex.co for vertex in mesh.vertices])
            keys[name].value = 0.0
        return found

    wanted = looks()
    points = [[tuple(point.co) for point in key.data] for key in keys]
    with keys_as_shown([head]):
        for name in ("jawOpen", "mouthFunnel"):
            shown = np.array([point.co for point in keys[name].data])
            np.testing.assert_allclose(shown, wanted[name], atol=1e-6)
            assert keys[name].relative_key == keys[0] and not keys[name].vertex_group
        bpy.context.scene.frame_set(1)
        assert not keys["mouthSmileLeft"].mute and keys["mouthSmileLeft"].value == 0.0
    np.testing.assert_allclose(wanted["mouthSmileLeft"], rest, atol=1e-6)
    assert [[tuple(point.co) for point in key.data] for key in keys] == points
    assert keys["mouthSmileLeft"].mute and keys["jawOpen"].vertex_group == "Left"
    assert keys["mouthFunnel"].relative_key == keys["jawOpen"]

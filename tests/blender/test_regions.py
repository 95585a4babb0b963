"""Painting, mirroring, smoothing, checking and displaying regions."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.painting import paint_region
from facemime.blender.meshes import read_landmarks, read_regions, write_landmarks, write_regions
from facemime.blender.names import REGION_GROUPS
from facemime.blender.view_layers import select_alone
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import from_ibug
from facemime.ui import overlays
from facemime.ui.overlays import coloured_triangles, shown_regions

BROW_RIGHT, BROW_LEFT = from_ibug((19, 24))


@pytest.mark.parametrize(("region", "name"), [*zip(("UPPER", "MIDDLE", "LOWER"), REGION_GROUPS, strict=True)])
def test_a_paint_button_starts_weight_painting_its_group_with_a_brush(region, name):
    head = add_head(bpy.context)
    assert bpy.ops.facemime.paint_region(region=region) == {"FINISHED"}
    assert bpy.context.mode == "PAINT_WEIGHT" and head.vertex_groups.active.name == name
    assert bpy.context.tool_settings.weight_paint.brush is not None
    assert bpy.ops.facemime.paint_region(region="UPPER") == {"FINISHED"}
    assert head.vertex_groups.active.name == REGION_GROUPS[0]
    assert bpy.ops.facemime.leave_painting() == {"FINISHED"} and bpy.context.mode == "OBJECT"


def test_painting_creates_a_missing_group():
    head = add_head(bpy.context)
    head.vertex_groups.remove(head.vertex_groups[REGION_GROUPS[1]])
    assert bpy.ops.facemime.paint_region(region="MIDDLE") == {"FINISHED"}
    assert head.vertex_groups.active.name == REGION_GROUPS[1]


def test_painting_begins_from_the_armature_of_the_character_even_in_pose_mode():
    head = add_head(bpy.context)
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    head.parent = rig
    head.modifiers.new("Armature", "ARMATURE").object = rig
    select_alone(bpy.context, rig)
    bpy.ops.object.mode_set(mode="POSE")
    assert bpy.ops.facemime.paint_region(region="LOWER") == {"FINISHED"}
    assert bpy.context.mode == "PAINT_WEIGHT" and bpy.context.object == head


def test_mirroring_regions_can_be_undone():
    head = add_head(bpy.context)
    landmarks = read_landmarks(head)
    right, left = int(landmarks[BROW_RIGHT]), int(landmarks[BROW_LEFT])
    head.vertex_groups[REGION_GROUPS[2]].add([right], 0.25, "REPLACE")
    name = head.name
    bpy.ops.ed.undo_push(message="painted")
    assert bpy.ops.facemime.mirror_regions(source="right") == {"FINISHED"}
    bpy.ops.ed.undo_push(message="mirrored")
    assert read_regions(bpy.data.objects[name])[2, left] == pytest.approx(0.25)
    bpy.ops.ed.undo()
    assert read_regions(bpy.data.objects[name])[2, left] == 0.0


def test_smoothing_softens_the_borders():
    head = add_head(bpy.context)
    before = read_regions(head)
    assert bpy.ops.facemime.smooth_regions(repeat=4) == {"FINISHED"}
    after = read_regions(head)
    steps = np.array([edge.vertices for edge in head.data.edges])
    jump = [np.abs(weights[:, steps[:, 0]] - weights[:, steps[:, 1]]).max() for weights in (before, after)]
    assert jump[1] < jump[0]


def test_region_buttons_are_enabled_only_on_a_head_outside_edit_mode():
    bpy.ops.mesh.primitive_cube_add()
    assert not bpy.ops.facemime.paint_region.poll() and not bpy.ops.facemime.leave_painting.poll()
    add_head(bpy.context)
    assert bpy.ops.facemime.mirror_regions.poll() and bpy.ops.facemime.smooth_regions.poll()
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.facemime.mirror_regions.poll()


def test_findings_are_shown_until_the_next_check():
    head = add_head(bpy.context)
    memory = bpy.context.window_manager.facemime
    for name in REGION_GROUPS:
        head.vertex_groups[name].remove([int(read_landmarks(head)[30])])
    bpy.ops.facemime.check_head()
    assert memory.checked == head.name
    assert [line.problem for line in memory.findings] == ["Landmarks 30 lie in no region."]
    bpy.ops.facemime.propose_regions()
    bpy.ops.facemime.check_head()
    assert memory.checked == head.name and len(memory.findings) == 0


def test_the_coloured_triangles_are_those_of_the_regions_with_or_without_modifiers():
    head = add_head(bpy.context)
    triangles, colours = coloured_triangles(head, 0.5)
    inside = read_regions(head).any(axis=0)
    assert set(triangles.reshape(-1)) >= set(np.flatnonzero(inside)) and len(colours) == len(head.data.vertices)
    assert len(triangles) < len(head.data.loop_triangles)
    head.modifiers.new("Subdivision", "SUBSURF").levels = 1
    finer = head.evaluated_get(bpy.context.evaluated_depsgraph_get())
    many, colours = coloured_triangles(finer, 0.5)
    assert len(many) > 3 * len(triangles) and many.max() < len(colours) == len(finer.data.vertices)


def test_the_overlay_is_hidden_when_disabled_while_painting_and_without_a_head():
    add_head(bpy.context)
    steps = bpy.context.scene.facemime_steps
    assert shown_regions(bpy.context) is None
    steps.show_regions = True
    assert shown_regions(bpy.context) == bpy.context.active_object
    bpy.ops.facemime.paint_region(region="LOWER")
    assert shown_regions(bpy.context) is None
    bpy.ops.facemime.leave_painting()
    bpy.ops.mesh.primitive_cube_add()
    assert shown_regions(bpy.context) is None


def test_weights_are_read_again_only_after_the_mesh_has_changed():
    head = add_head(bpy.context)
    bpy.context.scene.facemime_steps.show_regions = True
    bpy.context.view_layer.update()
    overlays._Cache.stale = False
    head.location.x += 1.0
    bpy.context.view_layer.update()
    assert not overlays._Cache.stale
    bpy.ops.facemime.smooth_regions()
    bpy.context.view_layer.update()
    assert overlays._Cache.stale
    overlays._on_update(bpy.context.scene, SimpleNamespace(updates=[]))
    assert overlays._Cache.stale


def test_painting_a_hidden_head_is_reported():
    head = add_head(bpy.context)
    head.hide_viewport = True
    with pytest.raises(RuntimeError, match="is hidden"):
        bpy.ops.facemime.paint_region(region="UPPER")


def test_a_linked_mesh_is_never_written_to(tmp_path):
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, data):
        data.meshes = ["Facemime Head"]
    head = bpy.data.objects.new("Linked", data.meshes[0])
    for write in (
        lambda: write_landmarks(head.data, read_landmarks(head)),
        lambda: write_regions(head, read_regions(head)),
        lambda: paint_region(bpy.context, head, 0),
    ):
        with pytest.raises(HeadError, match="linked from another file"):
            write()


def test_a_mesh_without_vertices_is_reported():
    obj = bpy.data.objects.new("Empty", bpy.data.meshes.new("Empty"))
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    with pytest.raises(RuntimeError, match="no vertices"):
        bpy.ops.facemime.bind_landmarks()

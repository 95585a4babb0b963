"""A take baked to a head equals the take driven live."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.bake_keys import BAKED_KEY_PREFIX
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import PoseTarget
from facemime.blender.frames import from_blender, rotation_to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import write_vertices
from facemime.blender.names import LANDMARKS_PROPERTY, PART_PROPERTY, REGION_GROUPS
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import OUTER_EYE_CORNERS
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance


def evaluated_vertices(obj: bpy.types.Object) -> np.ndarray:
    """Return (V, 3) vertices with shape keys in the head frame, without the object's transform."""
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return from_blender(flat.reshape(-1, 3))


def go_to(frame: float) -> None:
    """Set the frame of the scene, which may be fractional."""
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1.0))


@pytest.mark.parametrize("scene_fps", [25, 24, 60])
def test_a_baked_head_plays_back_the_driven_vertices_and_pose(scene_fps):
    scene = bpy.context.scene
    scene.render.fps = scene_fps
    head = add_head(bpy.context)
    lashes = next(child for child in head.children if child[PART_PROPERTY] == "lashes")
    rig = read_rig(head)
    unit = np.linalg.norm(np.subtract(*rig.vertices[rig.landmarks[OUTER_EYE_CORNERS]]))
    report = puppet_head(scene, head, performance(), PuppetSettings(bake=BakeSettings(keys="new", whole_frames=False)))
    assert report.worst_error < 0.01
    for n in range(0, len(report.motion.times), 7):
        go_to(frames_of(scene, report.motion.times[n]))
        played = np.concatenate([evaluated_vertices(head), evaluated_vertices(lashes)])
        error = np.linalg.norm(played - rig.all_vertices - report.motion.vertices[n], axis=1).max()
        assert error <= (report.worst_error + 1e-4) * unit
        turned = np.array(head.matrix_world.to_3x3())
        np.testing.assert_allclose(turned, rotation_to_blender(report.motion.rotation[n]), atol=1e-3)


def test_a_placed_and_rotated_head_stays_in_place_and_rotates_about_its_own_axes():
    head = add_head(bpy.context)
    head.location, head.rotation_euler = (1.0, 2.0, 3.0), (0.0, 0.0, np.pi / 2)
    bpy.context.view_layer.update()
    placed = np.array(head.matrix_world)
    settings = PuppetSettings(bake=BakeSettings(whole_frames=False), translation=True)
    for _ in range(2):
        report = puppet_head(bpy.context.scene, head, performance(), settings)
    go_to(frames_of(bpy.context.scene, report.motion.times[-1]))
    world = np.array(head.matrix_world)
    np.testing.assert_allclose(
        placed[:3, :3].T @ world[:3, :3], rotation_to_blender(report.motion.rotation[-1]), atol=1e-3
    )
    go_to(1.0)
    np.testing.assert_allclose(np.array(head.matrix_world), placed, atol=1e-3)


def test_the_pose_goes_to_the_pose_object_and_nowhere_if_disabled():
    head, empty = add_head(bpy.context), bpy.data.objects.new("Pose", None)
    bpy.context.collection.objects.link(empty)
    puppet_head(bpy.context.scene, head, performance(), targets={"head": PoseTarget.of(empty)})
    assert head.animation_data is None and empty.animation_data.action is not None
    puppet_head(bpy.context.scene, head, performance())
    go_to(50)
    assert np.abs(head.delta_rotation_euler).max() > 0.01
    puppet_head(bpy.context.scene, head, performance(), PuppetSettings(rotation=False))
    go_to(50)
    assert tuple(head.delta_rotation_euler) == (0.0, 0.0, 0.0)


def test_lower_teeth_and_tongue_follow_the_jaw_and_eyes_follow_the_gaze():
    head = add_head(bpy.context)
    report = puppet_head(bpy.context.scene, head, performance())
    opening = np.array([np.trace(jaw) for jaw in report.motion.jaw])
    go_to(frames_of(bpy.context.scene, report.motion.times[opening.argmin()]))
    turned = {child[PART_PROPERTY]: np.abs(child.delta_rotation_euler).max() for child in head.children}
    assert turned["teeth_lower"] > 0.02 and turned["tongue"] > 0.02 and turned["teeth_upper"] == 0.0
    go_to(frames_of(bpy.context.scene, report.motion.times[np.argmax([r[0, 2] for r in report.motion.rotation])]))
    eyes = [child for child in head.children if child[PART_PROPERTY].startswith("eye")]
    assert len(eyes) == 2 and all(np.abs(eye.delta_rotation_euler).max() > 0.02 for eye in eyes)


def test_baking_again_replaces_facemimes_keys_and_keeps_the_users():
    head = add_head(bpy.context)
    head.shape_key_add(name="Basis")
    mine = head.shape_key_add(name="Mine")
    mine.value = 0.0
    mine.keyframe_insert("value", frame=1)
    head.keyframe_insert("location", frame=1)
    first = puppet_head(bpy.context.scene, head, performance())
    second = puppet_head(bpy.context.scene, head, performance(50))
    names = [key.name for key in head.data.shape_keys.key_blocks]
    assert names[:2] == ["Basis", "Mine"]
    assert len([name for name in names if name.startswith(BAKED_KEY_PREFIX)]) == second.keys
    assert first.keys > 0
    paths = {curve.data_path for curve in curves_of(head.data.shape_keys)}
    assert 'key_blocks["Mine"].value' in paths and len(paths) == 1 + second.keys
    assert "location" in {curve.data_path for curve in curves_of(head)}


def test_a_bulk_write_moves_the_mesh_and_updates_its_bounds():
    head = add_head(bpy.context)
    rig = read_rig(head)
    write_vertices(head.data, rig.vertices + np.float32(0.5))
    bpy.context.view_layer.update()
    np.testing.assert_allclose(read_rig(head).vertices, rig.vertices + 0.5, atol=1e-6)
    low = from_blender(np.array([tuple(corner) for corner in head.bound_box])).min(axis=0)
    np.testing.assert_allclose(low, (rig.vertices + 0.5).min(axis=0), atol=1e-5)


def test_the_error_names_what_a_mesh_lacks():
    head = add_head(bpy.context)
    head.vertex_groups.remove(head.vertex_groups[REGION_GROUPS[1]])
    with pytest.raises(HeadError, match=REGION_GROUPS[1]):
        read_rig(head)
    head.vertex_groups.new(name=REGION_GROUPS[1])
    with pytest.raises(HeadError, match="Empty"):
        read_rig(head)
    head.data[LANDMARKS_PROPERTY] = [10**6] * 66
    with pytest.raises(HeadError, match="no longer exist"):
        read_rig(head)
    del head.data[LANDMARKS_PROPERTY]
    with pytest.raises(HeadError, match="no landmarks"):
        read_rig(head)
    with pytest.raises(HeadError, match="not a mesh"):
        read_rig(bpy.data.objects.new("Empty", None))
    with pytest.raises(HeadError, match="no active object"):
        read_rig(None)

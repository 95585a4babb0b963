"""The built-in head in Blender: the mesh of the file, with everything that driving it needs."""

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from hypothesis import given
from hypothesis import strategies as st
from mathutils import Vector

from facemime.blender.frames import HEAD_TO_BLENDER, flat_in_blender, from_blender, rotation_to_blender, to_blender
from facemime.blender.heads.attached import heads_with_parts
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_vertices
from facemime.blender.names import LANDMARKS_PROPERTY, PART_OBJECTS, PART_PROPERTY, REGION_GROUPS
from facemime.blender.preview_scene import setup_preview
from facemime.blender.rendering import without_subdivision
from facemime.blender.rigs import read_rig
from facemime.blender.view_layers import is_seen_by_camera
from facemime.core.base.landmarks import from_ibug
from facemime.core.base.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head

ANGLES = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
POINTS = st.lists(st.tuples(*[st.floats(-10, 10)] * 3), min_size=1, max_size=5)


def test_the_added_head_is_the_mesh_of_the_file():
    head, obj = load_head(), add_head(bpy.context)
    assert len(obj.data.vertices) == 1781
    assert np.allclose(read_vertices(obj.data), head.vertices, atol=1e-6)
    faces = [[int(v) for v in face if v >= 0] for face in head.faces]
    assert [list(polygon.vertices) for polygon in obj.data.polygons] == faces
    assert all(polygon.use_smooth for polygon in obj.data.polygons)
    assert not obj.data.validate()


def test_the_added_head_is_selected_and_active_and_faces_the_front_view():
    obj = add_head(bpy.context)
    assert bpy.context.view_layer.objects.active == obj and obj.select_get()
    points = np.array([obj.data.vertices[i].co for i in obj.data[LANDMARKS_PROPERTY]])
    nose, chin, tragus = points[from_ibug([30, 8, 0])]
    assert nose[1] < tragus[1] and chin[2] < nose[2]


def test_the_added_head_has_landmarks_and_regions():
    head, obj = load_head(), add_head(bpy.context)
    assert list(obj.data[LANDMARKS_PROPERTY]) == head.landmarks.tolist()
    assert tuple(group.name for group in obj.vertex_groups) == REGION_GROUPS
    rig = read_rig(obj)
    assert np.allclose(rig.region_weights, head.regions, atol=1e-6)
    assert np.array_equal(rig.landmarks, head.landmarks)


def test_the_parts_are_children_that_rotate_about_their_pivots():
    head, obj = load_head(), add_head(bpy.context)
    children = {child[PART_PROPERTY]: child for child in obj.children}
    assert set(children) == set(PART_OBJECTS)
    bpy.context.view_layer.update()
    for part in head.parts:
        child = children[part.name]
        assert child.name == PART_OBJECTS[part.name]
        assert np.allclose(from_blender(np.array(child.matrix_world.translation)), part.pivot, atol=1e-6)
        assert np.allclose(read_vertices(child.data) + part.pivot, part.vertices, atol=1e-6)


def test_a_file_can_contain_two_heads():
    first, second = add_head(bpy.context), add_head(bpy.context, name="Other")
    assert first.data != second.data and second.name == "Other"
    assert len(second.children) == len(PART_OBJECTS)


def test_face_units_are_added_as_shape_keys_at_zero_only_on_request():
    assert add_head(bpy.context).data.shape_keys is None
    head, obj = load_head(), add_head(bpy.context, units=True)
    keys = obj.data.shape_keys.key_blocks
    assert [key.name for key in keys] == ["Basis", *head.unit_names] and len(keys) == 53
    assert all(key.value == 0 for key in keys[1:])
    flat = np.empty(3 * 1781, dtype=np.float32)
    keys["jawOpen"].points.foreach_get("co", flat)
    expected = head.vertices + head.units[head.unit_names.index("jawOpen")]
    assert np.allclose(from_blender(flat.reshape(-1, 3)), expected, atol=1e-6)


def test_every_material_shows_a_texture_in_workbench():
    obj = add_head(bpy.context)
    for mesh in [obj.data, *(child.data for child in obj.children)]:
        node = mesh.materials[0].node_tree.nodes.active
        assert node.type == "TEX_IMAGE" and node.image.size[0] > 0 and node.image.packed_file
        assert mesh.uv_layers.active is not None


@pytest.mark.parametrize("size", [(512, 512), (640, 360), (300, 600)])
def test_the_preview_camera_sees_the_whole_head_from_the_front(size):
    scene, obj = bpy.context.scene, add_head(bpy.context)
    setup_preview(scene, obj, size)
    bpy.context.view_layer.update()
    seen = [world_to_camera_view(scene, scene.camera, obj.matrix_world @ v.co) for v in obj.data.vertices]
    assert all(0 <= x <= 1 and 0 <= y <= 1 and z > 0 for x, y, z in seen)
    spread = np.ptp(np.array(seen)[:, :2], axis=0)
    assert 0.85 < spread.max() < 0.97
    assert scene.camera.matrix_world.translation.y < 0


def test_the_preview_frames_any_mesh_at_any_location():
    bpy.ops.mesh.primitive_cube_add(size=4, location=(10, -3, 7), rotation=(0.2, 0.1, 0.4))
    scene, obj = bpy.context.scene, bpy.context.object
    setup_preview(scene, obj)
    bpy.context.view_layer.update()
    for corner in obj.bound_box:
        x, y, _ = world_to_camera_view(scene, scene.camera, obj.matrix_world @ Vector(corner))
        assert 0 <= x <= 1 and 0 <= y <= 1


@given(POINTS)
def test_converting_axes_back_and_forth_changes_nothing(points):
    assert np.array_equal(from_blender(to_blender(points)), np.array(points))


@given(POINTS)
def test_the_fast_conversion_of_axes_gives_the_same_result(points):
    points = np.array(points, np.float32)
    np.testing.assert_array_equal(flat_in_blender(points), to_blender(points).reshape(-1))


@given(ANGLES, POINTS)
def test_converted_rotations_act_on_converted_points(angles, points):
    rotation, points = euler_to_matrix(*angles), np.array(points)
    turned = to_blender(points @ rotation.T)
    assert np.allclose(turned, to_blender(points) @ rotation_to_blender(rotation).T, atol=1e-9)
    assert np.allclose(HEAD_TO_BLENDER.T @ rotation_to_blender(rotation) @ HEAD_TO_BLENDER, rotation)
    assert np.isclose(np.linalg.det(rotation_to_blender(rotation)), 1)


def test_applying_the_scale_of_a_head_also_scales_its_eyeballs():
    head = add_head(bpy.context)
    before = read_rig(head).eyeballs
    head.scale = (3.0, 3.0, 3.0)
    bpy.ops.object.transform_apply(location=False, rotation=False)
    assert read_rig(head).eyeballs == pytest.approx(3.0 * before, rel=1e-4)


def test_the_skin_is_subdivided_in_renders_only():
    head = add_head(bpy.context)
    graph = bpy.context.evaluated_depsgraph_get()
    assert len(head.evaluated_get(graph).data.vertices) == 1781
    modifier = head.modifiers[0]
    assert modifier.type == "SUBSURF" and modifier.show_render and modifier.render_levels == 2


def test_materials_deepen_the_colours_of_the_skin_but_not_the_image_that_solid_shading_shows():
    tree = add_head(bpy.context).data.materials[0].node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    deeper = shader.inputs["Base Color"].links[0].from_node
    assert deeper.type == "HUE_SAT" and deeper.inputs["Color"].links[0].from_node == tree.nodes.active


def test_small_images_are_rendered_without_subdivision_which_is_kept_for_others():
    (modifier,) = [m for m in add_head(bpy.context).modifiers if m.type == "SUBSURF"]
    with without_subdivision(bpy.context.scene):
        assert not modifier.show_render
    assert modifier.show_render


@pytest.mark.parametrize("count", [1, 3])
def test_heads_are_added_where_the_camera_of_the_default_scene_sees_them(count):
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    for _ in range(count):
        assert bpy.ops.facemime.add_head() == {"FINISHED"}
    bpy.context.view_layer.update()
    for head in heads_with_parts():
        assert is_seen_by_camera(bpy.context, np.array(head.matrix_world.translation), 0.1)


def test_without_a_camera_a_head_is_added_to_the_right_of_what_is_there():
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.facemime.add_head() == {"FINISHED"}
    place = bpy.context.active_object.location
    assert place.x > 1.0 and tuple(place.yz) == (0.0, 0.0)

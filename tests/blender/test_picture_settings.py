"""Pictures of a head are the same whatever the user's scene renders with."""

import bpy
import cv2
import numpy as np
import pytest

from facemime.blender.characters import objects_of
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.blender.preview_scene import face_view, setup_preview
from facemime.blender.rendering import render_frames
from facemime.cli.character import draw_landmarks
from tests.helpers.characters import make_character
from tests.helpers.thorough import first_of

SIZE = (96, 96)


def _strip(scene, folder):
    cv2.imwrite(str(folder / "red.png"), np.full((64, 64, 3), (0, 0, 255), np.uint8))
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strips.new_image("red", str(folder / "red.png"), channel=1, frame_start=1).frame_final_duration = 200


def _marker(scene, _):
    camera = bpy.data.objects.new("Shot", bpy.data.cameras.new("Shot"))
    scene.collection.objects.link(camera)
    camera.location = (50.0, 0.0, 0.0)
    scene.timeline_markers.new("Shot", frame=1).camera = camera


def _region(scene, _):
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.5, 0.7


def _compositor(scene, _):
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = bpy.data.node_groups.new("Nothing", "CompositorNodeTree")
    else:
        scene.use_nodes = True
        scene.node_tree.nodes.clear()


def _colours(scene, _):
    scene.view_settings.exposure, scene.view_settings.gamma = 3.0, 2.0
    scene.view_settings.use_curve_mapping = True
    scene.view_settings.curve_mapping.white_level = (0.2, 0.2, 0.2)


def _look(scene, _):
    scene.view_settings.look = "AgX - High Contrast" if "AgX" in scene.view_settings.view_transform else "None"
    scene.render.image_settings.color_management = "OVERRIDE"
    scene.render.image_settings.view_settings.exposure = 5.0


def _stereo(scene, _):
    scene.render.use_multiview = True


def _output(scene, _):
    scene.render.resolution_percentage, scene.render.pixel_aspect_x, scene.frame_step = 20, 2.0, 7
    scene.render.use_stamp = scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "BW"


def _engine(scene, _):
    scene.render.engine = "CYCLES" if hasattr(scene, "cycles") else scene.render.engine
    scene.render.use_motion_blur = scene.render.use_simplify = scene.render.use_freestyle = True
    scene.render.frame_map_new = 300


def _workbench(scene, _):
    shading = scene.display.shading
    shading.show_xray, shading.show_backface_culling, shading.light, shading.use_dof = True, True, "FLAT", True
    shading.color_type, shading.single_color = "SINGLE", (1.0, 0.0, 0.0)


def _layers(scene, _):
    scene.view_layers[0].use = False
    scene.view_layers.new("Empty")
    scene.view_layers[0].material_override = bpy.data.materials.new("Override")


def _hidden(scene, _):
    collection = bpy.data.collections.new("Character")
    scene.collection.children.link(collection)
    for obj in list(scene.collection.objects):
        scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
        obj.hide_render = True
    collection.hide_render = True
    bpy.context.view_layer.update()


def _hidden_by_animation(scene, _):
    for obj in scene.objects:
        obj.hide_render = True
        obj.keyframe_insert("hide_render", frame=1)


def _excluded_on_a_moved_parent(scene, _):
    head, parent = scene.objects["Facemime Head"], bpy.data.objects.new("Hero", None)
    cast = bpy.data.collections.new("Cast")
    scene.collection.children.link(cast)
    cast.objects.link(parent)
    for obj in (head, *head.children):
        obj.users_collection[0].objects.unlink(obj)
        cast.objects.link(obj)
    bpy.context.view_layer.layer_collection.children["Cast"].exclude = True
    head.parent, parent.location, parent.delta_location = parent, (0.0, 0.0, 3.0), (0.0, 2.0, 1.5)


def _background(scene, _):
    other = bpy.data.scenes.new("Set")
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    cube.data.from_pydata([(x, -0.2, z) for x in (-9, 9) for z in (-9, 9)], [], [(0, 1, 3, 2)])
    other.collection.objects.link(cube)
    scene.background_set = other


SETTINGS = [
    *(_strip, _marker, _region, _compositor, _colours, _look, _stereo, _output, _engine, _workbench, _layers),
    *(_hidden, _hidden_by_animation, _excluded_on_a_moved_parent, _background),
]


def picture():
    """The second of two pictures, as a video comes before a contact sheet."""
    scene, head = bpy.context.scene, bpy.context.scene.objects["Facemime Head"]
    setup_preview(scene, head, SIZE, face_view(head))
    for _ in range(2):
        (image,) = render_frames(scene, [30.0], SIZE)
    return image.astype(float)


@pytest.fixture(scope="module")
def plain(_registered):
    """The picture of a head in a new file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    add_head(bpy.context)
    return picture()


@pytest.mark.parametrize("change", first_of(SETTINGS), ids=lambda change: change.__name__)
def test_the_picture_of_a_head_does_not_depend_on(change, plain, tmp_path):
    add_head(bpy.context)
    change(bpy.context.scene, tmp_path)
    scenes = list(bpy.data.scenes)
    assert np.abs(picture() - plain).mean() < 1.0
    assert list(bpy.data.scenes) == scenes


def test_a_mirrored_head_is_pictured_from_the_front(plain):
    add_head(bpy.context).scale.x = -1.0
    mirrored = picture()[:, ::-1]
    assert np.abs(mirrored - plain).mean() < 0.2 * np.abs(mirrored - plain.mean(axis=(0, 1))).mean()


def test_landmarks_are_drawn_on_the_face_whatever_the_pixels_aspect():
    head, scene = add_head(bpy.context), bpy.context.scene
    wanted = draw_landmarks(scene, head, 96)
    bpy.data.objects.remove(scene.camera)
    scene.render.pixel_aspect_y, scene.render.resolution_percentage = 1.8, 40
    np.testing.assert_allclose(draw_landmarks(scene, head, 96), wanted, atol=3)


@pytest.mark.thorough
@pytest.mark.parametrize("shown", [True, False])
def test_each_picture_shows_the_head_as_animation_moves_it_at_its_frame(shown):
    head, scene = add_head(bpy.context), bpy.context.scene
    head.shape_key_add(name="Basis")
    key = head.shape_key_add(name="Wide")
    for point in key.data:
        point.co.x *= 1.3
    turned = np.radians(60.0)
    for frame, value, angle in ((1, 0.0, 0.0), (11, 1.0, 0.0), (21, 0.0, turned)):
        key.value, head.delta_rotation_euler.z = value, angle
        key.keyframe_insert("value", frame=frame)
        head.keyframe_insert("delta_rotation_euler", index=2, frame=frame)
    scene.frame_set(1)
    setup_preview(scene, head, SIZE, face_view(head))
    if not shown:
        bpy.context.window.scene = bpy.data.scenes.new("Other")
    before = bpy.context.scene
    rest, wide, turned_head = (image.astype(float) for image in render_frames(scene, [1.0, 11.0, 21.0], SIZE))
    assert np.abs(wide - rest).mean() > 3.0 and np.abs(turned_head - rest).mean() > 3.0
    assert bpy.context.scene == before


def test_a_collision_shape_that_is_disabled_everywhere_stays_hidden():
    objects = make_character(rig=True, hair=True)
    shape = objects["hair"].copy()
    shape.data = shape.data.copy()
    bpy.context.scene.collection.objects.link(shape)
    shape.hide_viewport = shape.hide_render = objects["hair"].hide_render = True
    bpy.context.view_layer.update()
    head, _ = bind_character(objects["head"])
    setup_preview(bpy.context.scene, head, SIZE)
    assert {shape, objects["hair"]} <= set(objects_of(head))
    assert shape.hide_render and not objects["hair"].hide_render

"""Takes from animation: the motion of a head in Blender, or in a file, drives another head."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.sampling import Sampling
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks
from facemime.cli.character_files import open_file
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.face.names import COEFFICIENTS
from facemime.core.takes.file import load_take
from facemime.core.takes.neutral import calibrate
from facemime.settings import takes_store
from tests.helpers.commands import run
from tests.helpers.hiding import HIDING
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("in_a_project")
LAST = 12


@pytest.fixture
def animated():
    """A head that opens its jaw, turns to its left, and looks to its right."""
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    scene.frame_start, scene.frame_end = 1, LAST
    jaw = head.data.shape_keys.key_blocks["jawOpen"]
    for frame, amount in ((1, 0.0), (LAST, 1.0)):
        jaw.value = 0.6 * amount
        jaw.keyframe_insert("value", frame=frame)
        head.rotation_euler.z = 0.5 * amount
        head.keyframe_insert("rotation_euler", frame=frame)
        for eye in (child for child in head.children if "eye" in child.name.lower()):
            eye.delta_rotation_euler.z = -0.3 * amount
            eye.keyframe_insert("delta_rotation_euler", frame=frame)
    scene.frame_set(5)
    return head


def check(take, *, frames=LAST, gaze=0.3):
    """Check that a take has the performance of `animated`."""
    assert len(take) == frames and take.found.all()
    np.testing.assert_allclose(take.pose[[0, -1], 2], [0.0, -0.5], atol=2e-3)
    found = arkit_coefficients(take, calibrate(take))[-1]
    assert found[COEFFICIENTS.index("jawOpen")] == pytest.approx(0.6, abs=0.02)
    if gaze is not None:
        np.testing.assert_allclose(take.gaze[-1], [0.0, gaze], atol=2e-3)


def test_an_animated_head_becomes_a_take_and_the_scene_stays_as_it_was(animated, takes):
    thick = animated.modifiers.new("Subdivision", "SUBSURF")
    assert bpy.ops.facemime.take_from_animation() == {"FINISHED"}
    assert bpy.context.scene.frame_current == 5 and thick.show_viewport
    assert takes.items[0].name == "Facemime_Head"
    check(takes_store.read(takes.items[0]))


def test_a_head_that_its_animation_hides_is_sampled_all_the_time(animated, takes):
    for frame, hidden in ((1, False), (4, True)):
        animated.hide_viewport = hidden
        animated.keyframe_insert("hide_viewport", frame=frame)
    sampling = Sampling(bpy.context.scene, animated, "hidden")
    assert len(list(sampling)) == LAST
    check(sampling.take())
    assert animated.hide_viewport


def test_a_take_of_an_animation_drives_another_head_in_the_same_way(animated, takes):
    assert bpy.ops.facemime.take_from_animation() == {"FINISHED"}
    other = add_head(bpy.context)
    bpy.context.view_layer.objects.active = other
    animated.select_set(False)
    other.select_set(True)
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    for frame in (1, LAST):
        bpy.context.scene.frame_set(frame)
        one, two = (_landmarks(head) for head in (animated, other))
        assert np.linalg.norm(one - two, axis=1).mean() < 0.005 * outer_eye_distance(two)


def _landmarks(head):
    final = head.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([final.data.vertices[index].co for index in read_landmarks(head).tolist()])


@pytest.mark.thorough
def test_a_head_that_does_not_move_is_reported(takes):
    add_head(bpy.context)
    with pytest.raises(RuntimeError, match="does not move from frame 1 to 250"):
        bpy.ops.facemime.take_from_animation()
    assert not len(takes.items)


def test_only_the_preview_range_is_sampled_if_there_is_one(animated, takes):
    scene = bpy.context.scene
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 3, 8
    assert bpy.ops.facemime.take_from_animation() == {"FINISHED"}
    assert len(takes_store.read(takes.items[0])) == 6


def test_a_modifier_that_changes_the_vertices_is_named(animated):
    nodes = bpy.data.node_groups.new("Delete", "GeometryNodeTree")
    nodes.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes.nodes.new("NodeGroupOutput")
    animated.modifiers.new("Delete", "NODES").node_group = nodes
    with pytest.raises(RuntimeError, match="change the number of its vertices"):
        bpy.ops.facemime.take_from_animation()
    assert bpy.context.scene.frame_current == 5


@pytest.mark.parametrize(
    "suffix", [".blend", *(pytest.param(suffix, marks=pytest.mark.thorough) for suffix in (".abc", ".glb"))]
)
def test_the_command_imports_an_animation_of_a_file(animated, tmp_path, suffix):
    path, output = tmp_path / f"animation{suffix}", tmp_path / "take.facetake"
    if suffix == ".abc":
        bpy.ops.wm.alembic_export(filepath=str(path), as_background_job=False)
    elif suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert run("import", path, "-o", output).returncode == 0
    # Other formats do not say which parts are eyes.
    check(load_take(output), gaze=0.3 if suffix == ".blend" else None)


@pytest.mark.thorough
def test_the_command_reports_a_head_that_does_not_move(tmp_path):
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "still.blend"))
    done = run("import", tmp_path / "still.blend", "-o", tmp_path / "take.facetake")
    assert done.returncode == 1 and "does not move" in done.stderr and not (tmp_path / "take.facetake").exists()


@pytest.mark.parametrize("hide", first_of(HIDING, 2))
def test_a_head_is_sampled_however_it_is_hidden_and_stays_so(hide, animated):
    HIDING[hide]([animated, *animated.children])
    bpy.context.view_layer.update()
    sampling = Sampling(bpy.context.scene, animated, "hidden")
    for _ in sampling:
        pass
    check(sampling.take())
    bpy.context.view_layer.update()
    assert animated.visible_get() == hide.endswith("unselectable")


@pytest.mark.parametrize("suffix", [".glb", ".usda"])
def test_keys_below_0_and_above_1_in_files_of_other_programs_are_not_clipped(animated, tmp_path, suffix):
    jaw, path = animated.data.shape_keys.key_blocks["jawOpen"], tmp_path / f"a{suffix}"
    jaw.slider_min, jaw.slider_max = -1.0, 2.0
    for frame, value in ((1, 0.2), (4, -0.6), (8, 1.4), (LAST, 0.2)):
        jaw.value = value
        jaw.keyframe_insert("value", frame=frame)
    if suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.usd_export(filepath=str(path), export_animation=True)
    open_file(path)
    found = set()
    for frame in range(LAST + 1):
        bpy.context.scene.frame_set(frame)
        found |= {keys.key_blocks["jawOpen"].value for keys in bpy.data.shape_keys if "jawOpen" in keys.key_blocks}
    assert (min(found), max(found)) == pytest.approx((-0.6, 1.4), abs=1e-3)

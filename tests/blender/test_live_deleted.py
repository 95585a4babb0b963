"""Deletions while a puppet is running: Blender does not crash, the rest continues, and everything is restored."""

import subprocess
import sys
import textwrap
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import COUNT_PROPERTY, LANDMARKS_PROPERTY, LIVE_PROPERTY, MARKS_PROPERTY, PART_PROPERTY
from facemime.operators.puppet import running
from tests.helpers.live_ticks import CLICK, outcome_of_ticks, shown, some_frames, start, tick, ticks_until
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")


def two_heads() -> tuple[bpy.types.Object, bpy.types.Object]:
    """Add two heads and select both."""
    heads = add_head(bpy.context), add_head(bpy.context)
    heads[0].select_set(True)
    return heads


def test_deleting_one_head_keeps_the_other_moving(looping):
    first, second = two_heads()
    start()
    bpy.data.objects.remove(second)
    assert tick(CLICK) == {"PASS_THROUGH"}
    some_frames()
    assert running() is not None
    bpy.data.objects.remove(first)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def test_a_single_undo_restores_a_head_deleted_while_it_moved(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.ops.ed.undo_push(message="head")
    start()
    bpy.ops.object.delete()
    bpy.ops.ed.undo_push(message="delete")
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None
    assert bpy.ops.ed.undo() == {"FINISHED"}
    np.testing.assert_array_equal(shown(bpy.data.objects["Facemime Head"]), rest)


@pytest.mark.parametrize("keep", [False, True])
def test_deleting_a_head_with_its_mesh_is_reported_with_and_without_keep_pose(looping, keep):
    head = add_head(bpy.context)
    bpy.context.scene.facemime.keep_pose = keep
    start()
    mesh = head.data
    bpy.data.objects.remove(head)
    bpy.data.meshes.remove(mesh)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def test_after_deleting_one_head_the_file_is_saved_with_the_other_at_rest(looping, tmp_path):
    first, second = two_heads()
    rest = shown(first)
    start()
    bpy.data.objects.remove(second)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    some_frames()
    assert LIVE_KEY in first.data.shape_keys.key_blocks
    bpy.ops.facemime.stop_puppet()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert bpy.data.objects["Facemime Head"].data.shape_keys is None
    np.testing.assert_array_equal(shown(bpy.data.objects["Facemime Head"]), rest)


def test_deleting_an_eye_and_saving_does_not_stop_the_head_which_returns_to_rest(looping, tmp_path):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    bpy.data.objects.remove(next(child for child in head.children if child[PART_PROPERTY] == "eye_left"))
    some_frames()
    assert np.abs(shown(head) - rest).max() > 1e-3
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    some_frames()
    assert np.abs(shown(head) - rest).max() > 1e-3
    bpy.ops.facemime.stop_puppet()
    np.testing.assert_array_equal(shown(head), rest)
    assert all(tuple(child.delta_rotation_euler) == (0.0, 0.0, 0.0) for child in head.children)


def test_a_shared_mesh_returns_to_rest_after_its_head_is_deleted(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    sibling = bpy.data.objects.new("Sibling", head.data)
    bpy.context.collection.objects.link(sibling)
    start()
    bpy.data.objects.remove(head)
    assert outcome_of_ticks() == {"CANCELLED"}
    assert sibling.data.shape_keys is None and "Facemime" not in bpy.data.objects
    np.testing.assert_array_equal(shown(sibling), rest)


def delete_all_keys(head: bpy.types.Object) -> None:
    """Delete all shape keys."""
    bpy.ops.object.shape_key_remove(all=True)


def delete_all_but_the_live_key(head: bpy.types.Object) -> None:
    """Delete the basis and what the user has added."""
    for key in [key for key in head.data.shape_keys.key_blocks if key.name != LIVE_KEY]:
        head.shape_key_remove(key)


@pytest.mark.parametrize("delete", first_of([delete_all_keys, delete_all_but_the_live_key]))
@pytest.mark.parametrize("units", first_of([False, True]))
def test_deleting_shape_keys_stops_the_puppet_with_the_head_at_rest(looping, units, delete):
    head = add_head(bpy.context, units=units)
    rest = shown(head)
    start()
    delete(head)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None
    assert head.data.shape_keys is None and LIVE_PROPERTY not in head.data
    np.testing.assert_allclose(shown(head), rest, atol=1e-7)


def steps_from_here(*operators: str) -> None:
    """Push undo steps, as a user does while the puppet is running."""
    for name in operators:
        bpy.ops.object.select_all(action=name)
        bpy.ops.ed.undo_push(message=name)


def test_undoing_into_a_past_session_shows_the_head_at_rest(looping):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.ops.ed.undo_push(message="head")
    start()
    steps_from_here("DESELECT", "SELECT")
    some_frames()
    bpy.ops.facemime.stop_puppet()
    assert head.data.shape_keys is None and LIVE_PROPERTY not in head.data
    for move in [bpy.ops.ed.undo] * 4 + [bpy.ops.ed.redo] * 4:
        assert move() == {"FINISHED"}
        again = bpy.data.objects["Facemime Head"]
        np.testing.assert_array_equal(shown(again), rest)
        keys = again.data.shape_keys
        assert keys is None or [key.name for key in keys.key_blocks] == ["Basis"]
    assert again.data.shape_keys is None


def test_undo_during_a_session_undoes_the_users_step_and_the_puppet_goes_on(looping):
    head = add_head(bpy.context)
    bpy.ops.mesh.primitive_cube_add()
    head.select_set(True)
    bpy.context.view_layer.objects.active = head
    bpy.ops.ed.undo_push(message="head")
    start()
    for place in (1.0, 2.0):
        bpy.data.objects["Cube"].location.x = place
        bpy.ops.ed.undo_push(message="Move")
        some_frames()
    for place in (1.0, 0.0):
        assert bpy.ops.ed.undo() == {"FINISHED"}
        assert bpy.data.objects["Cube"].location.x == place and running() is not None
        some_frames()
        assert LIVE_KEY in bpy.data.objects["Facemime Head"].data.shape_keys.key_blocks
    assert bpy.ops.ed.redo() == {"FINISHED"} and bpy.data.objects["Cube"].location.x == 1.0
    some_frames()
    assert running() is not None


def test_undoing_the_start_of_the_puppet_stops_it_and_says_so(looping, capfd):
    head = add_head(bpy.context)
    rest = shown(head)
    bpy.ops.ed.undo_push(message="head")
    start()
    session = running()
    assert bpy.ops.ed.undo() == {"FINISHED"} and running() is None
    assert "undone" in session.warning
    np.testing.assert_array_equal(shown(bpy.data.objects["Facemime Head"]), rest)
    assert bpy.data.objects["Facemime Head"].data.shape_keys is None
    assert bpy.ops.ed.redo() == {"FINISHED"}
    np.testing.assert_array_equal(shown(bpy.data.objects["Facemime Head"]), rest)


def test_undoing_a_deletion_during_a_session_gives_the_head_back_at_rest(looping):
    head = add_head(bpy.context)
    matrix = np.array(head.matrix_world)
    bpy.ops.ed.undo_push(message="head")
    start()
    steps_from_here("DESELECT", "SELECT")
    bpy.data.objects.remove(head)
    bpy.ops.ed.undo_push(message="Delete")
    outcome_of_ticks()
    assert running() is None
    assert bpy.ops.ed.undo() == {"FINISHED"}
    bpy.context.view_layer.update()
    again = bpy.data.objects["Facemime Head"]
    np.testing.assert_allclose(np.array(again.matrix_world), matrix, atol=1e-6)


def test_opening_a_file_saved_in_a_crash_removes_the_live_key(looping, tmp_path):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    bpy.data.libraries.write(str(tmp_path / "autosave.blend"), {bpy.context.scene})  # as in a crash, without handlers
    running().close()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "autosave.blend"))
    scene = bpy.data.scenes[0]
    again = next(obj for obj in scene.objects if obj.name == "Facemime Head")
    assert again.data.shape_keys is None and LIVE_PROPERTY not in again.data
    bpy.context.window.scene = scene
    np.testing.assert_array_equal(shown(again), rest)


def test_saving_in_edit_mode_continues_the_session_and_saves_the_head_at_rest(looping, tmp_path):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    some_frames()
    bpy.ops.object.mode_set(mode="OBJECT")
    number = running()._number
    ticks_until(lambda: np.abs(shown(head) - rest).max() > 1e-3 or running()._number > number + 60)
    assert np.abs(shown(head) - rest).max() > 1e-3
    bpy.ops.facemime.stop_puppet()
    np.testing.assert_allclose(shown(head), rest, atol=1e-7)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    np.testing.assert_allclose(shown(bpy.data.objects["Facemime Head"]), rest, atol=1e-7)


def test_converting_a_head_is_reported(looping):
    add_head(bpy.context)
    start()
    bpy.ops.object.convert(target="CURVE")
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None


def clear(head: bpy.types.Object) -> None:
    """Clear the geometry of the mesh."""
    head.data.clear_geometry()


def edit(head: bpy.types.Object) -> None:
    """Enter Edit Mode."""
    bpy.ops.object.mode_set(mode="EDIT")


def swap(head: bpy.types.Object) -> None:
    """Replace the mesh by another one, and remove it."""
    old, head.data = head.data, bpy.data.meshes.new("Other")
    bpy.data.meshes.remove(old)


def convert(head: bpy.types.Object) -> None:
    """Convert the head to a curve."""
    bpy.ops.object.convert(target="CURVE")


@pytest.mark.parametrize("change", first_of([clear, edit, swap, convert], 2))
@pytest.mark.parametrize("slices", first_of([2, 0, 1, 3]))
def test_a_head_that_changes_during_a_check_is_reported_or_continues(looping, change, slices):
    head = add_head(bpy.context)
    start()
    tick(CLICK)
    for _ in range(slices):
        tick()
    change(head)
    outcomes = {outcome for _ in range(8) if running() is not None for outcome in tick(CLICK)}
    assert outcomes <= {"PASS_THROUGH", "CANCELLED"}
    if running() is not None:
        bpy.ops.facemime.stop_puppet()


def test_deleting_the_bone_that_takes_the_pose_stops_the_puppet(looping):
    head = add_head(bpy.context)
    bpy.ops.object.armature_add()
    armature = bpy.context.active_object
    posing = bpy.context.scene.facemime.posing
    posing.object, posing.bone = armature, "Bone"
    bpy.context.view_layer.objects.active = head
    bpy.ops.facemime.puppet()
    ticks_until(lambda: armature.pose.bones["Bone"].rotation_quaternion.angle > 0.05)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones.remove(armature.data.edit_bones["Bone"])
    bpy.ops.object.mode_set(mode="OBJECT")
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None
    assert head.data.shape_keys is None


_DELETIONS = {
    "all shape keys": "bpy.ops.object.shape_key_remove(all=True)",
    "the actions": "[bpy.data.actions.remove(action) for action in list(bpy.data.actions)]",
    "the head, and purged": "bpy.ops.object.delete(); bpy.ops.outliner.orphans_purge(do_recursive=True)",
    "the tracks": "[t.remove(s) for d in [o.animation_data for o in bpy.data.objects if o.animation_data] "
    "for t in [d.nla_tracks] for s in list(t)]",
}
_BAKED_THEN_PUPPETED = """
import sys
sys.path.insert(0, {tests!r})
import bpy, facemime, numpy as np
from tests.helpers.clocks import AskedClock
from facemime.blender.heads.new_heads import add_head
from facemime.core.puppet.sources import PacedSource
from facemime.core.takes.file import save_take
from tests.helpers.live_ticks import moving, ticks_until
from pathlib import Path
from tests.helpers.takes import performance
facemime.register()
try:
    PacedSource.pace = AskedClock()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    save_take(performance(), Path({take!r}))
    scene = bpy.context.scene
    scene.facemime.source.kind, scene.facemime.source.take, scene.facemime.source.loop = "TAKE", {take!r}, True
    add_head(bpy.context)
    bpy.ops.facemime.import_take(filepath={take!r})
    scene.facemime_takes.bake.nla = {nla}
    bpy.ops.facemime.bake_take()
    bpy.ops.facemime.puppet()
    ticks_until(moving)
    {deletion}
    for number in range(300):  # reuse memory that was freed
        bpy.data.meshes.new("mesh").from_pydata(np.zeros((50, 3)).tolist(), [], [])
        bpy.data.actions.new("action")
    bpy.ops.facemime.stop_puppet()
finally:
    facemime.unregister()
print("alive")
"""


@pytest.mark.thorough
@pytest.mark.parametrize("nla", [False, True])
@pytest.mark.parametrize("deletion", _DELETIONS, ids=str)
def test_deleting_a_muted_bake_does_not_crash_blender(deletion, nla, tmp_path):
    take, tests = str(tmp_path / "take.facetake"), str(Path(__file__).parents[2])
    code = textwrap.dedent(_BAKED_THEN_PUPPETED).format(tests=tests, take=take, deletion=_DELETIONS[deletion], nla=nla)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0 and done.stdout.endswith("alive\n"), (done.returncode, done.stdout, done.stderr)


@pytest.mark.parametrize("name", first_of([LANDMARKS_PROPERTY, COUNT_PROPERTY, MARKS_PROPERTY]))
@pytest.mark.parametrize(
    "value", first_of(["text", [0.5] * 66, 10**9, 3.5, [1, 2, 3], {"a": 1}, True, [[1, 2]]]), ids=str
)
def test_an_invalid_custom_property_is_reported_with_a_remedy(take, name, value):
    head = add_head(bpy.context)
    try:
        head.data[name] = value
    except TypeError:
        pytest.skip("Blender keeps no such value")
    for operator in (bpy.ops.facemime.puppet, bpy.ops.facemime.check_head, bpy.ops.facemime.bind_landmarks):
        try:
            operator()
        except RuntimeError as error:
            assert "Traceback" not in str(error), error
        if running() is not None:
            bpy.ops.facemime.stop_puppet()


def test_undoing_into_absolute_keys_stops_the_puppet_with_the_reason(looping):
    head = add_head(bpy.context, units=True)
    bpy.context.scene.facemime.drive_by = "KEYS"
    start()
    session = running()
    head.data.shape_keys.use_relative = False
    bpy.ops.ed.undo_push(message="absolute")
    bpy.data.objects["Facemime Head"].data.shape_keys.use_relative = True
    bpy.ops.ed.undo_push(message="relative")
    assert bpy.ops.ed.undo() == {"FINISHED"} and running() is None
    assert "Enable Relative" in session.warning


def test_a_mesh_that_is_replaced_and_purged_stops_the_puppet_with_an_error(looping):
    head = add_head(bpy.context)
    start()
    before = head.data
    head.data = bpy.data.meshes.new("Other")
    bpy.data.meshes.remove(before)
    assert outcome_of_ticks() == {"CANCELLED"} and running() is None

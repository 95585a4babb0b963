"""Characters of several meshes on an armature are bound by one click, driven live and baked."""

from collections import Counter
from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from facemime.blender.animation.live import LiveHeadObject
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.characters import (
    members_of,
    objects_of,
    part_table,
    read_bones,
    read_kinds,
    rest_matrix,
)
from facemime.blender.frames import rotation_to_blender
from facemime.blender.heads import binding as binding_module
from facemime.blender.heads.binding import bind_character, check_object
from facemime.blender.meshes import read_landmarks, read_vertices
from facemime.blender.names import HEAD_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.heads.bind import bind_landmarks
from facemime.core.heads.checks import EYES_SHUT
from facemime.core.heads.rig import Part
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from facemime.core.takes.neutral import calibrate
from tests.helpers.characters import TRUTH, make_character, shown, turn_between
from tests.helpers.clips import write_clips
from tests.helpers.commands import run
from tests.helpers.curves import curves_of
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


@pytest.mark.parametrize("start", first_of(["body", "eye_left", "head"]))
@pytest.mark.parametrize("y_up", first_of([False, True]))
def test_any_mesh_of_a_character_leads_to_its_face_its_parts_and_its_bones(start, y_up):
    objects = make_character(rig=True, y_up=y_up)
    before = {name: shown(obj) for name, obj in objects.items()}
    bpy.context.view_layer.objects.active = objects[start]
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    head = bpy.context.active_object
    assert head == objects["head"] and check_object(head) == []
    found = {name: set(map(Part, read_kinds(objects[name].data).tolist())) for name in TRUTH}
    assert found == TRUTH
    assert set(objects_of(head)) == {objects[name] for name in TRUTH}
    armature, bones = read_bones(head)
    assert armature == head.parent and bones.head == "Head" and bones.eye_left == ""
    for name, obj in objects.items():
        np.testing.assert_allclose(shown(obj), before[name], atol=1e-5)


def test_the_bone_of_the_head_leads_to_a_face_in_front_of_a_large_body():
    objects = make_character(rig=True)
    landmarks = read_landmarks(bind_character(objects["head"])[0])
    places = shown(objects["head"])[landmarks]
    objects = make_character(rig=True)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.5, location=(0.0, 1.9, 0.6))
    trunk, head = bpy.context.active_object, objects["head"]
    trunk.vertex_groups.new(name="Spine").add(range(len(trunk.data.vertices)), 1.0, "REPLACE")
    with bpy.context.temp_override(active_object=head, object=head, selected_editable_objects=[head, trunk]):
        bpy.ops.object.join()
    found = shown(head)[read_landmarks(bind_character(head)[0])]
    assert np.linalg.norm(found - places, axis=1).max() < 0.05 * outer_eye_distance(places)


def test_eyes_that_are_seen_between_their_lids_are_not_called_shut_although_the_tracker_saw_no_iris(monkeypatch):
    def without_irises(*arguments):
        return replace(bind_landmarks(*arguments), findings=(EYES_SHUT,))

    monkeypatch.setattr(binding_module, "bind_landmarks", without_irises)
    objects = make_character(rig=True)
    assert bind_character(objects["head"])[1].findings == ()
    for name in ("eye_left", "eye_right"):
        bpy.data.objects.remove(objects[name])
    assert bind_character(objects["head"])[1].findings == (EYES_SHUT,)


@pytest.mark.parametrize("rig", [True, False])
def test_meshes_without_vertices_are_no_parts_of_a_character(rig):
    objects = make_character(rig=rig)
    nothing = bpy.data.objects.new("Eye", bpy.data.meshes.new("Eye"))
    objects["head"].users_collection[0].objects.link(nothing)
    nothing.parent = objects["head"].parent
    head, _ = bind_character(objects["head"])
    assert head == objects["head"] and nothing not in objects_of(head)


@pytest.mark.parametrize("start", first_of(["body", "eye_left", "head"]))
@pytest.mark.parametrize("turned", first_of([True, False]))
def test_loose_meshes_without_names_that_touch_are_a_character(start, turned):
    objects = make_character(rig=False, hair=True)
    bpy.context.scene.collection.objects.unlink(objects["body"])
    objects["head"].users_collection[0].objects.link(objects["body"])
    if turned:  # as the importer of OBJ does
        up = Matrix.Rotation(np.pi / 2.0, 4, "X")
        for obj in objects.values():
            obj.data.transform(up.inverted())
            obj.matrix_world = up @ obj.matrix_world
    for place in (0.0, 10.0):
        bpy.ops.mesh.primitive_cube_add(size=0.2, location=(place, 0.0, 0.0))
        collection = objects["head"].users_collection[0]
        if bpy.context.object.name not in collection.objects:
            collection.objects.link(bpy.context.object)
    before = {name: shown(obj) for name, obj in objects.items()}
    head, _ = bind_character(objects[start])
    assert head == objects["head"] and check_object(head) == []
    assert {name: set(map(Part, read_kinds(objects[name].data).tolist())) for name in TRUTH} == TRUTH
    assert set(objects_of(head)) == {objects[name] for name in (*TRUTH, "hair")}
    for name, obj in objects.items():
        np.testing.assert_allclose(shown(obj), before[name], atol=1e-5)


def test_a_character_that_was_joined_to_one_mesh_with_the_name_of_an_eye_has_all_its_parts():
    objects = make_character(rig=True)
    counts = {name: len(obj.data.vertices) for name, obj in objects.items() if name in TRUTH}
    order = [objects["eye_left"], *(obj for name, obj in objects.items() if name != "eye_left")]
    with bpy.context.temp_override(active_object=order[0], object=order[0], selected_editable_objects=order):
        bpy.ops.object.join()
    order[0].name = "EyeLeft"
    head, _ = bind_character(order[0])
    assert check_object(head) == []
    kinds = Counter(map(Part, read_kinds(head.data).tolist()))
    expected = Counter[Part]()
    for name, count in counts.items():
        (part,) = TRUTH[name]
        expected[part] += count
    assert {part: kinds[part] for part in expected} == expected


@pytest.mark.parametrize("y_up", first_of([True, False]))
def test_a_bake_turns_the_head_bone_in_world_axes_and_moves_all_parts(y_up):
    objects = make_character(rig=True, y_up=y_up)
    head, _ = bind_character(objects["body"])
    rest = {name: shown(obj) for name, obj in objects.items()}
    report = puppet_head(bpy.context.scene, head, performance())
    row = int(np.argmax(np.abs(report.motion.rotation[:, 0, 2])))
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    upper = turn_between(rest["teeth_upper"], shown(objects["teeth_upper"]))
    np.testing.assert_allclose(upper, rotation_to_blender(report.motion.rotation[row]), atol=5e-3)
    np.testing.assert_allclose(shown(objects["body"]), rest["body"], atol=1e-6)
    eye = turn_between(rest["eye_left"], shown(objects["eye_left"]))
    expected = report.motion.rotation[row] @ report.motion.gaze[row, 1]
    np.testing.assert_allclose(eye, rotation_to_blender(expected), atol=0.06)
    assert np.abs(upper - np.eye(3)).max() > 0.1


@pytest.mark.thorough
def test_baked_keys_of_one_name_are_on_all_meshes_that_move_and_have_one_value():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    report = puppet_head(bpy.context.scene, head, performance())
    moving = [objects[name] for name in ("head", "eye_left", "eye_right", "teeth_lower", "tongue")]
    assert {member.obj for member in members_of(head)} == set(moving)
    bpy.context.scene.frame_set(30)
    values = [{key.name: key.value for key in obj.data.shape_keys.key_blocks[1:]} for obj in moving]
    assert len(values[0]) == report.keys and all(value == values[0] for value in values)
    assert objects["teeth_upper"].data.shape_keys is None
    again = puppet_head(bpy.context.scene, head, performance())
    assert len(objects["tongue"].data.shape_keys.key_blocks) == again.keys + 1


@pytest.mark.thorough
def test_a_cache_is_written_for_each_mesh_that_moves(tmp_path):
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    bake = BakeSettings(keys="cache", path=tmp_path / "face")
    report = puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=bake))
    assert len(list(tmp_path.glob("*.pc2"))) == 5
    row = int(np.argmax(np.abs(report.motion.jaw[:, 1, 2])))
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    teeth = objects["teeth_lower"]
    member = next(member for member in members_of(head) if member.obj == teeth)
    moved = report.motion.vertices[row][member.part]
    bone = np.array(head.parent.pose.bones["Head"].matrix @ head.parent.data.bones["Head"].matrix_local.inverted())
    expected = np.array([Vector(point) for point in shown(teeth)])
    local = (np.linalg.inv(bone) @ np.c_[expected, np.ones(len(expected))].T).T[:, :3]
    in_head = np.c_[local[:, 0], -local[:, 2], local[:, 1]]
    rest = np.array([vertex.co for vertex in teeth.data.vertices])
    np.testing.assert_allclose(in_head - np.c_[rest[:, 0], -rest[:, 2], rest[:, 1]], moved, atol=1e-5)
    assert np.abs(moved).max() > 1e-4


def test_live_all_meshes_follow_and_are_restored_at_the_end():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    before = {name: shown(obj) for name, obj in objects.items()}
    take = performance()
    head_shown = LiveHeadObject(head, own_targets(head))
    driver = HeadDriver(read_rig(head), calibrate(take))
    head_shown.attach()
    frames = [driver.frame(take.result(int(i))) for i in np.flatnonzero(take.found)]
    frame = max(frames, key=lambda frame: abs(frame.rotation[0, 2]))
    head_shown.write(frame)
    moved = {name: np.abs(shown(obj) - before[name]).max() for name, obj in objects.items()}
    assert moved["body"] < 1e-6 and min(moved[name] for name in TRUTH) > 1e-4
    head_shown.detach(keep=False)
    for name, obj in objects.items():
        np.testing.assert_allclose(shown(obj), before[name], atol=1e-6)
        assert obj.data.shape_keys is None


@pytest.mark.thorough
def test_a_character_without_bones_turns_as_a_whole_about_its_neck():
    objects = make_character(rig=False)
    for name in ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue"):
        objects[name].name = {"eye_left": "Eye.L", "eye_right": "Eye.R"}.get(name, name.title())
    head, _ = bind_character(objects["head"])
    assert set(objects_of(head)) == {objects[name] for name in TRUTH}
    rest = {name: shown(obj) for name, obj in objects.items()}
    report = puppet_head(bpy.context.scene, head, performance())
    row = int(np.argmax(np.abs(report.motion.rotation[:, 0, 2])))
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    turn = rotation_to_blender(report.motion.rotation[row])
    pivot = np.array(rest_matrix(head) @ Vector(head["facemime_pivot"]))
    np.testing.assert_allclose(shown(objects["teeth_upper"]), (rest["teeth_upper"] - pivot) @ turn.T + pivot, atol=1e-4)
    assert np.abs(shown(objects["teeth_upper"]) - rest["teeth_upper"]).max() > 0.005
    unit = outer_eye_distance(read_vertices(head.data)[read_landmarks(head)])
    assert np.linalg.norm(pivot) < 0.3 * unit


@pytest.mark.thorough
def test_a_part_chosen_by_the_user_is_respected_and_kept_when_binding_again():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    bpy.context.view_layer.objects.active = head
    teeth = objects["teeth_lower"]
    bpy.ops.facemime.set_part(part="ON_HEAD", name=teeth.name, before="TEETH_LOWER")
    assert teeth not in {member.obj for member in members_of(head)}
    assert (teeth, Part.ON_HEAD, len(teeth.data.vertices)) in part_table(head)
    bpy.ops.facemime.bind_landmarks()
    assert teeth not in {member.obj for member in members_of(head)}
    bpy.ops.facemime.remove_part(name=teeth.name)
    assert HEAD_PROPERTY not in teeth
    bpy.ops.facemime.find_parts()
    assert teeth in {member.obj for member in members_of(head)}


@pytest.mark.thorough
def test_the_part_of_selected_vertices_is_set_in_edit_mode():
    objects = make_character(rig=True)
    bind_character(objects["head"])
    teeth = objects["teeth_upper"]
    bpy.context.view_layer.objects.active = teeth
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_mode(type="VERT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    teeth.data.vertices.foreach_set("select", np.arange(len(teeth.data.vertices)) < 5)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.facemime.set_part(part="TEETH_LOWER")
    assert bpy.context.mode == "EDIT_MESH"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert (read_kinds(teeth.data) == Part.TEETH_LOWER).sum() == 5


@pytest.mark.thorough
def test_the_bones_can_be_chosen_and_cleared():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.set_bone(target="head", bone="Spine") == {"FINISHED"}
    assert own_targets(head)["head"].bone == "Spine"
    bpy.ops.facemime.set_bone(target="head", bone="NONE")
    assert own_targets(head)["head"].obj == head


@pytest.mark.thorough
def test_expression_keys_are_made_on_all_meshes_that_they_move_and_existing_ones_are_kept():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    head.shape_key_add(name="Basis")
    own = head.shape_key_add(name="jawOpen")
    own.points[0].co.x += 1.0
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.make_expression_keys() == {"FINISHED"}
    keys = head.data.shape_keys.key_blocks
    assert len(keys) == 53 and all(key.value == 0.0 for key in keys[1:])
    assert keys["jawOpen"].points[0].co.x - keys["Basis"].points[0].co.x == pytest.approx(1.0)
    assert "jawOpen" in objects["teeth_lower"].data.shape_keys.key_blocks
    assert objects["body"].data.shape_keys is None and objects["teeth_upper"].data.shape_keys is None
    bake = PuppetSettings(bake=BakeSettings(keys="mapped"))
    assert puppet_head(bpy.context.scene, head, performance(), bake).keys > 40
    bpy.context.scene.frame_set(30)
    for name in ("eyeBlinkLeft", "mouthSmileLeft"):
        assert objects["tongue"].data.shape_keys.key_blocks[name].value == pytest.approx(keys[name].value)


@pytest.mark.thorough
def test_a_character_in_a_file_of_another_program_is_bound_and_puppeted_by_commands(tmp_path):
    objects = make_character(rig=True)
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "character.glb"))
    bound, out, picture = tmp_path / "bound.blend", tmp_path / "out.blend", tmp_path / "face.png"
    names = {name: obj.name for name, obj in objects.items()}
    done = run("bind", tmp_path / "character.glb", "-o", bound, "--picture", picture)
    assert done.returncode == 0, done.stderr
    printed = done.stdout
    rows = {line.split()[0]: line.split()[1:-1] for line in printed.splitlines() if line.startswith("Object_")}
    assert rows[names["eye_left"]] == ["Left", "Eye"] and rows[names["tongue"]] == ["Lower", "Teeth"]
    assert "bone of the head: Head" in printed and picture.stat().st_size > 1000
    take = tmp_path / "a.facetake"
    save_take(performance(), take)
    direct = run("puppet", take, "--head", tmp_path / "character.glb", "-o", tmp_path / "direct.blend")
    assert direct.returncode == 0 and f"Bound {names['head']}" in direct.stderr
    assert run("puppet", take, "--head", bound, "-o", out).returncode == 0
    bpy.ops.wm.open_mainfile(filepath=str(out))
    bone = next(obj for obj in bpy.data.objects if obj.type == "ARMATURE").pose.bones["Head"]
    angles = []
    for frame in range(1, 60, 5):
        bpy.context.scene.frame_set(frame)
        angles.append(bone.matrix_basis.to_quaternion().angle)
    assert max(angles) > 0.1


@pytest.mark.thorough
@pytest.mark.parametrize("command", ["puppet", "batch"])
def test_commands_animate_the_bone_that_was_chosen_in_the_file(command, tmp_path):
    head, _ = bind_character(make_character(rig=True)["head"])
    bpy.context.view_layer.objects.active = head
    assert read_bones(head)[1].head == "Head"
    assert bpy.ops.facemime.set_bone(target="head", bone="Spine") == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "chosen.blend"))
    clips, out = write_clips(tmp_path / "clips", 1), tmp_path / "out"
    output = {"puppet": out / "0.blend", "batch": out}[command]
    out.mkdir()
    done = run(command, clips / "0.mp4", "--head", tmp_path / "chosen.blend", "-o", output)
    assert done.returncode == 0, done.stderr
    (written,) = out.glob("*.blend")
    bpy.ops.wm.open_mainfile(filepath=str(written))
    armature = next(obj for obj in bpy.data.objects if obj.type == "ARMATURE")
    assert {curve.data_path.split('"')[1] for curve in curves_of(armature)} == {"Spine"}
    turns = {name: [] for name in ("Spine", "Head")}
    for frame in range(1, 13):
        bpy.context.scene.frame_set(frame)
        for name, found in turns.items():
            found.append(armature.pose.bones[name].matrix_basis.to_quaternion().angle)
    assert np.ptp(turns["Spine"]) > 1e-3 and max(turns["Head"]) < 1e-6


@pytest.mark.thorough
def test_parts_joined_into_one_mesh_are_distinguished_by_their_places():
    objects = make_character(rig=True)
    names = list(objects)
    for number, obj in enumerate(objects.values()):
        owner = obj.data.attributes.new("owner", "INT", "POINT")
        owner.data.foreach_set("value", np.full(len(obj.data.vertices), number, dtype=np.int32))
    bpy.ops.object.select_all(action="DESELECT")
    for obj in objects.values():
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects["head"]
    bpy.ops.object.join()
    whole = bpy.context.active_object
    head, _ = bind_character(whole)
    kinds = read_kinds(head.data)
    owners = np.empty(len(kinds), dtype=np.int32)
    head.data.attributes["owner"].data.foreach_get("value", owners)
    assert head == whole and check_object(head) == []
    for number, name in enumerate(names):
        wanted = TRUTH.get(name, {Part.SKIN} if name == "head" else {Part.ON_HEAD})
        assert set(map(Part, kinds[owners == number].tolist())) == wanted, name
    rest = shown(head)
    report = puppet_head(bpy.context.scene, head, performance())
    row = int(np.argmax(np.abs(report.motion.rotation[:, 0, 2])))
    bpy.context.scene.frame_set(round(float(frames_of(bpy.context.scene, report.motion.times[row]))))
    moved = np.abs(shown(head) - rest).max(axis=1)
    assert moved[kinds == Part.EYE_LEFT].min() > 1e-4


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["cut.glb", "text.fbx", "none.glb", "clip.mp4"])
def test_a_file_without_a_character_is_one_clear_error(name, tmp_path):
    if name != "none.glb":
        (tmp_path / name).write_bytes(b"glTF\x02\x00\x00\x00\xff\xff\x00\x00")
    done = run("bind", tmp_path / name, "-o", tmp_path / "out.blend")
    said = [line for line in done.stderr.splitlines() if line.startswith("facemime:")]
    assert done.returncode == 1 and len(said) == 1 and name in said[0] and "Traceback" not in done.stderr
    assert not (tmp_path / "out.blend").exists()

"""Characters and animations in files of other programs, opened as the command line does."""

import json
import struct

import bpy
import numpy as np
import pytest

from facemime.blender.animation.clips import clips_of, owners_of, play, play_single
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.new_heads import add_head
from facemime.blender.surfaces import colour_node
from facemime.blender.timeline import rate_of
from facemime.cli.character_files import likely_mesh, object_named, open_file, tell_of_lost_images
from facemime.cli.options import head_file
from facemime.core.errors import HeadError, SourceError
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.puppet.job import CHARACTER_SUFFIXES, HeadFile
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import load_take, save_take
from tests.helpers.commands import run
from tests.helpers.facegen_files import export_tri
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def _export_usd(path):
    bpy.ops.wm.usd_export(filepath=path, export_animation=True)


EXPORTERS = {
    ".abc": lambda path: bpy.ops.wm.alembic_export(filepath=path, as_background_job=False),
    ".obj": lambda path: bpy.ops.wm.obj_export(filepath=path),
    ".ply": lambda path: bpy.ops.wm.ply_export(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_export(filepath=path),
    **dict.fromkeys((".glb", ".vrm"), lambda path: bpy.ops.export_scene.gltf(filepath=path)),
    ".gltf": lambda path: bpy.ops.export_scene.gltf(filepath=path, export_format="GLTF_SEPARATE"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), _export_usd),
    ".fbx": lambda path: bpy.ops.export_scene.fbx(filepath=path),
    ".tri": export_tri,
    ".blend": lambda path: bpy.ops.wm.save_as_mainfile(filepath=path),
}
LAST = 12


def export(path):
    """Export the scene; the exporter of glTF adds its own suffix to others."""
    if path.suffix == ".vrm":
        EXPORTERS[".glb"](str(path.with_suffix(".glb")))
        path.with_suffix(".glb").rename(path)
    else:
        EXPORTERS[path.suffix](str(path))


def blinking_head(rate=60, frame=7):
    """A head that blinks for a single frame at a high rate."""
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    head.name = "Face"
    scene.render.fps, scene.frame_start, scene.frame_end = rate, 1, LAST
    blink = head.data.shape_keys.key_blocks["eyeBlinkLeft"]
    for at, value in ((1, 0.0), (frame - 1, 0.0), (frame, 1.0), (frame + 1, 0.0), (LAST, 0.0)):
        blink.value = value
        blink.keyframe_insert("value", frame=at)
    return head


def test_every_kind_of_file_is_opened(tmp_path):
    assert set(EXPORTERS) == set(CHARACTER_SUFFIXES)
    for suffix in CHARACTER_SUFFIXES:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        add_head(bpy.context).name = "Face"
        export(tmp_path / f"head{suffix}")
        named = head_file(f"{tmp_path / f'head{suffix}'}:Face")
        assert named == HeadFile(tmp_path / f"head{suffix}", "Face")
        open_file(named.path)
        if suffix not in (".ply", ".stl", ".obj", ".tri"):  # which hold a single mesh, or name it after its data
            assert object_named(named.path, "Face").type in ("MESH", "EMPTY")
        assert any(obj.type == "MESH" and len(obj.data.vertices) > 1000 for obj in bpy.data.objects), suffix


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_lines_of_an_obj_file_may_end_in_any_way(tmp_path, end):
    vertices = len(add_head(bpy.context).data.vertices)
    export(tmp_path / "a.obj")
    data = (tmp_path / "a.obj").read_bytes().replace(b"\r\n", b"\n")
    (tmp_path / "b.obj").write_bytes(data.replace(b"\n", end))
    open_file(tmp_path / "b.obj")
    assert vertices in [len(obj.data.vertices) for obj in bpy.context.scene.objects]


def test_a_file_saved_in_edit_mode_or_tweak_mode_is_opened_ready_to_be_baked_to(tmp_path):
    head = add_head(bpy.context)
    for frame in (1, 10):
        head.keyframe_insert("location", frame=frame)
    data = head.animation_data
    track = data.nla_tracks.new()
    strip = track.strips.new("Walk", 1, data.action)
    data.action, data.nla_tracks.active, strip.select = None, track, True
    data.use_tweak_mode = True
    bpy.context.view_layer.objects.active = head
    bpy.ops.object.mode_set(mode="EDIT")
    export(tmp_path / "a.blend")
    open_file(tmp_path / "a.blend")
    head = bpy.data.objects["Facemime Head"]
    assert head.mode == "OBJECT" and not head.animation_data.use_tweak_mode
    puppet_head(bpy.context.scene, head, performance(), PuppetSettings())


def _instanced(tmp_path):
    """A file that shows a collection of another by an instance."""
    head, group, scene = add_head(bpy.context), bpy.data.collections.new("Character"), bpy.context.scene
    for obj in (head, *head.children):
        obj.users_collection[0].objects.unlink(obj)
        group.objects.link(obj)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", group
    scene.collection.objects.link(instance)
    export(tmp_path / "a.blend")


def _without_library(tmp_path):
    """A file that links a head of a file that is gone."""
    add_head(bpy.context)
    export(tmp_path / "library.blend")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (there, linked):
        linked.objects = there.objects
    for obj in linked.objects:
        bpy.context.scene.collection.objects.link(obj)
    export(tmp_path / "a.blend")
    (tmp_path / "library.blend").unlink()


def _camera_alone(tmp_path):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    export(tmp_path / "a.blend")


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (_instanced, "instances of collections instead of meshes: Instance. Make their objects real"),
        (_without_library, r"links files that are missing: .*library.blend. Relocate them"),
        (_camera_alone, "has no mesh. Choose another file"),
    ],
)
def test_a_file_without_a_mesh_is_refused_with_what_it_has_instead(tmp_path, write, reason):
    write(tmp_path)
    open_file(tmp_path / "a.blend")
    with pytest.raises(HeadError, match=reason):
        likely_mesh(tmp_path / "a.blend")


@pytest.mark.parametrize("extension", ["EXT_meshopt_compression", "KHR_texture_basisu"])
def test_a_file_that_needs_what_blender_cannot_read_says_what_it_is(tmp_path, extension):
    stated = {"asset": {"version": "2.0"}, "extensionsUsed": [extension], "extensionsRequired": [extension]}
    (tmp_path / "small.gltf").write_text(json.dumps(stated))
    with pytest.raises(SourceError, match=f"{extension}.*without compression"):
        open_file(tmp_path / "small.gltf")


def test_images_that_were_left_behind_are_named(tmp_path, capsys):
    head, place = add_head(bpy.context), tmp_path / "images" / "skin.png"
    image = bpy.data.images.new("skin", 8, 8)
    image.filepath_raw, image.file_format = str(place), "PNG"
    image.save()
    node = colour_node(head.material_slots[0].material)
    node.image = image
    tell_of_lost_images(head)
    assert capsys.readouterr().err == ""
    place.unlink()
    image.reload()
    tell_of_lost_images(head)
    assert "Not found: skin.png. What these images colour is magenta." in capsys.readouterr().err


def test_a_file_of_another_kind_lists_those_that_can_be_opened(tmp_path):
    (tmp_path / "head.max").write_bytes(b"x")
    with pytest.raises(SourceError, match=r"\.glb, .*\.vrm, .*\.usdz"):
        open_file(tmp_path / "head.max")


@pytest.mark.parametrize("suffix", first_of([".glb", ".vrm", ".abc", ".usda", ".fbx"], 2))
def test_an_animation_keeps_its_own_frame_rate(tmp_path, suffix):
    blinking_head()
    export(tmp_path / f"blink{suffix}")
    open_file(tmp_path / f"blink{suffix}")
    assert rate_of(bpy.context.scene) == pytest.approx(60.0)


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".glb", ".abc", ".usda", ".usdc"])
def test_a_blink_of_a_frame_at_60_fps_is_not_lost(tmp_path, suffix):
    if suffix == ".usdc" and bpy.app.version < (4, 4, 0):
        pytest.skip("this version has no library to read the rate with")
    blinking_head()
    export(tmp_path / f"blink{suffix}")
    assert run("import", tmp_path / f"blink{suffix}", "-o", tmp_path / "take.facetake").returncode == 0
    take = load_take(tmp_path / "take.facetake")
    assert take.info["fps"] == pytest.approx(60.0) and float(take.times[1]) == pytest.approx(1 / 60, abs=1e-6)
    if suffix == ".glb":
        assert take.coefficients[:, COEFFICIENT_INDEX["eyeBlinkLeft"]].max() == pytest.approx(1.0, abs=1e-4)


def with_clips(head):
    """Two clips: Talk opens the jaw, and Smile smiles and turns the head."""
    keys = head.data.shape_keys
    for name, key in (("Talk", "jawOpen"), ("Smile", "mouthSmileLeft")):
        data, action = keys.animation_data_create(), bpy.data.actions.new(name)
        data.action = action
        for frame, value in ((1, 0.0), (LAST if name == "Smile" else 6, 0.8)):
            keys.key_blocks[key].value = value
            keys.key_blocks[key].keyframe_insert("value", frame=frame)
        keys.key_blocks[key].value = 0.0
        track = data.nla_tracks.new()
        track.name, data.action = name, None
        track.strips.new(name, 1, action)
    data, action = head.animation_data_create(), bpy.data.actions.new("Turn")
    data.action = action
    for frame, turn in ((1, 0.0), (LAST, 0.4)):
        head.rotation_euler.z = turn
        head.keyframe_insert("rotation_euler", frame=frame)
    track = data.nla_tracks.new()
    track.name, data.action = "Smile", None
    track.strips.new("Smile", 1, action)
    bpy.ops.object.select_all(action="SELECT")


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".glb", ".blend"])
def test_the_clips_of_a_file_are_named_and_can_be_chosen(tmp_path, suffix):
    if suffix == ".glb" and bpy.app.version[:2] != (4, 5):
        pytest.skip("the exporter of this version writes two clips wrongly, or not at all")
    head = add_head(bpy.context, units=True)
    with_clips(head)
    path, output = tmp_path / f"two{suffix}", tmp_path / "take.facetake"
    if suffix == ".blend":
        for owner in (head, head.data.shape_keys):
            owner.animation_data.nla_tracks["Smile"].mute = True
        bpy.context.scene.frame_end = LAST
        export(path)
    else:
        bpy.ops.export_scene.gltf(filepath=str(path), export_animation_mode="NLA_TRACKS")
    done = run("import", path, "-o", output)
    assert done.returncode == 0 and f"two{suffix} has further clips: " in done.stderr and "--clip NAME" in done.stderr
    for clip, key, other, turn, frames in (
        ("Talk", "jawOpen", "mouthSmileLeft", 0.0, 6),
        ("Smile", "mouthSmileLeft", "jawOpen", -0.4, LAST),
    ):
        done = run("import", path, "-o", output, "--clip", clip)
        assert done.returncode == 0 and "further clips" not in done.stderr
        take = load_take(output)
        assert take.coefficients[:, COEFFICIENT_INDEX[key]].max() == pytest.approx(0.8, abs=1e-3)
        assert take.coefficients[:, COEFFICIENT_INDEX[other]].max() == 0.0
        assert take.pose[-1, 2] == pytest.approx(turn, abs=2e-3) and abs(len(take) - frames) <= 1
    done = run("import", path, "-o", output, "--clip", "Walk")
    assert done.returncode == 1 and "There is no clip Walk. Choose one of: Smile, Talk." in done.stderr


def test_clips_of_separate_data_blocks_play_together_and_those_of_the_same_do_not():
    head = add_head(bpy.context, units=True)
    with_clips(head)
    keys = head.data.shape_keys
    head.animation_data.nla_tracks[0].name = "Turn"
    for owner in (head, keys):
        for track in owner.animation_data.nla_tracks:
            track.mute = True
    clips = clips_of(owners_of([head]))
    play_single(clips)
    assert {name for name, clip in clips.items() if clip.plays} == {"Turn"}
    keys.animation_data.nla_tracks.remove(keys.animation_data.nla_tracks["Smile"])
    play_single(clips_of(owners_of([head])))
    bpy.context.scene.frame_set(LAST)
    assert head.rotation_euler.z == pytest.approx(0.4) and keys.key_blocks["jawOpen"].value == pytest.approx(0.8)


def test_playing_a_clip_mutes_the_others():
    head = add_head(bpy.context, units=True)
    with_clips(head)
    owners = owners_of([head])
    clips = clips_of(owners)
    assert list(clips) == ["Smile", "Talk"] and clips["Talk"].plays and clips["Talk"].frames == (1, 6)
    play(clips, "Talk", owners)
    bpy.context.scene.frame_set(6)
    blocks = head.data.shape_keys.key_blocks
    assert blocks["jawOpen"].value == pytest.approx(0.8) and blocks["mouthSmileLeft"].value == 0.0
    play(clips, "Smile", owners)
    bpy.context.scene.frame_set(LAST)
    assert blocks["mouthSmileLeft"].value == pytest.approx(0.8) and head.rotation_euler.z == pytest.approx(0.4)
    with pytest.raises(HeadError, match="no clip Walk, nor any other"):
        play({}, "Walk", owners)


def avatar(path, *, version):
    """A VRM avatar whose morph targets have no names that are known."""
    head = add_head(bpy.context, units=True)
    head.name = "Avatar"
    for child in head.children:
        bpy.data.objects.remove(child)
    blocks = head.data.shape_keys.key_blocks
    for number, block in enumerate(blocks[1:]):
        block.name = f"morph {number}"
    for owner in (head, head.data):
        for key in list(owner.keys()):
            del owner[key]
    export(path)
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    node = next(i for i, node in enumerate(document["nodes"]) if "mesh" in node)
    places = {"A": ["jawOpen"], "Blink_L": ["eyeBlinkLeft"], "Blink_R": ["eyeBlinkRight"], "Joy": ["mouthSmileLeft"]}
    names = {"A": "aa", "Blink_L": "blinkLeft", "Blink_R": "blinkRight", "Joy": "happy"}
    if version == 0:
        groups = [
            {
                "presetName": name.lower(),
                "name": name,
                "binds": [{"mesh": 0, "index": COEFFICIENT_INDEX[unit], "weight": 50} for unit in units],
            }
            for name, units in places.items()
        ]
        document["extensions"] = {"VRM": {"blendShapeMaster": {"blendShapeGroups": groups}}}
    else:
        preset = {
            names[name]: {
                "morphTargetBinds": [{"node": node, "index": COEFFICIENT_INDEX[unit], "weight": 0.5} for unit in units]
            }
            for name, units in places.items()
        }
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "expressions": {"preset": preset}}}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


@pytest.mark.parametrize("version", [0, 1])
def test_an_avatar_has_a_shape_key_for_each_of_its_expressions(tmp_path, version):
    avatar(tmp_path / "a.vrm", version=version)
    open_file(tmp_path / "a.vrm")
    (obj,) = (obj for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys)
    blocks = obj.data.shape_keys.key_blocks
    jaw, whole = (blocks[name] for name in ("A" if version == 0 else "aa", f"morph {COEFFICIENT_INDEX['jawOpen']}"))
    basis, half, full = (np.array([point.co[:] for point in key.points]) for key in (blocks[0], jaw, whole))
    np.testing.assert_allclose(half - basis, 0.5 * (full - basis), atol=1e-6)
    assert jaw.value == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize("version", [0, 1])
def test_an_avatar_is_driven_by_its_own_expressions(tmp_path, version):
    avatar(tmp_path / "a.vrm", version=version)
    save_take(performance(), tmp_path / "take.facetake")
    files = (tmp_path / "take.facetake", "-o", tmp_path / "out.blend", "--head", tmp_path / "a.vrm")
    done = run("puppet", *files, "--neutral", "0")
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    keys = next(obj.data.shape_keys for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys)
    jaw = keys.key_blocks["A" if version == 0 else "aa"]
    shown = []
    for frame in range(1, 60, 4):
        bpy.context.scene.frame_set(frame)
        shown.append(jaw.value)
    assert np.ptp(shown) > 0.2
    assert not [key.name for key in keys.key_blocks if key.name.startswith("Facemime")]


def test_further_takes_of_an_fbx_file_which_blender_leaves_unassigned_can_be_played(tmp_path):
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones.new("Head").tail = (0.0, 0.0, 0.1)
    bpy.ops.object.mode_set(mode="OBJECT")
    bone, data = rig.pose.bones["Head"], rig.animation_data_create()
    bone.rotation_mode = "XYZ"
    for name, turn in (("Nod", 0.3), ("Shake", -0.3)):
        data.action = action = bpy.data.actions.new(name)
        for frame, angle in ((1, 0.0), (10, turn)):
            bone.rotation_euler.y = angle
            bone.keyframe_insert("rotation_euler", frame=frame)
        track = data.nla_tracks.new()
        track.name, data.action = name, None
        track.strips.new(name, 1, action)
    bpy.ops.export_scene.fbx(filepath=str(tmp_path / "two.fbx"), bake_anim_use_all_actions=False)
    open_file(tmp_path / "two.fbx")
    owners = owners_of(bpy.data.objects)
    clips = clips_of(owners)
    assert list(clips) == ["Nod", "Shake"] and sum(clip.plays for clip in clips.values()) == 1
    bone = bpy.data.objects["Rig"].pose.bones["Head"]
    for name, turn in (("Nod", 0.3), ("Shake", -0.3), ("Nod", 0.3)):
        play(clips, name, owners)
        bpy.context.scene.frame_set(clips[name].frames[1])
        assert bone.matrix_basis.to_euler().y == pytest.approx(turn, abs=1e-4)

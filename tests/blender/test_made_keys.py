"""Sets of shape keys made on a character, and characters that are driven by their shape keys alone."""

from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_keys import live_keys
from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.animation.puppet import TOLERANCE, puppet_head
from facemime.blender.characters import read_bones
from facemime.blender.heads.binding import bind_character, missing_parts
from facemime.blender.heads.expression_keys import make_expression_keys, making_expression_keys
from facemime.blender.heads.keyed import bind_keys
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import driven_by_keys, is_head
from facemime.blender.names import COUNT_PROPERTY, LANDMARKS_PROPERTY, PIVOT_PROPERTY, REGION_GROUPS
from facemime.blender.rigs import read_rig
from facemime.cli.character import draw_landmarks
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.errors import HeadError
from facemime.core.heads.rig import Part, neck_of
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.file import save_take
from facemime.operators.steps import in_background
from facemime.sessions.start import follow_settings, start_session
from facemime.settings import takes_store
from tests.helpers.characters import make_character
from tests.helpers.commands import run
from tests.helpers.live_ticks import wait_for
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")
MAPPED = PuppetSettings(bake=BakeSettings(keys="mapped"))


@pytest.fixture
def keyed(kept):
    """Make a character on an armature with a set of keys and nothing else of Facemime's."""

    def get(name: str = "arkit") -> dict[str, bpy.types.Object]:
        objects = {obj["role"]: obj for obj in kept(f"Keyed {name}", lambda: _keyed(name)) if "role" in obj}
        bpy.context.view_layer.objects.active = objects["head"]
        return objects

    return get


def _keyed(name: str) -> list[bpy.types.Object]:
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    make_expression_keys(head, KEY_SETS[name])
    for prop in (LANDMARKS_PROPERTY, COUNT_PROPERTY):
        del head.data[prop]
    for group in REGION_GROUPS:
        head.vertex_groups.remove(head.vertex_groups[group])
    for obj in objects.values():
        for prop in [prop for prop in dict(obj) if prop.startswith("facemime")]:
            del obj[prop]
        if (kinds := obj.data.attributes.get("facemime_part")) is not None:
            obj.data.attributes.remove(kinds)
    for role, obj in objects.items():
        obj["role"] = role
    return list(objects.values())


def values_at(head: bpy.types.Object, name: str, frames: range) -> np.ndarray:
    """Values of a key over frames."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(head.data.shape_keys.key_blocks[name].value)
    return np.array(found)


def own_keys(head: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    return list(head.data.shape_keys.key_blocks)[1:]


@pytest.mark.parametrize(
    ("name", "opens"),
    first_of([("vrm", "aa"), ("facegen", "Aah"), ("vrm0", "A"), ("oculus", "viseme_aa")], rows=True),
)
def test_a_set_of_keys_is_made_on_all_parts_detected_and_baked_to(name, opens):
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.make_expression_keys(keys=name) == {"FINISHED"}
    blocks = head.data.shape_keys.key_blocks
    assert tuple(blocks.keys()[1:]) == KEY_SETS[name].names
    assert opens in objects["teeth_lower"].data.shape_keys.key_blocks
    looks = [key for key in KEY_SETS[name].names if key.lower().startswith("look")]
    assert bool(looks) == (objects["eye_left"].data.shape_keys is not None)
    assert bpy.ops.facemime.detect_key_map() == {"FINISHED"}
    rows = bpy.context.scene.facemime_takes.bake.rows
    assert {row.key for row in rows} <= set(KEY_SETS[name].names) and len(rows) > 10
    assert puppet_head(bpy.context.scene, head, performance(), MAPPED).keys > 5
    assert np.ptp(values_at(head, opens, range(1, 60, 4))) > 0.05
    assert len(live_keys(head, "KEYS").offsets) > 5


@pytest.mark.thorough
def test_the_eyes_and_teeth_of_the_built_in_head_get_a_set_too():
    head = add_head(bpy.context)
    made = make_expression_keys(head, KEY_SETS["vrm"])
    assert made.added == 18 and not made.kept and len(made.qualities) == 18
    parts = {child["facemime_part"]: child.data.shape_keys for child in head.children}
    assert "lookUp" in parts["eye_left"].key_blocks and "aa" in parts["teeth_lower"].key_blocks
    assert parts["teeth_upper"] is None
    again = make_expression_keys(head, KEY_SETS["vrm"])
    assert again.added == 0 and len(again.kept) == 18 and not again.qualities and not again.findings


def test_keys_of_these_names_without_a_motion_are_filled(scan):
    head = scan
    head.shape_key_add(name="Basis", from_mix=False)
    _, own = (head.shape_key_add(name=name, from_mix=False) for name in ("jawOpen", "mouthClose"))
    own.points[0].co.x += 0.01
    places = np.empty(3 * len(own.points), np.float32)
    own.points.foreach_get("co", places)
    made = make_expression_keys(head, KEY_SETS["arkit"])
    assert made.added == 51 and made.kept == ("mouthClose",)
    keys = head.data.shape_keys
    assert len(keys.key_blocks) == 53
    rest, filled, kept = (np.empty_like(places) for _ in range(3))
    for name, out in ((keys.reference_key.name, rest), ("jawOpen", filled), ("mouthClose", kept)):
        keys.key_blocks[name].points.foreach_get("co", out)
    assert np.abs(filled - rest).max() > 1e-3
    np.testing.assert_array_equal(kept, places)


@pytest.mark.parametrize("name", first_of(["vrm", "arkit", "facegen"]))
def test_a_character_with_keys_is_bound_without_landmarks_and_baked_to(keyed, name):
    objects = keyed(name)
    assert bpy.ops.facemime.bind_keys() == {"FINISHED"}
    head = objects["head"]
    assert driven_by_keys(head) and not is_head(head) and missing_parts(head) == []
    armature, bones = read_bones(head)
    assert armature is not None and bones.head == "Head"
    unit = read_rig(head).eye_distance
    report = puppet_head(bpy.context.scene, head, performance(), MAPPED)
    assert np.isnan(report.worst_error) and report.summary().startswith(f"{report.keys} shape keys; ")
    assert np.abs(report.motion.vertices).max() > 0.05 * unit
    assert np.ptp(values_at(head, {"arkit": "jawOpen", "vrm": "aa", "facegen": "Aah"}[name], range(1, 60, 4))) > 0.05
    bpy.context.scene.frame_set(40)
    assert armature.pose.bones["Head"].matrix_basis.to_quaternion().angle > 0.01


@pytest.mark.parametrize(
    ("renamed", "others"),
    [
        ({"jawOpen": "Mouth Open", "eyeBlinkLeft": "Blink.L", "eyeBlinkRight": "Blink.R"}, ()),
        (
            {"jawOpen": "viseme_aa", "mouthFunnel": "viseme_O", "mouthPucker": "viseme_U"},
            ("eyeBlinkLeft", "eyeBlinkRight"),
        ),
    ],
    ids=["plain words", "two sets"],
)
def test_a_character_with_few_keys_is_driven_by_all_of_them(keyed, renamed, others):
    objects = keyed("arkit")
    for obj in objects.values():
        for key in own_keys(obj) if obj.type == "MESH" and obj.data.shape_keys else ():
            if key.name in renamed:
                key.name = renamed[key.name]
            elif key.name not in others:
                obj.shape_key_remove(key)
    assert bpy.ops.facemime.bind_keys() == {"FINISHED"}
    head, names = objects["head"], [*renamed.values(), *others]
    report = puppet_head(bpy.context.scene, head, performance())
    assert report.keys == len(names)
    # The lips hardly protrude in this performance.
    moved = [name for name in names if name not in ("viseme_O", "viseme_U")]
    assert all(np.ptp(values_at(head, name, range(1, 60))) > 0.05 for name in moved)


@pytest.mark.thorough
def test_a_character_bound_by_keys_is_baked_to_them_by_default(keyed):
    known, unknown = bind_keys(keyed()["head"]), make_character(rig=True)["head"]
    assert puppet_head(bpy.context.scene, known, performance()).summary().startswith("52 shape keys; ")
    assert values_at(known, "jawOpen", range(1, 60, 4)).max() > 0.1
    head, _ = bind_character(unknown)
    report = puppet_head(bpy.context.scene, head, performance())
    assert report.worst_error <= TOLERANCE + BakeSettings().clean and all(
        key.name.startswith("Facemime ") for key in own_keys(head)
    )


@pytest.mark.thorough
def test_the_size_and_neck_of_a_keyed_character_are_as_by_landmarks(keyed):
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    known = read_rig(head)
    unit, neck = known.eye_distance, neck_of(known.vertices[known.landmarks])
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    head = bind_keys(keyed()["tongue"])
    rig = read_rig(head)
    assert rig.eye_distance == pytest.approx(unit, rel=0.25)
    assert np.linalg.norm(neck_of(rig.vertices[rig.landmarks]) - neck) < 0.5 * unit
    assert PIVOT_PROPERTY in head and (rig.kinds[: len(head.data.vertices)] == Part.SKIN).all()


def test_a_character_bound_by_keys_is_driven_live_by_them_only(keyed, looping):
    head, scene = bind_keys(keyed()["head"]), bpy.context.scene
    session = start_session(scene, [head])
    blocks = head.data.shape_keys.key_blocks
    wait_for(lambda: session.step() and max(block.value for block in blocks[1:]) > 0.05)
    assert LIVE_KEY not in blocks
    scene.facemime.drive_by = "SKIN"
    with pytest.raises(HeadError, match="bound by its shape keys alone"):
        follow_settings(session, scene)
    session.close()


@pytest.mark.parametrize("keys", ["new", "named", "cache"])
def test_bakes_that_need_landmarks_report_it(keyed, keys):
    head = bind_keys(keyed()["head"])
    with pytest.raises(HeadError, match="bound by its shape keys alone"):
        puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys=keys)))


@pytest.mark.thorough
def test_the_face_of_a_keyed_character_can_be_found_later(keyed):
    objects = keyed()
    bind_keys(objects["head"])
    head, _ = bind_character(objects["head"])
    assert is_head(head) and not driven_by_keys(head)
    assert not np.isnan(puppet_head(bpy.context.scene, head, performance(), MAPPED).worst_error)


def test_a_mesh_without_known_keys_is_not_bound_by_them():
    objects = make_character(rig=True)
    with pytest.raises(HeadError, match="known set"):
        bind_keys(objects["head"])
    head = objects["head"]
    head.shape_key_add(name="Basis")
    for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "browInnerUp"):
        head.shape_key_add(name=name)
    with pytest.raises(HeadError, match="known set"):  # they move nothing
        bind_keys(head)


def test_a_face_without_landmarks_has_a_picture_too(keyed):
    picture = draw_landmarks(bpy.context.scene, bind_keys(keyed()["head"]), 64)
    assert picture.shape == (64, 64, 3) and np.ptp(picture) > 0


@pytest.mark.thorough
def test_commands_make_a_set_and_puppet_by_keys_alone(keyed, tmp_path):
    make_character(rig=True)
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "character.glb"))
    bound = tmp_path / "bound.blend"
    done = run("bind", tmp_path / "character.glb", "-o", bound, "--make-keys", "vrm")
    assert done.returncode == 0, done.stderr
    row = next(line.split() for line in done.stdout.splitlines() if line.startswith("blinkLeft "))
    assert len(row) == 4 and float(row[1]) > 5.0 and float(row[2]) < 10.0
    assert "18 shape keys added, 0 kept. Shut eyes stay open by" in done.stderr
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    objects = keyed()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "keyed.blend"))
    name = objects["head"].name
    save_take(performance(), tmp_path / "a.facetake")
    out = tmp_path / "out.blend"
    done = run("puppet", tmp_path / "a.facetake", "--head", tmp_path / "keyed.blend", "--keys", "mapped", "-o", out)
    assert done.returncode == 0 and f"{name} is driven by its shape keys alone." in done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert driven_by_keys(bpy.data.objects[name]) and not is_head(bpy.data.objects[name])


def key_names() -> dict[str, list[str]]:
    """Names of the shape keys of each mesh that has some, in order."""
    keyed = (obj for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys is not None)
    return {obj.name: list(obj.data.shape_keys.key_blocks.keys()) for obj in keyed}


@pytest.mark.thorough
@pytest.mark.parametrize("built_in", first_of([False, True]))
def test_fbx_keeps_the_names_and_order_of_made_keys_on_all_meshes(built_in, tmp_path):
    if built_in:
        head = add_head(bpy.context)
    else:
        objects = make_character(rig=True)
        objects["head"].modifiers.remove(objects["head"].modifiers["Subdivision"])
        head, _ = bind_character(objects["head"])
    make_expression_keys(head, KEY_SETS["arkit"])
    before = key_names()
    assert len(before) == (6 if built_in else 5) and before[head.name] == ["Basis", *KEY_SETS["arkit"].names]
    assert {tuple(sorted(names)) for names in before.values()} == {tuple(sorted(before[head.name]))}
    # With Apply Modifiers, Blender drops the keys of a mesh with other modifiers than Armature.
    bpy.ops.export_scene.fbx(filepath=str(tmp_path / "keys.fbx"), use_mesh_modifiers=not built_in)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.fbx(filepath=str(tmp_path / "keys.fbx"))
    assert key_names() == before


def offsets_of(head: bpy.types.Object, name: str) -> np.ndarray:
    """Displacements of the vertices by a key, (V, 3)."""
    keys = head.data.shape_keys
    points = [np.array([point.co for point in key.data]) for key in (keys.key_blocks[name], keys.reference_key)]
    return points[0] - points[1]


@pytest.mark.thorough
def test_takes_in_the_list_refine_arkits_keys_unless_that_is_off(kept, capsys):
    head = kept("Refined", lambda: [add_head(bpy.context)])[0]
    made = {}
    for refine in (False, True):
        takes_store.keep(bpy.context.scene, performance(), "Take")
        bpy.context.view_layer.objects.active = head
        assert bpy.ops.facemime.make_expression_keys(keys="arkit", refine=refine) == {"FINISHED"}
        assert ("; takes that refined them: " in capsys.readouterr().out) == refine
        made[refine] = {name: offsets_of(head, name) for name in ("jawOpen", "eyeBlinkLeft")}
        head.shape_key_clear()
    np.testing.assert_allclose(made[True]["eyeBlinkLeft"], made[False]["eyeBlinkLeft"], atol=1e-7)
    assert np.abs(made[True]["jawOpen"] - made[False]["jawOpen"]).max() > 1e-4


@pytest.mark.thorough
def test_a_take_that_is_missing_is_reported_and_the_keys_are_made_without_it(kept, capsys):
    head = kept("Missing", lambda: [add_head(bpy.context)])[0]
    path = Path(bpy.path.abspath(takes_store.keep(bpy.context.scene, performance(), "Take").path))
    path.unlink()
    bpy.context.view_layer.objects.active = head
    assert bpy.ops.facemime.make_expression_keys(keys="arkit") == {"FINISHED"}
    said = capsys.readouterr().out
    assert "is missing" in said and "52 shape keys added, 0 kept" in said and "refined" not in said


@pytest.mark.thorough
def test_the_command_refines_arkits_keys_by_takes_and_no_others(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "head.blend"))
    line = ("bind", str(tmp_path / "head.blend"), "-o", str(tmp_path / "out.blend"))
    line += ("--refine", str(tmp_path / "take.facetake"), "--make-keys")
    done = run(*line)
    assert done.returncode == 0 and "takes that refined them: 1" in done.stderr, done.stderr
    done = run(*line, "vrm")
    assert done.returncode == 1 and "Takes refine ARKit's keys alone" in done.stderr


def test_keys_are_made_in_a_thread_that_reports_its_progress_and_can_be_stopped(kept):
    head = kept("Progress", lambda: [add_head(bpy.context)])[0]
    stopped = in_background(making_expression_keys(head, KEY_SETS["vrm"]))
    assert 0.0 <= next(stopped) < 1.0
    stopped.close()
    assert head.data.shape_keys is None
    shares = list(in_background(making_expression_keys(head, KEY_SETS["vrm"])))
    assert shares == sorted(shares) and 0.0 < shares[-1] < 1.0 and len(set(shares)) > 2
    assert len(head.data.shape_keys.key_blocks) == 1 + len(KEY_SETS["vrm"].names)

"""A real FaceGen head: Jane, who ships with the extension."""

import shutil
from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from facemime.blender.characters import part_table, read_kinds
from facemime.blender.heads.binding import bind_head, check_object
from facemime.blender.heads.expression_keys import make_expression_keys
from facemime.blender.heads.facegen import add_facegen, import_facegen, parts_beside, prepare_facegen
from facemime.blender.heads.materials import mouth_material
from facemime.blender.heads.painted_eyes import has_painted_skin
from facemime.blender.meshes import key_offsets, key_points, read_landmarks, read_vertices
from facemime.blender.names import PART_PROPERTY
from facemime.blender.paint import read_paint
from facemime.blender.rigs import read_rig
from facemime.blender.surfaces import image_file
from facemime.core.drive.driver import drive_take
from facemime.core.face.landmarks import from_ibug, lid_gaps, outer_eye_distance
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.files.assets import ASSETS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.facegen import read_tri
from facemime.core.heads.rig import Part
from facemime.core.heads.tongues import tongue_of
from facemime.core.puppet.performer import Performance
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.takes import make_take

FOLDER = ASSETS / "facegen"
UPPER_LIDS, LOWER_LIDS = from_ibug((37, 38, 43, 44)), from_ibug((40, 41, 46, 47))


@pytest.fixture(scope="module")
def mesh():
    return read_tri(FOLDER / "Jane.tri")


def blinking():
    """A take of a second at rest, and one with shut eyes."""
    head = load_head()
    rest, blink = (
        head.vertices[head.landmarks].astype(float),
        [COEFFICIENT_INDEX[f"eyeBlink{s}"] for s in ("Left", "Right")],
    )
    shut = rest + head.units[blink][:, head.landmarks].sum(axis=0)
    return make_take(np.stack([*[rest] * 25, *[shut] * 25]) / outer_eye_distance(rest))


def test_she_is_added_ready_to_be_driven_with_eyes_that_turn():
    assert bpy.ops.facemime.add_head(person="FACEGEN") == {"FINISHED"}
    head = bpy.context.active_object
    assert head.name == "Jane" and check_object(head) == []
    assert {child.get(PART_PROPERTY) for child in head.children} >= {"eye_left", "eye_right"}
    assert {part for _, part, _ in part_table(head)} == {
        Part.SKIN,
        Part.ON_HEAD,
        Part.ON_SKIN,
        Part.TEETH_UPPER,
        Part.TEETH_LOWER,
    }
    rig = read_rig(head)
    assert len(rig.eyeballs) == 2
    take = blinking()
    performance = Performance.of(take, PuppetSettings(neutral=0.0))
    motion = drive_take(performance.driver(rig), performance.take)
    gaps = lid_gaps((rig.vertices + motion.vertices[-1, : len(rig.vertices)])[rig.landmarks])
    assert np.abs(gaps).max() < 0.07 * lid_gaps(rig.vertices[rig.landmarks]).min()
    assert all(image.packed_file is not None for image in bpy.data.images if image.users and image.source == "FILE")


def test_her_tongue_lies_low_in_a_dark_mouth_and_moves_in_her_keys_as_before():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (imported,) = [obj for obj in import_facegen(bpy.context, [FOLDER / "Jane.tri"]) if obj.name == "Mouth"]
    before = {key.name: key_points(key) for key in imported.data.shape_keys.key_blocks}
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    head = add_facegen(bpy.context)
    rig = read_rig(head)
    (mouth,) = [obj for obj in head.children if obj.name == "Mouth"]
    after = {key.name: key_points(key) for key in mouth.data.shape_keys.key_blocks}
    tongue = tongue_of(rig)[len(rig.vertices) :]
    lowered = (before["Basis"] - after["Basis"])[:, 2] / (rig.eye_distance)
    assert lowered[tongue].min() > 0.01 and lowered[tongue].max() < 0.4
    np.testing.assert_allclose(lowered[~tongue], 0.0, atol=1e-6)
    for name, points in before.items():
        moved, own = after[name] - after["Basis"], points - before["Basis"]
        np.testing.assert_allclose(moved, own, atol=1e-6)
    wall = read_kinds(mouth.data) == Part.ON_SKIN
    dark = [
        mouth.material_slots[polygon.material_index].material == mouth_material() for polygon in mouth.data.polygons
    ]
    assert dark == [bool(wall[polygon.vertices[0]]) for polygon in mouth.data.polygons] and any(dark)


def test_her_lids_are_found_in_her_own_colours_and_lie_where_her_blink_moves_them(mesh):
    (head,) = import_facegen(bpy.context, [FOLDER / "Jane.tri"], beside=False)
    assert read_paint(head) is not None
    bind_head(head)
    landmarks, blink = read_landmarks(head), np.zeros(len(mesh.vertices))
    for side in ("Left", "Right"):
        blink = np.maximum(blink, np.linalg.norm(dict(mesh.morphs)[f"Modifier: Blink {side}"], axis=1))
    assert np.median(blink[landmarks[UPPER_LIDS]]) > 0.5 * blink.max()
    assert blink[landmarks[LOWER_LIDS]].max() < 0.1 * blink.max()


def test_the_points_that_her_file_labels_are_near_the_landmarks_found(mesh):
    (head,) = import_facegen(bpy.context, [FOLDER / "Jane.tri"], beside=False)
    bind_head(head)
    places, landmarks = read_vertices(head.data), read_landmarks(head)
    for label, number in (("Nose Tip", 30), ("Exocanthion Right", 36), ("Mouth Corner Left", 54)):
        away = np.linalg.norm(places[mesh.labels[label]] - places[landmarks[from_ibug([number])[0]]])
        assert away < 0.12 * outer_eye_distance(places[landmarks]), label


def test_parts_and_texture_beside_a_head_are_imported_with_it(tmp_path):
    for name in ("Jane.tri", "Jane.jpg", "Mouth.tri", "Mouth.png", "Hair.tri"):
        shutil.copy(FOLDER / name, tmp_path / name)
    for name, of in (
        ("Glasses.tri", "Hair"),
        ("MouthSmall.tri", "Mouth"),
        ("teethUpper.tri", "Mouth"),
        ("Other.tri", "Jane"),
    ):
        shutil.copy(FOLDER / f"{of}.tri", tmp_path / name)
    assert bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "Jane.tri")) == {"FINISHED"}
    head = bpy.context.active_object
    assert sorted(child.name for child in head.children) == ["Hair", "Mouth"]
    images = {
        obj.name: any(node.type == "TEX_IMAGE" for node in obj.data.materials[0].node_tree.nodes)
        for obj in (head, *head.children)
    }
    assert images == {"Jane": True, "Mouth": True, "Hair": True}, "that of Jane's hair ships with the extension"
    names = [key.name for key in head.data.shape_keys.key_blocks]
    assert len(names) == 82 and not any(name.endswith(".001") for name in names)


@pytest.mark.thorough
def test_a_mouth_without_a_texture_has_light_teeth_and_a_dark_wall(tmp_path):
    for name, of in (("Head.tri", "Jane.tri"), ("Head.jpg", "Jane.jpg"), ("Inner Mouth.tri", "Mouth.tri")):
        shutil.copy(FOLDER / of, tmp_path / name)
    (tmp_path / "Head.jpg").write_bytes((FOLDER / "Jane.jpg").read_bytes() + b"\0")  # so that it is not Jane's
    objects = import_facegen(bpy.context, [tmp_path / "Head.tri"])
    bind_head(objects[0])
    assert prepare_facegen(objects[0])
    (mouth,) = [obj for obj in objects[0].children if obj.name == "Inner Mouth"]
    kinds = read_kinds(mouth.data)
    lightness = {
        kind: [
            np.mean(mouth.data.materials[polygon.material_index].diffuse_color[:3])
            for polygon in mouth.data.polygons
            if kinds[polygon.vertices[0]] == kind
        ]
        for kind in (Part.TEETH_UPPER, Part.TEETH_LOWER, Part.ON_SKIN)
    }
    assert min(lightness[Part.TEETH_UPPER]) > 0.5 and max(lightness[Part.TEETH_LOWER]) > 0.5
    assert 0.1 < min(lightness[Part.TEETH_LOWER]) < 0.4, "the tongue"
    assert max(lightness[Part.ON_SKIN]) < 0.1


def image_of(obj):
    (image,) = {node.image for node in obj.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"}
    return image


@pytest.mark.thorough
def test_a_copy_of_her_file_elsewhere_looks_as_she_does(tmp_path):
    for name in ("Jane.tri", "Jane.jpg", "Mouth.tri"):
        shutil.copy(FOLDER / name, tmp_path / name)
    objects = import_facegen(bpy.context, [tmp_path / "Jane.tri"])
    bind_head(objects[0])
    assert prepare_facegen(objects[0])
    own, built_in = (image_of(obj).packed_file.data for obj in (objects[0], add_facegen(bpy.context)))
    assert own == built_in
    assert Path(image_of(objects[1]).filepath).name == "Mouth.png"
    assert image_of(objects[1]).packed_file is not None, "a saved file does not need the extension"


@pytest.mark.parametrize("brightness", [1.6, pytest.param(1.0, marks=pytest.mark.thorough)])
def test_paint_around_the_eyes_of_a_head_becomes_skin_and_its_file_stays_as_it_is(tmp_path, brightness):
    painted = np.clip(cv2.imread(str(FOLDER / "Jane.jpg")).astype(np.float64) * brightness, 0, 255).astype(np.uint8)
    painted = cv2.resize(painted, (1024, 1024), interpolation=cv2.INTER_AREA)
    shutil.copy(FOLDER / "Jane.tri", tmp_path / "Head.tri")
    cv2.imwrite(str(tmp_path / "Head.png"), painted)
    before = (tmp_path / "Head.png").read_bytes()
    (head,) = import_facegen(bpy.context, [tmp_path / "Head.tri"])
    bind_head(head)
    assert has_painted_skin(head)
    assert bpy.ops.facemime.open_eyes(eyeballs=True) == {"FINISHED"}
    assert len(read_rig(head).eyeballs) == 2
    shown = cv2.imdecode(np.frombuffer(image_file(image_of(head)), np.uint8), cv2.IMREAD_COLOR)
    changed = np.abs(shown.astype(int) - painted).max(axis=2) > 40
    assert 0.0005 < changed.mean() < 0.02
    assert (painted[changed].mean(axis=1) < 0.75 * shown[changed].mean(axis=1)).mean() > 0.5, "most was make-up"
    assert (tmp_path / "Head.png").read_bytes() == before and image_of(head).packed_file is not None


@pytest.mark.thorough
def test_the_wall_of_her_mouth_stays_within_her_face_in_all_keys_that_are_made():
    head = add_facegen(bpy.context)
    make_expression_keys(head)
    (mouth,) = [child for child in head.children if child.name.startswith("Mouth")]
    wall, keys = read_kinds(mouth.data) == Part.ON_SKIN, mouth.data.shape_keys.key_blocks
    for name in set(COEFFICIENT_INDEX) & set(keys.keys()):
        of_skin = head.data.shape_keys.key_blocks[name]
        skin, inside = (np.linalg.norm(key_offsets(key), axis=1) for key in (of_skin, keys[name]))
        assert inside[wall].max() < 1.5 * skin.max() + 1e-5, name


def test_several_files_are_imported_at_once(tmp_path):
    files = [{"name": name} for name in ("Hair.tri", "Jane.tri")]
    assert bpy.ops.facemime.import_facegen(filepath=str(FOLDER / "Hair.tri"), directory=str(FOLDER), files=files) == {
        "FINISHED"
    }
    assert bpy.context.active_object.name == "Jane"
    assert [child.name for child in bpy.context.active_object.children] == ["Hair"]


def test_a_face_of_331_vertices_is_found_in_its_colours():
    folder = Path(__file__).parents[1] / "data" / "facegen"
    (face,) = import_facegen(bpy.context, [folder / "JaneLoresFace.tri"])
    binding = bind_head(face)
    points = read_vertices(face.data)[read_landmarks(face)]
    assert binding.clarity > 0.6 and len(set(read_landmarks(face))) == 66
    assert lid_gaps(points).min() > 0.05 * outer_eye_distance(points)


def test_parts_alone_stand_by_themselves_and_a_hat_is_no_word_within_another(tmp_path):
    shutil.copy(FOLDER / "Jane.tri", tmp_path / "Head.tri")
    for name in ("What Hair.tri", "Hat Hair.tri"):
        shutil.copy(FOLDER / "Hair.tri", tmp_path / name)
    objects = import_facegen(bpy.context, [FOLDER / "Mouth.tri", FOLDER / "Hair.tri"])
    assert [obj.parent for obj in objects] == [None, None]
    assert parts_beside(tmp_path / "Head.tri") == [tmp_path / "What Hair.tri"]

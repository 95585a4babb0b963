"""Any object of a character leads to its face, whatever an importer or the user has selected."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.family import character_in, face_candidates, heads_of, known_keys
from facemime.blender.heads.new_heads import add_head
from facemime.blender.heads.placing import FormerBinding
from facemime.blender.meshes import is_head, read_landmarks
from facemime.blender.names import PART_PROPERTY, REGION_GROUPS
from facemime.core.errors import HeadError
from facemime.operators.own_head import FACEMIME_OT_bind_landmarks
from facemime.operators.shared import chosen_character, heads_in, subject
from tests.helpers.characters import make_character, shown
from tests.helpers.thorough import first_of


def select(*objects: bpy.types.Object, active: bpy.types.Object | None = None) -> None:
    bpy.context.view_layer.update()
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = active


def default_objects() -> None:
    """The cube, light and camera with which Blender starts."""
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.light_add(location=(4.0, 1.0, 6.0))
    bpy.ops.object.camera_add(location=(7.0, -7.0, 5.0))


@pytest.fixture
def character() -> dict[str, bpy.types.Object]:
    """A rigged character with a name for its face, below an empty, in the default scene."""
    default_objects()
    objects = make_character(rig=True)
    objects["head"].name = "Hero_Head"
    objects["armature"] = objects["head"].parent
    objects["empty"] = bpy.data.objects.new("Hero", None)
    bpy.context.scene.collection.objects.link(objects["empty"])
    objects["armature"].parent = objects["empty"]
    return objects


@pytest.mark.parametrize("start", ["armature", "empty", "body", "eye_left", "head"])
def test_every_object_of_a_character_leads_to_its_face(character, start):
    select(character[start], active=character[start])
    assert face_candidates(chosen_character(bpy.context))[0] == character["head"]
    assert FACEMIME_OT_bind_landmarks.poll(bpy.context)


@pytest.mark.parametrize("start", first_of(["armature", "body", "head"]))
def test_a_face_on_a_mesh_that_is_named_after_the_body_is_found(character, start):
    character["head"].name, character["body"].name = "Hero_Body", "Hero_Robe"
    assert bind_character(character[start])[0] == character["head"]


def test_a_head_beside_a_body_comes_first_unless_nothing_says_that_it_is_one(character):
    character["body"].name = "Hero_Body"
    assert face_candidates(character["body"])[:2] == [character["head"], character["body"]]
    character["head"].name = "Hero_Mesh_7"
    assert face_candidates(character["body"])[0] == character["body"]
    assert face_candidates(character["armature"])[0] == character["head"]


def test_the_selection_of_an_importer_leads_to_the_face(character):
    select(*character.values(), active=character["armature"])
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    assert bpy.context.active_object == character["head"] and bpy.context.selected_objects == [character["head"]]
    for start in ("armature", "empty", "body"):
        select(character[start], active=character[start])
        assert heads_in(bpy.context) == [character["head"]] and subject(bpy.context) == character["head"]


def test_with_nothing_selected_the_only_character_is_found(character):
    select(active=bpy.data.objects["Cube"])
    assert face_candidates(character_in(bpy.context))[0] == character["head"]
    select(bpy.data.objects["Point"], active=bpy.data.objects["Point"])
    assert face_candidates(character_in(bpy.context))[0] == character["head"]


@pytest.mark.parametrize("hidden", first_of(["collection", "excluded", "eye", "viewport"], 2))
@pytest.mark.parametrize("by", first_of(["landmarks", "keys"]))
def test_with_nothing_selected_a_hidden_character_is_found_and_shown(character, hidden, by):
    place = bpy.data.collections.new("Cast")
    bpy.context.scene.collection.children.link(place)
    for obj in character.values():
        obj.users_collection[0].objects.unlink(obj)
        place.objects.link(obj)
    if by == "keys":
        character["head"].shape_key_add(name="Basis")
        for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft"):
            character["head"].shape_key_add(name=name, from_mix=False).points[0].co.z += 0.01
    select()
    bpy.context.view_layer.objects.active = None
    layer = bpy.context.view_layer.layer_collection.children["Cast"]
    if hidden == "collection":
        layer.hide_viewport = True
    elif hidden == "excluded":
        layer.exclude = True
    for obj in character.values():
        if hidden == "eye":
            obj.hide_set(True)
        obj.hide_viewport = hidden == "viewport"
    assert {"landmarks": bpy.ops.facemime.bind_landmarks, "keys": bpy.ops.facemime.bind_keys}[by]() == {"FINISHED"}
    assert heads_in(bpy.context) == [character["head"]] and bpy.context.selected_objects == [character["head"]]
    assert all(obj.visible_get() for obj in character.values())


def test_a_character_in_sight_comes_before_a_hidden_one(character):
    for obj in character.values():
        obj.hide_set(True)
    select()
    other = make_character(rig=True)
    select()
    assert face_candidates(character_in(bpy.context))[0] == other["head"]


def test_of_two_characters_the_selected_one_is_found(character):
    other = make_character(rig=True)
    other["head"].name = "Villain_Head"
    select()
    assert character_in(bpy.context) is None
    for one in (character, other):
        armature = one["head"].parent
        select(armature, active=armature)
        assert face_candidates(chosen_character(bpy.context))[0] == one["head"]


def test_two_characters_below_one_object_are_kept_apart(character):
    other = make_character(rig=True)
    other["head"].name = "Villain_Head"
    other["head"].parent.parent = character["empty"]
    for one in (character, other):
        select(one["body"], active=one["body"])
        assert face_candidates(chosen_character(bpy.context))[0] == one["head"]
        assert set(face_candidates(one["head"].parent)).isdisjoint({character["head"], other["head"]} - {one["head"]})


def test_an_empty_scene_and_lights_lead_to_no_character():
    assert chosen_character(bpy.context) is None
    bpy.ops.object.light_add()
    assert chosen_character(bpy.context) is None and not FACEMIME_OT_bind_landmarks.poll(bpy.context)
    with pytest.raises(HeadError, match="belongs to no mesh"):
        bind_character(bpy.data.objects["Point"])


def test_an_instance_of_a_collection_says_how_to_make_it_real():
    collection = bpy.data.collections.new("Hero")
    empty = bpy.data.objects.new("Hero", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(HeadError, match="Make Instances Real"):
        bind_character(empty)


def test_the_only_head_is_driven_unless_another_character_is_selected(character):
    head = add_head(bpy.context)
    select(bpy.data.objects["Cube"], active=bpy.data.objects["Cube"])
    assert heads_in(bpy.context) == [head]
    select(character["armature"], active=character["armature"])
    assert heads_in(bpy.context) == []
    assert heads_of(head.children) == [head]


def test_keys_that_move_any_mesh_of_a_character_are_recognised(character):
    character["head"].shape_key_add(name="Basis")
    for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight"):
        key = character["head"].shape_key_add(name=name, from_mix=False)
        key.data[0].co.z += 0.0 if name == "mouthSmileRight" else 0.01
    for start in ("armature", "body", "eye_left"):
        assert known_keys(character[start]).short_name == "ARKit" and len(known_keys(character[start]).keys) == 4


@pytest.mark.parametrize("y_up", [False, True])
def test_a_binding_that_is_taken_back_leaves_the_character_as_it_was(y_up):
    objects = make_character(rig=True, y_up=y_up)
    select(objects["head"], active=objects["body"])
    before = {name: (shown(obj), dict(obj), dict(obj.data)) for name, obj in objects.items()}
    former = FormerBinding(bpy.context)
    head, _ = bind_character(objects["head"])
    assert is_head(head)
    former.restore(bpy.context)
    bpy.context.view_layer.update()
    for name, obj in objects.items():
        places, own, of_mesh = before[name]
        np.testing.assert_allclose(shown(obj), places, atol=1e-5)
        assert dict(obj) == own and dict(obj.data) == of_mesh and PART_PROPERTY not in obj.data.attributes
    assert not any(name in objects["head"].vertex_groups for name in REGION_GROUPS)
    assert bpy.context.selected_objects == [objects["head"]] and bpy.context.active_object == objects["body"]


def test_taking_back_a_second_binding_restores_the_first_one():
    objects = make_character(rig=True)
    head, _ = bind_character(objects["head"])
    landmarks, weights = read_landmarks(head), [group.name for group in head.vertex_groups]
    former = FormerBinding(bpy.context)
    head.data["facemime_landmarks"] = landmarks[::-1].tolist()
    former.restore(bpy.context)
    np.testing.assert_array_equal(read_landmarks(head), landmarks)
    assert [group.name for group in head.vertex_groups] == weights


def test_of_loose_meshes_that_an_importer_has_selected_the_head_leads_to_the_face():
    objects = make_character(rig=False)
    for name, obj in objects.items():
        obj.name = {"head": "Wolf3D_Head", "body": "Wolf3D_Outfit_Top"}.get(name, name)
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects["teeth_lower"]
    assert character_in(bpy.context) == objects["head"]
    bpy.context.view_layer.objects.active = objects["body"]
    assert character_in(bpy.context) == objects["head"]

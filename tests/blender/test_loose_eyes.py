"""Eyes that are separate objects look where the performer does, and stay in a head that turns."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from facemime.blender.animation.bake import remove_baked
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.targets import own_targets
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.expression_keys import make_expression_keys
from facemime.blender.heads.keyed import bind_keys
from facemime.blender.names import COUNT_PROPERTY, LANDMARKS_PROPERTY, PIVOT_PROPERTY
from facemime.cli.character_files import bound_by_keys
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.operators import own_head
from tests.helpers.characters import make_character, shown, turn_between
from tests.helpers.takes import coefficient_take, performance

pytestmark = pytest.mark.usefixtures("nothing_left_over")
MAPPED = PuppetSettings(bake=BakeSettings(keys="mapped"))
EYES = ("eye_left", "eye_right")


def _character() -> list[bpy.types.Object]:
    """Make a character without bones whose skin has ARKit's keys and whose eyes have none."""
    objects = make_character(rig=False)
    bpy.data.objects.remove(objects.pop("body"))
    head, _ = bind_character(objects["head"])
    make_expression_keys(head, KEY_SETS["arkit"])
    for prop in (LANDMARKS_PROPERTY, COUNT_PROPERTY):
        del head.data[prop]
    for role, obj in objects.items():
        for prop in [prop for prop in dict(obj) if prop.startswith("facemime")]:
            del obj[prop]
        if (kinds := obj.data.attributes.get("facemime_part")) is not None:
            obj.data.attributes.remove(kinds)
        if role in EYES:
            obj.shape_key_clear()
        obj["role"] = role
    return list(objects.values())


@pytest.fixture
def character(kept):
    """The objects of that character by their roles, below an empty."""
    objects = {obj["role"]: obj for obj in kept("Loose Eyes", _character) if "role" in obj}
    root = bpy.data.objects.new("root", None)
    bpy.context.scene.collection.objects.link(root)
    for obj in objects.values():
        obj.parent = root
    return objects


def relative(head: bpy.types.Object, obj: bpy.types.Object) -> np.ndarray:
    """Where the vertices of an object are in the axes of the head."""
    places = shown(obj)
    back = np.array(head.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world.inverted())
    return places @ back[:3, :3].T + back[:3, 3]


def turns(head: bpy.types.Object, eye: bpy.types.Object, frames: range) -> np.ndarray:
    """Angles by which an eye turns in the head, over frames, radians."""
    rest = relative(head, eye)
    angles = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        cosine = (np.trace(turn_between(rest, relative(head, eye))) - 1.0) / 2.0
        angles.append(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.array(angles)


def test_separate_eyes_without_keys_look_with_the_keys_of_the_face(character):
    head = bind_keys(character["head"])
    assert head == character["head"]
    puppet_head(bpy.context.scene, head, coefficient_take(), MAPPED)
    assert turns(head, character["eye_left"], range(1, 16, 2)).max() > 0.15
    assert turns(head, character["eye_right"], range(1, 16, 2)).max() < 0.02  # the take moves the left one alone


def test_eyes_that_a_bone_or_their_own_keys_turn_get_no_keys(character):
    character["eye_left"].shape_key_add(name="Basis", from_mix=False)
    own = character["eye_left"].shape_key_add(name="eyeLookInLeft", from_mix=False)
    for point in own.points:
        point.co.x += 0.01
    bind_keys(character["head"])
    assert len(character["eye_left"].data.shape_keys.key_blocks) == 2
    assert "eyeLookUpRight" in character["eye_right"].data.shape_keys.key_blocks


def put_below_a_turning_parent(eye: bpy.types.Object) -> bpy.types.Object:
    """Give an eye a parent in its middle that a recording turns, as the files of captures have."""
    holder = bpy.data.objects.new(f"{eye.name} Group", None)
    bpy.context.scene.collection.objects.link(holder)
    holder.parent = eye.parent
    holder.location = shown(eye).mean(axis=0).tolist()
    bpy.context.view_layer.update()
    eye.parent, eye.matrix_parent_inverse = holder, holder.matrix_world.inverted()
    for frame, angle in ((1, 0.0), (20, 0.4), (40, -0.4)):
        holder.rotation_euler.z = angle
        holder.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_set(1)
    return holder


def test_eyes_below_parents_of_their_own_that_a_recording_turns_stay_in_the_head(character):
    eye = character["eye_left"]
    holder = put_below_a_turning_parent(eye)
    head = bind_keys(character["head"])
    bpy.context.view_layer.update()
    rest = relative(head, eye).mean(axis=0)
    report = puppet_head(bpy.context.scene, head, performance(), MAPPED)
    assert any("Muted" in note and "rotation_euler" in note for note in report.notes)
    for frame in (20, 35, 50):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(relative(head, eye).mean(axis=0), rest, atol=1e-3)
    remove_baked(head, own_targets(head))
    bpy.context.scene.frame_set(20)
    assert holder.rotation_euler.z == pytest.approx(0.4)


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_a_head_in_any_unit_turns_about_its_neck(character, size):
    for obj in character.values():  # the same place in the scene, with a far origin
        placed = Matrix.Translation((0.0, 3.0, -5.0)) @ Matrix.Scale(size, 4)
        obj.data.transform(placed.inverted(), shape_keys=True)
        obj.matrix_world = placed
    bpy.context.view_layer.update()
    head = bind_keys(character["head"])
    neck = Vector(head[PIVOT_PROPERTY])
    rest = head.matrix_world @ neck
    bake = BakeSettings(keys="mapped", whole_frames=True)
    puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=bake))
    for frame in range(25, 60, 3):
        bpy.context.scene.frame_set(frame)
        for obj in (head, character["teeth_upper"]):
            assert (obj.matrix_world @ neck - rest).length < 0.002


def keys_of_eyes(character: dict[str, bpy.types.Object]) -> list[list[str]]:
    """Names of the keys of both eyes."""
    found = (character[role].data.shape_keys for role in EYES)
    return [[] if keys is None else [key.name for key in keys.key_blocks] for keys in found]


def test_keys_that_are_added_to_eyes_are_told_and_taken_back_with_the_binding(character, capsys):
    own = character["eye_right"]
    own.shape_key_add(name="Basis", from_mix=False)
    own.shape_key_add(name="blinking", from_mix=False)
    before = keys_of_eyes(character)
    head = bound_by_keys(character["head"])
    assert all("eyeLookUpLeft" in names or "eyeLookUpRight" in names for names in keys_of_eyes(character))
    told = capsys.readouterr().err
    assert "turn the eyes" in told and all(character[role].name in told for role in EYES)
    bind_character(head)
    assert keys_of_eyes(character) == before


def test_the_operator_and_a_bake_tell_of_keys_that_they_add_to_eyes_and_animated_ones_stay(character):
    head = character["head"]
    bpy.context.view_layer.objects.active = head
    reports = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(own_head, "report", lambda _, text, *__, **values: reports.append(text.format(**values)))
        assert bpy.ops.facemime.bind_keys() == {"FINISHED"}
    assert any("turn the eyes" in text and character["eye_left"].name in text for text in reports)
    key = character["eye_left"].data.shape_keys.key_blocks["eyeLookUpLeft"]
    key.keyframe_insert("value", frame=1)
    bind_character(head)
    assert keys_of_eyes(character) == [["Basis", "eyeLookUpLeft"], []]
    report = puppet_head(bpy.context.scene, head, coefficient_take(), MAPPED)
    assert any("turn the eyes" in note for note in report.notes)
    report = puppet_head(bpy.context.scene, head, coefficient_take(), MAPPED)
    assert not any("turn the eyes" in note for note in report.notes)

"""Of the levels of detail of a character, the finest is driven, and copies in the same place are hidden."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from facemime.blender.characters import objects_of
from facemime.blender.heads.family import family_of, known_keys, require_character
from facemime.blender.heads.levels import is_copy, level_of, without_copies
from facemime.blender.heads.placing import FormerBinding
from facemime.blender.meshes import is_head
from tests.blender.test_chosen_character import select
from tests.helpers.characters import make_character
from tests.helpers.commands import run
from tests.helpers.thorough import first_of


def copy_of(obj: bpy.types.Object, name: str) -> bpy.types.Object:
    copy = obj.copy()
    copy.data = obj.data.copy()
    copy.name = name
    copy.animation_data_clear()  # the built-in head, of which it is made, drives what is hidden
    bpy.context.scene.collection.objects.link(copy)
    return copy


@pytest.fixture
def levels() -> dict[int, list[bpy.types.Object]]:
    """Three levels of detail of all meshes of a rigged character, as games have them."""
    meshes = list(make_character(rig=True).values())
    names = [obj.name for obj in meshes]
    found = {n: [copy_of(obj, f"{name}_LOD{n}") for obj, name in zip(meshes, names, strict=True)] for n in (1, 2)}
    for obj, name in zip(meshes, names, strict=True):
        obj.name = f"{name}_LOD0"
    return {0: meshes, **found}


def bind(*selected: bpy.types.Object, active: bpy.types.Object) -> bpy.types.Object:
    select(*selected, active=active)
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    return bpy.context.active_object


def test_keys_of_the_finest_level_are_known_from_each_level(levels):
    head = levels[0][0]
    head.shape_key_add(name="Basis")
    for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight", "browInnerUp"):
        head.shape_key_add(name=name, from_mix=False).points[0].co.z += 0.01
    assert all(known_keys(group[1]) is not None for group in levels.values())


@pytest.mark.parametrize("active", first_of([0, 2]))
def test_the_finest_level_is_bound_and_the_others_are_hidden(levels, active):
    everything = [obj for group in levels.values() for obj in group]
    head = bind(*everything, active=levels[active][0])
    assert head in levels[0] and [obj for obj in everything if is_head(obj)] == [head]
    for number, group in levels.items():
        assert [obj.visible_get() for obj in group] == [number == 0] * len(group)
        assert [obj.hide_render for obj in group] == [number > 0] * len(group)


def test_a_level_is_bound_whose_finer_ones_are_hidden(levels):
    for obj in levels[0]:
        obj.hide_set(True)
    head = bind(*levels[1], *levels[2], active=levels[2][0])
    assert head in levels[1]
    assert not any(obj.visible_get() for obj in levels[2])


@pytest.mark.thorough
def test_a_level_that_is_a_head_already_stays_one(levels):
    head = levels[1][0]
    for obj in levels[0]:
        obj.hide_set(True)
    assert bind(head, active=head) == head
    for obj in levels[0]:
        obj.hide_set(False)
    assert require_character(head) == head and not set(family_of(head)) & {*levels[0], *levels[2]}
    assert bind(head, active=head) == head


def test_parts_of_different_levels_that_are_no_copies_stay(levels):
    for obj in [*levels[2], *levels[0][1:], levels[1][0]]:
        bpy.data.objects.remove(obj)
    rest = [levels[0][0], *levels[1][1:]]
    assert set(family_of(rest[0])) == set(rest)


@pytest.mark.parametrize("by", ["parent", "collection"])
def test_levels_are_told_by_the_names_of_groups(levels, by):
    for number, group in levels.items():
        parent = bpy.data.objects.new(f"LOD_{number}" if by == "parent" else "Game", None)
        place = bpy.data.collections.new(f"LOD_{number}" if by == "collection" else "Game")
        bpy.context.scene.collection.children.link(place)
        place.objects.link(parent)
        for obj in group:
            obj.name = obj.name.replace(f"_LOD{number}", "")
            obj.users_collection[0].objects.unlink(obj)
            place.objects.link(obj)
            if by == "parent":
                obj.parent = parent
    assert [level_of(group[0]) for group in levels.values()] == [(level_of(levels[0][0])[0], n) for n in (0, 1, 2)]
    assert set(family_of(levels[0][0])) == set(levels[0])


def test_levels_with_armatures_of_their_own_are_hidden_as_a_whole(levels):
    for group in (levels[1], levels[2]):
        armature = copy_of(levels[0][0].parent, "Armature")
        for obj in group:
            obj.parent = armature
            for modifier in obj.modifiers:
                if modifier.type == "ARMATURE":
                    modifier.object = armature
    head = bind(levels[0][0], active=levels[0][0])
    assert head in levels[0]
    for number, group in levels.items():
        assert [obj.visible_get() for obj in group] == [number == 0] * len(group)


def test_another_character_in_the_same_place_with_the_same_names_is_no_level():
    ours, others = make_character(rig=True), make_character(rig=True)
    for objects, end in ((ours, ""), (others, ".001")):
        for key in ("head", "body"):
            objects[key].name = f"{key}_LOD0{end}"
    assert not set(family_of(ours["head"])) & set(others.values())
    head = bind(ours["head"], active=ours["head"])
    assert head == ours["head"] and all(obj.visible_get() for obj in others.values())


def coarser(obj: bpy.types.Object, ratio: float, name: str) -> bpy.types.Object:
    """A copy with a share of the faces, as another program makes it."""
    copy = copy_of(obj, name)
    modifier = copy.modifiers.new("Coarser", "DECIMATE")
    modifier.ratio = ratio
    select(copy, active=copy)
    copy.modifiers.move(len(copy.modifiers) - 1, 0)
    bpy.ops.object.modifier_apply(modifier="Coarser")
    return copy


@pytest.mark.parametrize("by", ["face", "keys"])
def test_coarser_copies_of_a_face_without_names_are_hidden(by):
    meshes = make_character(rig=True)
    head = meshes["head"]
    head.modifiers.clear()
    meshes["head"].modifiers.new("Armature", "ARMATURE").object = head.parent
    copies = [coarser(head, 0.5, "Aa"), coarser(head, 0.2, "Zz")]
    if by == "keys":
        head.shape_key_add(name="Basis")
        for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight", "browInnerUp"):
            head.shape_key_add(name=name, from_mix=False).points[0].co.z += 0.01
    assert all(is_copy(copy, head) and not is_copy(head, copy) for copy in copies)
    everything = [*meshes.values(), *copies]
    select(*everything, active=head.parent)
    assert (bpy.ops.facemime.bind_landmarks if by == "face" else bpy.ops.facemime.bind_keys)() == {"FINISHED"}
    assert bpy.context.active_object == head
    assert all(obj.visible_get() == (obj not in copies) for obj in everything)
    assert not set(copies) & set(objects_of(head))


def test_a_finer_copy_without_shape_keys_does_not_take_the_place_of_a_face_with_them():
    head = make_character(rig=True)["head"]
    coarse = coarser(head, 0.5, "Coarse")
    assert is_copy(coarse, head)
    coarse.shape_key_add(name="Basis")
    coarse.shape_key_add(name="jawOpen", from_mix=False)
    assert is_copy(head, coarse) and not is_copy(coarse, head)
    assert without_copies([head, coarse]) == [coarse]


def test_an_outline_around_a_face_is_no_copy_of_it():
    head = make_character(rig=True)["head"]
    outline = copy_of(head, "Outline")
    outline.data.flip_normals()
    assert not is_copy(outline, head)


def test_clothes_on_a_body_are_no_copy_of_it():
    meshes = make_character(rig=True)
    clothes = copy_of(meshes["body"], "Suit")
    for vertex in clothes.data.vertices:
        vertex.co *= 1.05
    bpy.context.view_layer.update()
    assert not is_copy(clothes, meshes["body"])


def test_cancelling_shows_hidden_levels_again(levels):
    former = FormerBinding(bpy.context)
    bind(levels[0][0], active=levels[0][0])
    former.restore(bpy.context)
    assert all(obj.visible_get() and not obj.hide_render for group in levels.values() for obj in group)


@pytest.mark.thorough
def test_the_command_says_which_levels_it_hides(levels, tmp_path: Path):
    file = tmp_path / "levels.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    done = run("bind", file, "-o", tmp_path / "bound.blend")
    assert done.returncode == 0 and "other levels of detail in the same place: " in done.stderr
    assert f"head: {levels[0][0].name}," in done.stdout
    done = run("bind", f"{file}:{levels[1][0].name}", "-o", tmp_path / "bound.blend")
    assert done.returncode == 0 and f"head: {levels[1][0].name}," in done.stdout, "the user named it"

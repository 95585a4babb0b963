"""Eyes, teeth and tongue stay with their head, whatever is done to it."""

import bpy
import pytest

from facemime.blender.characters import parts_of
from facemime.blender.heads.attached import attach
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import PART_OBJECTS, PART_PROPERTY, PARTS_PROPERTY
from facemime.operators import attached_parts
from facemime.operators.attached_parts import attend

COUNT = len(PART_OBJECTS)


@pytest.fixture
def head():
    """The built-in head, selected, in an undo step."""
    head = add_head(bpy.context)
    update()
    bpy.ops.ed.undo_push(message="head")
    return head


def update():
    """Update the scene, and let the timer do its work."""
    bpy.context.view_layer.update()
    attend()
    bpy.context.view_layer.update()


def run(operator, **options):
    """Run an operator as the user does, with its undo step."""
    assert operator("EXEC_DEFAULT", True, **options) == {"FINISHED"}
    update()


def hide(head):
    """Hide the head as the key H does, in an undo step."""
    head.hide_set(True)
    bpy.ops.ed.undo_push(message="Hide Objects")
    update()


def parts():
    return [obj for obj in bpy.data.objects if PART_PROPERTY in obj]


def seen():
    """Objects that are visible, by name."""
    return sorted(obj.name for obj in bpy.context.view_layer.objects if obj.visible_get())


def test_deleting_a_head_deletes_its_parts_in_one_undo_step(head):
    run(bpy.ops.object.delete)
    assert not len(bpy.data.objects)
    bpy.ops.ed.undo()
    update()
    assert len(seen()) == COUNT + 1 and len(parts_of(bpy.data.objects["Facemime Head"])) == COUNT
    bpy.ops.ed.redo()
    update()
    assert not len(bpy.data.objects)
    bpy.ops.ed.undo()
    assert len(bpy.data.objects) == COUNT + 1


def test_deleting_everything_leaves_no_parts_in_the_file(head):
    bpy.ops.object.select_all(action="SELECT")
    run(bpy.ops.object.delete)
    assert not len(bpy.data.objects)


def test_a_part_that_the_user_deletes_stays_deleted(head):
    bpy.ops.object.select_all(action="DESELECT")
    bpy.data.objects["Tongue"].select_set(True)
    run(bpy.ops.object.delete)
    assert len(seen()) == COUNT and "Tongue" not in bpy.data.objects
    bpy.ops.ed.undo()
    update()
    assert "Tongue" in seen()


def test_a_part_that_was_unparented_stays(head):
    bpy.ops.object.select_all(action="DESELECT")
    bpy.data.objects["Tongue"].select_set(True)
    run(bpy.ops.object.parent_clear)
    assert "Tongue" in seen()


@pytest.mark.parametrize("linked", [False, True])
def test_a_duplicate_of_a_head_has_parts_of_its_own(head, linked):
    run(bpy.ops.object.duplicate, linked=linked)
    copy = bpy.data.objects["Facemime Head.001"]
    assert set(parts_of(copy)) == set(PART_OBJECTS) and len(parts()) == 2 * COUNT
    for key, part in parts_of(copy).items():
        assert part.parent == copy and (part.data == parts_of(head)[key].data) == linked
        assert part.animation_data.drivers[0].driver.variables[0].targets[0].id == copy
    run(bpy.ops.object.delete)
    assert len(bpy.data.objects) == COUNT + 1


def test_one_undo_removes_a_duplicate_with_its_parts(head):
    run(bpy.ops.object.duplicate)
    bpy.ops.ed.undo()
    update()
    assert len(bpy.data.objects) == COUNT + 1


def test_parts_are_hidden_and_shown_with_the_head(head):
    hide(head)
    assert seen() == []
    bpy.ops.ed.undo()
    update()
    assert len(seen()) == COUNT + 1
    head = bpy.data.objects["Facemime Head"]
    head.hide_set(True)
    update()
    assert seen() == []
    head.hide_set(False)
    update()
    assert len(seen()) == COUNT + 1
    head.hide_viewport = True
    update()
    assert seen() == []
    head.hide_viewport = False
    update()
    assert len(seen()) == COUNT + 1


def test_a_part_that_is_hidden_alone_stays_hidden(head):
    bpy.data.objects["Tongue"].hide_set(True)
    update()
    head.location.x = 1.0
    update()
    assert "Tongue" not in seen() and len(seen()) == COUNT


def test_parts_are_hidden_in_renders_with_the_head(head):
    head.hide_render = True
    update()
    assert all(part.hide_render for part in parts())
    head.hide_render = False
    update()
    assert not any(part.hide_render for part in parts())


@pytest.mark.parametrize("how", ["append", "link"])
def test_a_head_from_another_file_brings_its_parts(head, how, tmp_path):
    path = str(tmp_path / "head.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.ed.undo_push(message="empty")
    operator = getattr(bpy.ops.wm, how)
    run(operator, filepath=f"{path}/Object/Facemime Head", directory=f"{path}/Object/", filename="Facemime Head")
    assert len(seen()) == COUNT + 1
    bpy.ops.ed.undo()
    update()
    assert seen() == []


def test_heads_of_earlier_files_keep_their_parts(head, tmp_path):
    del head[PARTS_PROPERTY]
    for part in parts():
        part.animation_data_clear()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "earlier.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "earlier.blend"))
    bpy.ops.object.select_all(action="DESELECT")
    bpy.data.objects["Facemime Head"].select_set(True)
    run(bpy.ops.object.delete)
    assert not len(bpy.data.objects)


def test_saving_and_opening_keeps_parts_attached_and_hidden(head, tmp_path):
    hide(head)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hidden.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "hidden.blend"))
    update()
    assert seen() == [] and len(parts()) == COUNT
    bpy.data.objects["Facemime Head"].hide_set(False)
    update()
    assert len(seen()) == COUNT + 1


def test_undoing_to_a_state_without_parts_leaves_redo_possible(head):
    run(bpy.ops.object.duplicate)
    for part in list(parts_of(bpy.data.objects["Facemime Head.001"]).values()):
        bpy.data.objects.remove(part)
    attach(bpy.data.objects["Facemime Head.001"], parts_of(bpy.data.objects["Facemime Head"]))
    bpy.ops.ed.undo_push(message="shared")
    bpy.ops.mesh.primitive_cube_add("EXEC_DEFAULT", True)
    bpy.ops.ed.undo()
    update()
    assert len(parts()) == COUNT and bpy.ops.ed.redo.poll()


def objects():
    """Objects of the file by name, and of libraries by name and library."""
    return sorted((obj.name, "" if obj.library is None else obj.library.name) for obj in bpy.data.objects)


@pytest.mark.parametrize("how", ["editable", "overridden", "link"])
def test_a_shot_with_a_character_of_another_file_opens_as_it_was_saved(head, how, tmp_path):
    character = bpy.data.collections.new("Character")
    bpy.context.scene.collection.children.link(character)
    for obj in bpy.data.objects:
        for collection in obj.users_collection:
            collection.objects.unlink(obj)
        character.objects.link(obj)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "character.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "character.blend"), link=True) as (_, wanted):
        wanted.collections = ["Character"]
    (linked,) = wanted.collections
    scene, layer = bpy.context.scene, bpy.context.view_layer
    scene.collection.children.link(linked)
    if how != "link":
        linked.override_hierarchy_create(scene, layer, do_fully_editable=how == "editable")
        scene.collection.children.unlink(linked)
    update()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    before = objects()
    for _ in range(2):
        attached_parts._opened()
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
        update()
        assert objects() == before
    if how != "link":
        (own,) = (obj for obj in bpy.data.objects if PARTS_PROPERTY in obj and obj.library is None)
        assert len(parts_of(own)) == COUNT and all(part.parent == own for part in parts_of(own).values())


def test_parts_that_were_parented_to_an_armature_are_not_copied_when_the_file_is_opened(head, tmp_path):
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.collection.objects.link(armature)
    before = sorted(obj.name for obj in bpy.data.objects)
    for part in parts_of(head).values():
        part.parent = armature
    path = str(tmp_path / "rigged.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    update()
    assert sorted(obj.name for obj in bpy.data.objects) == before

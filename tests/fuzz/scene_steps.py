"""What users do to a scene between the steps of random sequences: Blender's operators, and changes by scripts."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from tests.fuzz.stage import Stage


def undo(stage: Stage) -> None:
    """Undo a step."""
    if bpy.ops.ed.undo.poll():
        bpy.ops.ed.undo()


def redo(stage: Stage) -> None:
    """Redo a step."""
    if bpy.ops.ed.redo.poll():
        bpy.ops.ed.redo()


def operator(path: str, /, **options: object) -> Callable[[Stage], None]:
    """A step: an operator of Blender, with an undo step as from its interface."""

    def step(stage: Stage) -> None:
        module, name = path.split(".")
        function = getattr(getattr(bpy.ops, module), name)
        if function.poll():
            function(**options)
            bpy.ops.ed.undo_push(message=path)

    return step


def pushed(change: Callable[[Stage], object]) -> Callable[[Stage], None]:
    """A step: a change by a script, with an undo step."""

    def step(stage: Stage) -> None:
        change(stage)
        bpy.ops.ed.undo_push(message=change.__name__)

    step.__doc__ = change.__doc__
    return step


@pushed
def choose(stage: Stage) -> None:
    """Change the active object and the selection."""
    if bpy.context.mode != "OBJECT":
        return
    for obj in bpy.context.view_layer.objects:
        obj.select_set(bool(stage.rng.random() < 0.5))
    bpy.context.view_layer.objects.active = stage.any_of(bpy.context.view_layer.objects)


@pushed
def remove_object(stage: Stage) -> None:
    """Remove an object, as a script does."""
    if (obj := stage.any_of(bpy.data.objects)) is not None and bpy.context.mode == "OBJECT":
        bpy.data.objects.remove(obj)


@pushed
def hide(stage: Stage) -> None:
    """Hide or show any object, as the eye icon of the outliner does."""
    if (obj := stage.any_of(bpy.context.view_layer.objects)) is not None:
        obj.hide_set(not obj.hide_get())


@pushed
def append(stage: Stage) -> None:
    """Append a head from the saved file; Blender refuses the file that is open."""
    blend = stage.files.blend
    if not blend.exists() or bpy.data.filepath == str(blend) or bpy.context.mode != "OBJECT":
        return
    with bpy.data.libraries.load(str(blend), link=bool(stage.rng.random() < 0.3)) as (found, chosen):
        chosen.objects = found.objects[:1]
    for obj in chosen.objects:
        if obj is not None and bpy.context.scene.collection.is_editable:
            bpy.context.scene.collection.objects.link(obj)


@pushed
def rename(stage: Stage) -> None:
    """Rename the active object."""
    if (obj := stage.active()) is not None and obj.library is None:
        obj.name = f"Renamed {stage.rng.integers(9)}"


@pushed
def swap_mesh(stage: Stage) -> None:
    """Assign the mesh of another object to the active one."""
    if (mesh := stage.mesh()) is not None:
        stage.active().data = stage.any_of(bpy.data.meshes) or mesh


@pushed
def clear_geometry(stage: Stage) -> None:
    """Clear the geometry of the active mesh."""
    if (mesh := stage.mesh()) is not None:
        mesh.clear_geometry()


@pushed
def remove_actions(stage: Stage) -> None:
    """Remove all actions."""
    for action in list(bpy.data.actions):
        bpy.data.actions.remove(action)


@pushed
def remove_tracks(stage: Stage) -> None:
    """Remove the NLA tracks of the active object."""
    obj = stage.active()
    if obj is not None and obj.animation_data is not None:
        for track in list(obj.animation_data.nla_tracks):
            obj.animation_data.nla_tracks.remove(track)


@pushed
def clear_animation(stage: Stage) -> None:
    """Clear the animation of the active object and its keys."""
    if (obj := stage.active()) is not None:
        obj.animation_data_clear()
        if (keys := getattr(obj.data, "shape_keys", None)) is not None:
            keys.animation_data_clear()


@pushed
def add_modifier(stage: Stage) -> None:
    """Add a modifier that changes the number of displayed vertices."""
    if stage.mesh() is not None:
        stage.active().modifiers.new("Subdivision", "SUBSURF")


@pushed
def remove_a_group(stage: Stage) -> None:
    """Remove a vertex group of the active object."""
    if (obj := stage.active()) is not None and (group := stage.any_of(obj.vertex_groups)) is not None:
        obj.vertex_groups.remove(group)


@pushed
def remove_a_key(stage: Stage) -> None:
    """Remove a shape key of the active object."""
    mesh = stage.mesh()
    if mesh is not None and mesh.shape_keys is not None:
        stage.active().shape_key_remove(stage.any_of(mesh.shape_keys.key_blocks))


@pushed
def absolute_keys(stage: Stage) -> None:
    """Make the keys absolute, so that they are played one after another."""
    mesh = stage.mesh()
    if mesh is not None and mesh.shape_keys is not None:
        mesh.shape_keys.use_relative = not mesh.shape_keys.use_relative


@pushed
def override(stage: Stage) -> None:
    """Link a head from another file and override it."""
    path = stage.files.blend
    if not path.exists() or bpy.context.mode != "OBJECT" or bpy.data.filepath == str(path):
        return
    with bpy.data.libraries.load(str(path), link=True) as (there, here):
        here.objects = there.objects[:2]
    for linked in here.objects:
        if linked is not None and linked.library is not None:
            mine = linked.override_create(remap_local_usages=True)
            if mine is not None and mine.name not in bpy.context.scene.collection.objects:
                bpy.context.scene.collection.objects.link(mine)


def new_blend(stage: Stage) -> None:
    """Open a new file."""
    bpy.ops.wm.read_homefile(use_empty=bool(stage.rng.random() < 0.5), use_factory_startup=True)


def save(stage: Stage) -> None:
    """Save the file, or a copy of it."""
    bpy.ops.wm.save_as_mainfile(filepath=str(stage.files.blend), copy=bool(stage.rng.random() < 0.5))


def open_blend(stage: Stage) -> None:
    """Open the saved file."""
    if stage.files.blend.exists():
        bpy.ops.wm.open_mainfile(filepath=str(stage.files.blend))


def change_frame(stage: Stage) -> None:
    """Change the frame of the scene."""
    bpy.context.scene.frame_set(int(stage.rng.integers(0, 80)))


def change_mode(stage: Stage) -> None:
    """Change the mode of the active object."""
    if stage.active() is not None and bpy.ops.object.mode_set.poll():
        kinds = ("OBJECT", "OBJECT", "EDIT", "SCULPT", "WEIGHT_PAINT")
        bpy.ops.object.mode_set(mode=str(stage.any_of(kinds)) if stage.active().type == "MESH" else "OBJECT")


def change_scene(stage: Stage) -> None:
    """Change to another scene, or a new one."""
    window = bpy.context.window_manager.windows[0] if len(bpy.context.window_manager.windows) else None
    if window is not None:
        window.scene = stage.any_of([*bpy.data.scenes, None]) or bpy.data.scenes.new("Scene")


BLENDERS: dict[str, Callable[[Stage], None]] = {
    "undo": undo,
    "redo": redo,
    "choose": choose,
    "delete": operator("object.delete"),
    "delete globally": operator("object.delete", use_global=True),
    "remove object": remove_object,
    "rename": rename,
    "hide": hide,
    "append": append,
    "duplicate": operator("object.duplicate"),
    "duplicate linked": operator("object.duplicate", linked=True),
    "join": operator("object.join"),
    "join as shapes": operator("object.join_shapes"),
    "convert to mesh": operator("object.convert", target="MESH"),
    "convert to curve": operator("object.convert", target="CURVE"),
    "swap mesh": swap_mesh,
    "clear geometry": clear_geometry,
    "subdivide": operator("mesh.subdivide"),
    "delete vertices": operator("mesh.delete", type="VERT"),
    "select vertices": operator("mesh.select_all", action="TOGGLE"),
    "separate": operator("mesh.separate", type="LOOSE"),
    "purge": operator("outliner.orphans_purge", do_recursive=True),
    "apply transform": operator("object.transform_apply"),
    "apply visually": operator("object.visual_transform_apply"),
    "add modifier": add_modifier,
    "apply modifiers": operator("object.convert", target="MESH", keep_original=True),
    "single user": operator("object.make_single_user", object=True, obdata=True),
    "make local": operator("object.make_local", type="ALL"),
    "clear parent": operator("object.parent_clear", type="CLEAR"),
    "clear delta": operator("object.rotation_clear", clear_delta=True),
    "add cube": operator("mesh.primitive_cube_add"),
    "add armature": operator("object.armature_add"),
    "add key": operator("object.shape_key_add", from_mix=False),
    "delete keys": operator("object.shape_key_remove", all=True),
    "apply keys": operator("object.shape_key_remove", all=True, apply_mix=True),
    "remove a key": remove_a_key,
    "absolute keys": absolute_keys,
    "remove a group": remove_a_group,
    "remove all groups": operator("object.vertex_group_remove", all=True),
    "remove actions": remove_actions,
    "remove tracks": remove_tracks,
    "clear animation": clear_animation,
    "override": override,
    "frame": change_frame,
    "mode": change_mode,
    "scene": change_scene,
    "delete scene": operator("scene.delete"),
    "save": save,
    "open": open_blend,
    "new file": new_blend,
}

"""A made rig of a face, with controls of all kinds under names, rolls and rotation modes that mean nothing."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from facemime.blender.animation.bake_report import PuppetReport
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.characters import write_bones
from facemime.blender.frames import to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import mesh_of, read_places, read_regions, read_vertices
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.face.landmarks import BROWS, CHIN, LIPS, LOWER_LIDS, UPPER_LIDS
from facemime.core.heads.part_names import FaceBones
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow
from tests.helpers.takes import performance

_REACH = 0.3
"""Reach of a bone, in eye distances."""
BLINK, KEY = "eyeBlinkLeft", "browInnerUp"
"""Shape keys that a slider and a property drive."""


def show(head: bpy.types.Object, by: str = "CONTROLS") -> TakeShow:
    """Preview the performance on the head, by its controls or otherwise."""
    bpy.context.scene.facemime.drive_by = by
    return TakeShow(bpy.context.scene, [head], performance())


def bake(head: bpy.types.Object, **options: Any) -> PuppetReport:
    """Bake the performance to the controls of the head."""
    settings = PuppetSettings(bake=BakeSettings(keys="controls", **options), neutral=0.0)
    return puppet_head(bpy.context.scene, head, performance(), settings)


def make_face_rig(seed: int = 0, scale: float = 1.0) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Put the built-in head on bones, a slider and a property, and return it with its armature.

    The bones are larger than the head by `scale`, as the armature is scaled by its inverse.
    """
    random = np.random.default_rng(seed)
    head = add_head(bpy.context, units=True)
    for child in [
        child for child in head.children_recursive if not str(child.get("facemime_part", "")).startswith("eye")
    ]:
        bpy.data.objects.remove(child)
    keep = {BLINK, KEY, mesh_of(head).shape_keys.reference_key.name}
    for key in [key for key in mesh_of(head).shape_keys.key_blocks if key.name not in keep]:
        head.shape_key_remove(key)
    places = to_blender(read_vertices(mesh_of(head))).astype(np.float64)
    points, unit = places[read_places(head)], 0.085
    spots = [*points[BROWS[::2]], *points[UPPER_LIDS[::2]], *points[LOWER_LIDS[::2]], *points[LIPS[::2]]]
    armature = _armature(spots, points[CHIN].mean(axis=0), scale, random)
    _weight(head, armature, places, spots, points[CHIN].mean(axis=0), unit)
    _modes(armature, random)
    _slider(head, random)
    return head, armature


def _armature(spots: list[np.ndarray], chin: np.ndarray, scale: float, random: np.random.Generator) -> bpy.types.Object:
    bpy.ops.object.armature_add()
    armature = bpy.context.active_object
    armature.name = "Rig"
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    bones.remove(bones[0])
    skull = bones.new("Skull")
    skull.head, skull.tail = (0.0, 0.05, -0.2), (0.0, 0.05, 0.1)
    hinge = bones.new("Hinge")
    hinge.head, hinge.tail, hinge.parent = (0.0, 0.02, 0.0), chin.tolist(), skull
    hinge.roll = random.uniform(-3.0, 3.0)
    for number, spot in enumerate(spots):
        bone = bones.new(f"c{number}")
        bone.head = spot.tolist()
        bone.tail = (spot + 0.02 * (away := random.normal(size=3)) / np.linalg.norm(away)).tolist()
        bone.roll, bone.parent = random.uniform(-3.0, 3.0), skull
    hidden = bones.new("Hidden")
    hidden.head, hidden.tail, hidden.parent = spots[0].tolist(), (spots[0] + 0.01).tolist(), skull
    ear = bones.new("Side")
    ear.head, ear.tail, ear.parent = (0.09, 0.05, 0.0), (0.12, 0.05, 0.0), skull
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.data.bones["Hidden"].hide = True
    armature.data.transform(Matrix.Scale(scale, 4))
    armature.scale = (1.0 / scale,) * 3
    return armature


def _weight(
    head: bpy.types.Object,
    armature: bpy.types.Object,
    places: np.ndarray,
    spots: list[np.ndarray],
    chin: np.ndarray,
    unit: float,
) -> None:
    """Weight the skin: smoothly around the bones of the face, the jaw below the mouth, an ear at its side."""
    lower = read_regions(head)[2]
    near = np.array(
        [np.exp(-np.square(np.linalg.norm(places - spot, axis=1) / (_REACH * unit) * 2.0)) for spot in spots]
    )
    near *= 0.8 / np.maximum(near.sum(axis=0), 0.8)
    jaw = lower * (1.0 - near.sum(axis=0))
    side = np.exp(-np.square(np.linalg.norm(places - (0.09, 0.05, 0.0), axis=1) / 0.02))
    side *= 1.0 - near.sum(axis=0) - jaw
    weights = {f"c{number}": row for number, row in enumerate(near)} | {"Hinge": jaw, "Side": side}
    weights["Skull"] = 1.0 - sum(weights.values())
    for name, row in weights.items():
        group = head.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(row > 1e-3).tolist():
            group.add([vertex], float(row[vertex]), "REPLACE")
    modifier = head.modifiers.new("Rig", "ARMATURE")
    modifier.object = armature
    head.parent = armature
    head.matrix_parent_inverse = armature.matrix_basis.inverted()
    write_bones(head, armature, FaceBones(head="Skull"))


def _modes(armature: bpy.types.Object, random: np.random.Generator) -> None:
    """Give the bones rotation modes, and the first one a limit, a lock, and a pose of the user."""
    bones = armature.pose.bones
    for bone in bones:
        bone.rotation_mode = str(random.choice(["QUATERNION", "XYZ", "ZYX", "AXIS_ANGLE"]))
    limit = bones["c0"].constraints.new("LIMIT_LOCATION")
    limit.owner_space = "LOCAL"
    for axis in "xyz":
        setattr(limit, f"use_min_{axis}", True)
        setattr(limit, f"use_max_{axis}", True)
        reach = 0.01 / armature.scale[0]
        setattr(limit, f"min_{axis}", -reach)
        setattr(limit, f"max_{axis}", reach)
    bones["c1"].lock_location[1] = True
    bones["c2"].location = (0.001, 0.0002, -0.0003)


def _slider(head: bpy.types.Object, random: np.random.Generator) -> None:
    """Let an empty shut an eye, and a property of the armature raise the brows."""
    slider = bpy.data.objects.new("Slider", None)
    bpy.context.scene.collection.objects.link(slider)
    slider.location = Vector((0.5, 0.0, float(random.uniform(-0.1, 0.1))))
    slider.lock_location = (True, True, False)
    limit = slider.constraints.new("LIMIT_LOCATION")
    limit.owner_space = "LOCAL"
    limit.use_min_z = limit.use_max_z = True
    limit.min_z, limit.max_z = slider.location.z, slider.location.z + 0.2
    armature = bpy.data.objects["Rig"]
    armature["lift"] = 0.0
    armature.id_properties_ui("lift").update(min=0.0, max=1.0)
    keys = mesh_of(head).shape_keys
    _drive(keys, BLINK, slider, "location.z", f"5.0 * (var - {slider.location.z})")
    _drive(keys, KEY, armature, '["lift"]', "var")


def _drive(keys: bpy.types.Key, name: str, source: bpy.types.Object, path: str, expression: str) -> None:
    driver = keys.key_blocks[name].driver_add("value").driver
    driver.expression = expression
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = source, path


def state(armature: bpy.types.Object) -> dict[str, object]:
    """Every channel of a made rig, exactly."""
    found: dict[str, object] = {
        bone.name: (
            bone.location[:],
            bone.rotation_quaternion[:],
            bone.rotation_euler[:],
            bone.rotation_axis_angle[:],
            bone.scale[:],
            bone.rotation_mode,
        )
        for bone in armature.pose.bones
    }
    return found | {"lift": armature["lift"], "Slider": bpy.data.objects["Slider"].location[:]}

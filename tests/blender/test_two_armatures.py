"""A face with a rig of its own turns with the head of the body's rig, as its hair does."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.targets import own_targets
from facemime.blender.heads.binding import bind_character
from facemime.core.face.rotation import euler_to_matrix
from tests.helpers.characters import make_character, shown, turn_between
from tests.helpers.thorough import first_of

SAME = "Head"


def parent(face, body, bone):
    face.parent, face.parent_type, face.parent_bone = body, "BONE", bone
    bpy.context.view_layer.update()
    face.matrix_parent_inverse = (body.matrix_world @ body.pose.bones[bone].matrix).inverted()
    face.matrix_parent_inverse.translation.y -= body.pose.bones[bone].length  # its tail carries


def copy(kind):
    def constrain(face, body, bone):
        for name in (SAME, "Spine"):
            constraint = face.pose.bones[name].constraints.new(kind)
            constraint.target, constraint.subtarget = body, bone if name == SAME else name

    return constrain


def child_of(face, body, bone):
    constraint = face.constraints.new("CHILD_OF")
    constraint.target, constraint.subtarget = body, bone
    constraint.inverse_matrix = (body.matrix_world @ body.pose.bones[bone].matrix).inverted()


def armature_constraint(face, body, bone):
    constraint = face.pose.bones[SAME].constraints.new("ARMATURE")
    target = constraint.targets.new()
    target.target, target.subtarget = body, bone


CARRIED = {
    "parent": parent,
    "copied": copy("COPY_TRANSFORMS"),
    "turned": copy("COPY_ROTATION"),
    "child": child_of,
    "led": armature_constraint,
}


def character(carry, name=SAME):
    """A character whose face is on a copy of the rig of its body; the bone of the body's head has a name."""
    objects = make_character(rig=True, hair=True)
    body = objects["head"].parent
    face = body.copy()
    face.data = body.data.copy()
    bpy.context.scene.collection.objects.link(face)
    for obj in (obj for key, obj in objects.items() if key not in ("body", "hair")):
        obj.parent = obj.modifiers["Armature"].object = face
    bpy.context.view_layer.update()
    body.data.bones[SAME].name = name
    if carry is not None:
        carry(face, body, name)
    bpy.context.view_layer.update()
    return bind_character(objects["head"])[0], objects, body, face


@pytest.mark.parametrize("name", first_of([SAME, "mixamorig:Head"]))
@pytest.mark.parametrize("carry", first_of(sorted(CARRIED)))
def test_the_head_of_the_body_is_turned_if_it_moves_the_rig_of_the_face(carry, name):
    head, objects, body, _ = character(CARRIED[carry], name)
    target = own_targets(head)["head"]
    assert (target.obj, target.bone) == (body, name)
    before = [shown(objects[key]) for key in ("head", "hair", "body")]
    target.begin()
    target.apply(euler_to_matrix(*np.radians([5.0, 20.0, 3.0]).tolist()), None)
    after = [shown(objects[key]) for key in ("head", "hair", "body")]
    top = before[0][:, 2] > 0.0
    face, hair = turn_between(before[0][top], after[0][top]), turn_between(before[1], after[1])
    np.testing.assert_allclose(face, hair, atol=1e-3)
    assert np.trace(face) < 2.9 and np.abs(after[2] - before[2]).max() < 1e-5
    target.rest()


def by_the_spine(face, body, bone):
    parent(face, body, "Spine")


@pytest.mark.parametrize("carry", first_of([by_the_spine, None]))
def test_the_rig_of_the_face_is_turned_if_no_other_head_moves_it(carry):
    head, _, _, face = character(carry)
    target = own_targets(head)["head"]
    assert (target.obj, target.bone) == (face, SAME)


def test_a_constraint_that_is_muted_later_leads_nothing():
    head, _, body, face = character(CARRIED["copied"])
    assert own_targets(head)["head"].obj == body
    for constraint in (one for posed in face.pose.bones for one in posed.constraints):
        constraint.mute = True
    assert own_targets(head)["head"].obj == face

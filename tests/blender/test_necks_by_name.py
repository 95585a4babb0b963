"""Separate necks, which the names of their objects, materials and vertex groups tell from teeth."""

import bpy
import numpy as np
import pytest

from facemime.blender.characters import read_kinds
from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.parts import forget_parts, sort_again
from facemime.core.heads.rig import Part
from tests.helpers.characters import make_character


@pytest.mark.parametrize("by", ["object", "material", "group"])
def test_a_piece_behind_the_lips_that_is_named_after_the_neck_rides_on_the_head(by):
    objects = make_character(rig=False)
    head, piece = objects["head"], objects["teeth_lower"]
    piece.name, piece.data.name = "Cube", "Cube"
    piece.data.materials.clear()
    bind_character(head)
    assert set(np.unique(read_kinds(piece.data))) <= {Part.TEETH_LOWER, Part.TEETH_UPPER}
    if by == "object":
        piece.name = "figure_cuello"
    elif by == "material":
        piece.data.materials.append(bpy.data.materials.new("Nuque"))
    else:
        piece.vertex_groups.new(name="hals").add(range(len(piece.data.vertices)), 1.0, "REPLACE")
    forget_parts(head)
    sort_again(head)
    assert set(np.unique(read_kinds(piece.data))) == {Part.ON_HEAD}


def test_a_neck_bone_that_moves_the_face_as_well_says_nothing_about_teeth():
    objects = make_character(rig=False)
    head, teeth = objects["head"], objects["teeth_lower"]
    for obj in (head, teeth):
        obj.vertex_groups.new(name="Neck").add(range(len(obj.data.vertices)), 1.0, "REPLACE")
    bind_character(head)
    assert set(np.unique(read_kinds(teeth.data))) <= {Part.TEETH_LOWER, Part.TEETH_UPPER}

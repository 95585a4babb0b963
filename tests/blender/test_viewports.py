"""What other objects hide from a viewport."""

from types import SimpleNamespace

import bpy
from mathutils import Quaternion

from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.family import character_of
from facemime.blender.meshes import read_landmarks
from facemime.blender.preview_scene import face_points, look_at_face
from facemime.blender.viewports import Viewport, is_hidden_by_others
from tests.helpers.characters import make_character


def hidden(obj: bpy.types.Object) -> bool:
    """Return whether other objects hide the face of a head from a viewport that looks at it."""
    view = SimpleNamespace(view_rotation=Quaternion())
    look_at_face(view, obj)
    seen = Viewport(None, view, None)
    return is_hidden_by_others(bpy.context, seen, face_points(obj)[read_landmarks(obj)], character_of(obj))


def test_a_face_inside_another_object_is_hidden_but_not_by_parts_of_its_own():
    objects = make_character(rig=True, hair=True)
    head, _ = bind_character(objects["body"])
    assert set(objects.values()) <= character_of(head) and not hidden(head)
    bpy.ops.mesh.primitive_cube_add(size=20.0)
    cube = bpy.context.object
    assert hidden(head)
    cube.display_type = "WIRE"
    assert not hidden(head)
    cube.display_type = "TEXTURED"
    cube.location.y = 15.0
    assert not hidden(head), "it is behind the head"
    cube.location.y = -15.0
    assert hidden(head)
    cube.parent = head
    assert not hidden(head)

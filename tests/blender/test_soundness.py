"""Defective meshes are bound in spite of their defects, or refused with the name of the mesh and the remedy."""

import bmesh
import bpy
import numpy as np
import pytest

from facemime.blender.heads.binding import bind_character
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, read_vertices
from facemime.core.errors import HeadError
from facemime.core.face.landmarks import outer_eye_distance


@pytest.fixture
def head():
    """The skin of the built-in head, which nothing has been found on yet, and where its landmarks are."""
    head = add_head(bpy.context)
    for child in head.children:
        bpy.data.objects.remove(child)
    places = read_vertices(head.data)[read_landmarks(head)]
    for owner in (head, head.data):
        for key in list(owner.keys()):
            del owner[key]
    head.vertex_groups.clear()
    return head, places


def edited(obj, edit):
    mesh = bmesh.new()
    mesh.from_mesh(obj.data)
    mesh.verts.ensure_lookup_table()
    edit(mesh)
    mesh.to_mesh(obj.data)
    mesh.free()


def check_found(head, places, share=0.05):
    found, _ = bind_character(head)
    off = np.linalg.norm(read_vertices(found.data)[read_landmarks(found)] - places, axis=1)
    assert np.median(off) < share * outer_eye_distance(places)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 3e38])
def test_vertices_at_no_number_are_named_and_selected(head, value):
    head, _ = head
    head.data.attributes["position"].data[5].vector = (0.0, value, 0.0)
    with pytest.raises(HeadError, match=r"Facemime Head has vertices whose positions .*: 5\. Delete them in Edit Mode"):
        bind_character(head)
    assert [vertex.index for vertex in head.data.vertices if vertex.select] == [5]


def test_another_mesh_of_the_character_with_such_vertices_is_named(head):
    head, _ = head
    bpy.ops.mesh.primitive_cube_add(size=0.02)
    hair = bpy.context.active_object
    hair.name, hair.parent = "Hair", head
    hair.data.attributes["position"].data[2].vector = (float("nan"), 0.0, 0.0)
    with pytest.raises(HeadError, match=r"Hair has vertices whose positions .*: 2"):
        bind_character(head)


def test_a_shape_key_with_positions_that_are_no_numbers_is_named(head):
    head, _ = head
    head.shape_key_add(name="Basis")
    head.shape_key_add(name="Odd").points[3].co = (float("nan"), 0.0, 0.0)
    with pytest.raises(HeadError, match="The shape key Odd of Facemime Head"):
        bind_character(head)


@pytest.mark.parametrize(
    "place",
    [
        (3.0, 0.0, 0.0),
        *(pytest.param(far, marks=pytest.mark.thorough) for far in ((0.0, 0.0, -500.0), (1e6, 0.0, 0.0))),
    ],
)
@pytest.mark.parametrize("how", ["loose", "edge", "face", "spike"])
def test_a_vertex_that_is_astray_does_not_hide_the_face(head, how, place):
    head, places = head

    def edit(mesh):
        if how == "spike":
            mesh.verts[np.argmin(read_vertices(head.data)[:, 1])].co = place
            return
        corners = [mesh.verts.new(np.array(place) + [0.01 * n, 0.01 * (n == 2), 0.0]) for n in range(3)]
        if how == "edge":
            mesh.edges.new(corners[:2])
        elif how == "face":
            mesh.faces.new(corners)

    edited(head, edit)
    check_found(head, places)


def halve(head):
    edited(
        head,
        lambda mesh: bmesh.ops.delete(mesh, geom=[v for v in mesh.verts if v.co.x < -1e-5], context="VERTS"),
    )


@pytest.mark.parametrize("where", ["own", "object"])
def test_a_half_head_with_a_mirror_says_that_it_has_to_be_applied(head, where):
    head, _ = head
    halve(head)
    mirror = head.modifiers.new("Other Half", "MIRROR")
    if where == "object":
        head.location.x = 0.4
        mirror.mirror_object = bpy.data.objects.new("Plane", None)
        bpy.context.scene.collection.objects.link(mirror.mirror_object)
        mirror.mirror_object.location.x = 0.4
        bpy.context.view_layer.update()
    with pytest.raises(HeadError, match=r"modifier Other Half shows the other\. Apply the modifier"):
        bind_character(head)


def test_a_whole_head_with_a_mirror_is_found(head):
    head, places = head
    head.modifiers.new("Mirror", "MIRROR")
    check_found(head, places)


@pytest.mark.thorough
def test_a_half_head_that_nodes_complete_names_their_modifier(head):
    head, _ = head
    halve(head)
    nodes = bpy.data.node_groups.new("Mirrored", "GeometryNodeTree")
    for kind in ("INPUT", "OUTPUT"):
        nodes.interface.new_socket("Geometry", in_out=kind, socket_type="NodeSocketGeometry")
    given, result = nodes.nodes.new("NodeGroupInput"), nodes.nodes.new("NodeGroupOutput")
    turned, joined = nodes.nodes.new("GeometryNodeTransform"), nodes.nodes.new("GeometryNodeJoinGeometry")
    turned.inputs["Scale"].default_value = (-1.0, 1.0, 1.0)
    for one, other in ((given, turned), (given, joined), (turned, joined), (joined, result)):
        nodes.links.new(one.outputs[0], other.inputs[0])
    head.modifiers.new("Mirrored by Nodes", "NODES").node_group = nodes
    with pytest.raises(HeadError, match=r"without its modifiers: Mirrored by Nodes\. Apply them"):
        bind_character(head)


def test_a_coarse_head_names_the_modifier_that_subdivides_it(head):
    head, places = head
    head.modifiers.new("Fewer", "DECIMATE").ratio = 0.1
    bpy.context.view_layer.objects.active = head
    bpy.ops.object.modifier_apply(modifier="Fewer")
    with pytest.raises(HeadError, match="too coarse"):
        bind_character(head)
    head.modifiers.new("Smooth Face", "SUBSURF")
    with pytest.raises(HeadError, match=r"without its modifiers: Smooth Face\. Apply them"):
        bind_character(head)
    bpy.ops.object.modifier_apply(modifier="Smooth Face")
    check_found(head, places, share=0.08)  # vertices are farther apart than on the head itself

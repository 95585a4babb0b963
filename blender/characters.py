"""Characters: heads whose faces have several meshes, the part to which each vertex belongs, and the bones of the pose.

Everything is stored with the head and its parts, so that it applies wherever the file is opened: the part of each
vertex as an attribute of its mesh, the head in a custom property of each other object, and the bones in custom
properties of the head.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import bpy
import cv2
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..core.errors import HeadError
from ..core.heads.eyeballs import sphere_of_lids
from ..core.heads.part_names import FaceBones
from ..core.heads.rig import FaceParts, Part
from ..core.numeric import linalg
from .bone_marks import mark_bone, marked_bone
from .frames import HEAD_TO_BLENDER, from_blender, to_blender
from .meshes import can_be_driven, driven_by_keys, mesh_of, read_faces, read_vertices, rest_bones
from .names import (
    ARMATURE_PROPERTY,
    BONES_PROPERTY,
    HEAD_PROPERTY,
    ORDER_PROPERTY,
    PART_ATTRIBUTE,
    PART_PROPERTY,
    PARTS_PROPERTY,
)
from .own_pose import ROTATIONS, matrix_of, own_mode, own_pose

_MOVED = (Part.ON_SKIN, Part.EYE_RIGHT, Part.EYE_LEFT, Part.TEETH_LOWER)
"""Parts whose vertices move within the head."""
_MIN_EYE = 8
"""Fewest vertices of an eye to which a sphere is fitted."""
_EYE_BONES = {Part.EYE_RIGHT: "eye_right", Part.EYE_LEFT: "eye_left"}
_MARK = "mark"
"""Where the end of the marks of bones is stored, the name that the head had then."""


@dataclass(frozen=True)
class Member:
    """A mesh whose vertices a performance moves.

    Attributes
    ----------
    part : slice
        Its vertices in `HeadRig.all_vertices`.
    to_mesh : (3, 4) float64
        Affine map from the head frame to the axes of the mesh in Blender.
    """

    obj: bpy.types.Object
    part: slice
    to_mesh: NDArray[np.float64]

    def local(self, vertices: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Convert the member's share of (A, 3) vertices to its mesh, as the flat array that `foreach_set` takes."""
        own = np.ascontiguousarray(vertices[self.part], dtype=np.float32)
        return np.asarray(cv2.transform(own.reshape(1, -1, 3), self.to_mesh), dtype=np.float32).reshape(-1)

    def local_offsets(self, offsets: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Convert the member's share of (..., A, 3) displacements to its mesh."""
        return np.asarray(offsets[..., self.part, :] @ self.to_mesh[:, :3].T, dtype=np.float32)

    def head_offsets(self, offsets: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Convert (..., n, 3) displacements of its mesh to the head frame."""
        return np.asarray(offsets @ self._to_head, dtype=np.float32)

    @cached_property
    def _to_head(self) -> NDArray[np.float64]:
        """Matrix that multiplies displacements of the mesh from the right, (3, 3)."""
        return np.asarray(linalg.inv(self.to_mesh[:, :3]).T)


def places_in(head: bpy.types.Object, obj: bpy.types.Object) -> NDArray[np.float64]:
    """Return the vertices (V, 3) of another mesh at rest in the frame of `head`."""
    move = np.array(rest_matrix(head).inverted_safe() @ rest_matrix(obj))
    local = to_blender(read_vertices(mesh_of(obj)))
    return from_blender(local @ move[:3, :3].T + move[:3, 3]).astype(np.float64)


def members_of(head: bpy.types.Object) -> list[Member]:
    """Return the meshes that a performance moves: the head, and those that have vertices of moving parts."""
    moved = [obj for obj in objects_of(head) if np.isin(_rigid(head, read_kinds(mesh_of(obj))), _MOVED).any()]
    return _members(head, moved)


def whole_face(head: bpy.types.Object) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the rest positions (B, 3) of all meshes of a face in the head frame, those of `members_of` first, and the
    faces between them (F, K).
    """
    moved = [member.obj for member in members_of(head)[1:]]
    still = [obj for obj in objects_of(head) if obj not in moved]
    return _at_rest(_members(head, [*moved, *still]))


def _members(head: bpy.types.Object, objects: Sequence[bpy.types.Object]) -> list[Member]:
    """Return a head and other meshes of its face, one after the other."""
    start = len(mesh_of(head).vertices)
    members = [Member(head, slice(0, start), np.column_stack([HEAD_TO_BLENDER, np.zeros(3)]))]
    to_head = rest_matrix(head).inverted_safe()
    for obj in objects:
        to_mesh = np.array((to_head @ rest_matrix(obj)).inverted_safe())[:3]
        to_mesh[:, :3] = to_mesh[:, :3] @ HEAD_TO_BLENDER
        stop = start + len(mesh_of(obj).vertices)
        members.append(Member(obj, slice(start, stop), to_mesh))
        start = stop
    return members


def _at_rest(members: Sequence[Member]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the rest positions (N, 3) of members in the head frame, and the faces of these (F, K)."""
    places, faces = [np.empty((0, 3), dtype=np.float32)], [np.empty((0, 3), dtype=np.int32)]
    for member in members:
        back = linalg.inv(np.vstack([member.to_mesh, [0.0, 0.0, 0.0, 1.0]]))[:3]
        mesh = mesh_of(member.obj)
        own = cv2.transform(to_blender(read_vertices(mesh)).reshape(1, -1, 3), back)
        places.append(np.asarray(own, dtype=np.float32).reshape(-1, 3))
        corners = read_faces(mesh)
        faces.append(np.where(corners >= 0, corners + member.part.start, -1))
    return np.concatenate(places), _stacked(faces)


def objects_of(head: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the other meshes of the face of `head`; of a built-in head, its lashes.

    They are ordered by name, until `part_order.keep_order` keeps their order for later.
    """
    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH" and HEAD_PROPERTY in obj and obj != head]
    found = [obj for obj in meshes if pointed_to(obj, obj[HEAD_PROPERTY]) == head]
    lashes = parts_of(head).get("lashes")
    if lashes is not None and lashes.type == "MESH" and lashes.parent == head:
        found.append(lashes)
    return sorted(found, key=_place)


def _place(obj: bpy.types.Object) -> tuple[float, str, str]:
    place = obj.get(ORDER_PROPERTY)
    return place if isinstance(place, int) else np.inf, library_name(obj), obj.name


def library_name(obj: bpy.types.Object) -> str:
    """Return the name of an object; of a library override, that in the library."""
    reference = _reference(obj)
    return obj.name if reference is None else reference.name


def parts_of(head: bpy.types.Object) -> dict[str, bpy.types.Object]:
    """Return the parts attached to a head by key, without those that were deleted."""
    stored = head.get(PARTS_PROPERTY)
    parts = stored.to_dict() if hasattr(stored, "to_dict") else {}
    own = {key: pointed_to(head, part) for key, part in parts.items()}
    return {
        key: part for key, part in own.items() if isinstance(part, bpy.types.Object) and not _is_foreign(head, part)
    }


def pointed_to(owner: bpy.types.Object, obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the object that a custom property of `owner` means by `obj`.

    Custom properties of a library override point to objects of the library again when the file is opened. They mean the
    overrides of these that belong to the same character, if there are any.
    """
    if not isinstance(obj, bpy.types.Object) or not _is_foreign(owner, obj):
        return obj
    overrides = [other for other in bpy.data.objects if other.override_library is not None]
    root = _root(owner)
    found = [other for other in overrides if _root(other) == root and _reference(other) == obj]
    return min(found, key=lambda other: other.parent != owner, default=obj)


def _is_foreign(owner: bpy.types.Object, obj: bpy.types.Object) -> bool:
    """Return whether `owner` is a library override, and `obj` is not one but in the library."""
    return owner.override_library is not None and obj.library is not None


def part_table(head: bpy.types.Object) -> list[tuple[bpy.types.Object, Part, int]]:
    """Return the parts of each mesh of the face of `head`, and how many vertices each has; the head comes first."""
    table = []
    for obj in (head, *objects_of(head)):
        counts = np.bincount(read_kinds(mesh_of(obj)), minlength=len(Part))
        table += [(obj, part, int(counts[part])) for part in Part if counts[part]]
    return table


def set_part(obj: bpy.types.Object, part: Part, of: NDArray[np.bool_]) -> None:
    """Change the part of the vertices of a mesh that `of` (V,) marks."""
    kinds = read_kinds(mesh_of(obj))
    kinds[of] = part
    write_kinds(mesh_of(obj), kinds)


def head_of(obj: bpy.types.Object) -> bpy.types.Object:
    """Return the head to which `obj` belongs as a part; `obj` itself if it is none."""
    owner = pointed_to(obj, obj.get(HEAD_PROPERTY))
    if obj.get(PART_PROPERTY) is not None and obj.parent is not None:
        owner = obj.parent
    return owner if isinstance(owner, bpy.types.Object) and can_be_driven(owner) else obj


def read_parts(head: bpy.types.Object) -> FaceParts | None:
    """Return the parts of the face of `head` other than its skin; None if all of it is skin.

    Eyes that bones rotate count as part of the head, as only the bones move them within it.
    """
    members = members_of(head)
    kinds = np.concatenate([_rigid(head, read_kinds(mesh_of(member.obj))) for member in members])
    if driven_by_keys(head):  # its keys move every part
        kinds[:] = np.where(np.arange(len(kinds)) < len(mesh_of(head).vertices), Part.SKIN, Part.ON_HEAD)
    if not kinds.any():
        return None
    return FaceParts(kinds, *_at_rest(members[1:]))


def part_mesh(head: bpy.types.Object, part: Part) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices of a part of a face in the head frame, (N, 3), and the faces between them, (F, K)."""
    return mesh_within(head, lambda obj: read_kinds(mesh_of(obj)) == part)


def mesh_within(
    head: bpy.types.Object, chosen: Callable[[bpy.types.Object], NDArray[np.bool_]]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the vertices that are `chosen` of each mesh of a character, (V,), as `part_mesh` does."""
    to_head = rest_matrix(head).inverted_safe()
    vertices, faces, start = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int32)], 0
    for obj in (head, *objects_of(head)):
        within = chosen(obj)
        if not within.any():
            continue
        move = np.array(to_head @ rest_matrix(obj))
        places = to_blender(read_vertices(mesh_of(obj))) @ move[:3, :3].T + move[:3, 3]
        vertices.append(from_blender(places[within]))
        number = np.full(len(within) + 1, -1, dtype=np.int32)
        number[:-1][within] = start + np.arange(within.sum())
        own = read_faces(mesh_of(obj))
        faces.append(number[own[((number[own] >= 0) | (own < 0)).all(axis=1)]])
        start += int(within.sum())
    return np.concatenate(vertices), _stacked(faces)


def part_eyeballs(head: bpy.types.Object) -> NDArray[np.float64]:
    """Return (E, 4) centre and radius, in the head frame, of the sphere over which the lids of each round eye slide."""
    eyes = [part_mesh(head, part)[0] for part in _EYE_BONES]
    spheres = [sphere_of_lids(eye) for eye in eyes if len(eye) > _MIN_EYE]
    return np.array([sphere for sphere in spheres if sphere is not None]).reshape(-1, 4)


def read_kinds(mesh: bpy.types.Mesh) -> NDArray[np.int8]:
    """Return (V,) `Part` of each vertex of a mesh; skin if nothing is stored.

    Raises HeadError if the mesh is in Edit Mode, where Blender keeps its attributes elsewhere.
    """
    kinds = np.zeros(len(mesh.vertices), dtype=np.int8)
    attribute = mesh.attributes.get(PART_ATTRIBUTE)
    if attribute is None or attribute.data_type != "INT8" or attribute.domain != "POINT":
        return kinds
    if mesh.is_editmode:
        raise HeadError("{name} is in Edit Mode. Leave Edit Mode first.", name=mesh.name)
    attribute.data.foreach_get("value", kinds)
    return np.where(np.isin(kinds, list(Part)), kinds, np.int8(Part.ON_HEAD))


def write_kinds(mesh: bpy.types.Mesh, kinds: NDArray[np.integer[Any]]) -> None:
    """Store the `Part` of each vertex of a mesh (V,); if all are skin, nothing is stored."""
    attribute = mesh.attributes.get(PART_ATTRIBUTE)
    if attribute is not None and (not np.any(kinds) or attribute.data_type != "INT8" or attribute.domain != "POINT"):
        mesh.attributes.remove(attribute)
        attribute = None
    if np.any(kinds):
        attribute = attribute or mesh.attributes.new(PART_ATTRIBUTE, "INT8", "POINT")
        attribute.data.foreach_set("value", np.ascontiguousarray(kinds, dtype=np.int8))


def read_bones(head: bpy.types.Object) -> tuple[bpy.types.Object | None, FaceBones]:
    """Return the armature that follows the pose of `head`, and its bones; those that no longer exist are ""."""
    armature, stored = pointed_to(head, head.get(ARMATURE_PROPERTY)), stored_bones(head)
    if not isinstance(armature, bpy.types.Object) or armature.type != "ARMATURE" or not stored:
        return None, FaceBones()
    named = {key: name for key, name in stored.items() if key in FaceBones.__dataclass_fields__ and name}
    marks = {key: f"{key} {stored[_MARK]}" if _MARK in stored else "" for key in named}
    return armature, FaceBones(**{key: marked_bone(armature, name, marks[key]) for key, name in named.items()})


def stored_bones(head: bpy.types.Object) -> dict[str, str]:
    """Return the names that the bones of `head` had when they were stored, by the fields of `FaceBones`."""
    stored = head.get(BONES_PROPERTY)
    return {key: str(name) for key, name in stored.to_dict().items()} if hasattr(stored, "to_dict") else {}


def write_bones(head: bpy.types.Object, armature: bpy.types.Object | None, bones: FaceBones) -> None:
    """Store the bones that follow the pose of a head."""
    for name in (ARMATURE_PROPERTY, BONES_PROPERTY):
        if name in head:
            del head[name]
    if armature is not None:
        head[ARMATURE_PROPERTY] = armature
        names = {key: getattr(bones, key) for key in FaceBones.__dataclass_fields__}
        head[BONES_PROPERTY] = {**names, _MARK: head.name}
        for key, name in names.items():
            mark_bone(armature, name, f"{key} {head.name}")


def rest_rotation(obj: bpy.types.Object) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of `obj` in the world, without scales, performances and poses of bones."""
    return np.asarray(parent_rotation(obj) @ np.array(_placed_rotation(obj)))


def parent_rotation(obj: bpy.types.Object) -> NDArray[np.float64]:
    """Return the (3, 3) rotation from the space of the parent of `obj` to the world, as `rest_rotation`."""
    if obj.parent is None:
        return np.eye(3)
    carried = rest_rotation(obj.parent)
    if (bone := _parent_bone(obj)) is not None:
        carried = carried @ np.array(bone.matrix_local.to_3x3().normalized())
    return np.asarray(carried @ np.array(obj.matrix_parent_inverse.to_quaternion().to_matrix()))


def rest_matrix(obj: bpy.types.Object) -> Matrix:
    """Return the (4, 4) transform of `obj` in the world, without performances and poses of bones."""
    location = obj.location + own_pose(obj).location
    return parent_matrix(obj) @ Matrix.LocRotScale(location, _placed_rotation(obj), placed_scale(obj))


def box_of(obj: bpy.types.Object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner (3,) of a box around `obj` in the world, where `rest_matrix` has it."""
    corners = np.array([rest_matrix(obj) @ Vector(corner) for corner in obj.bound_box])
    return corners.min(axis=0), corners.max(axis=0)


def ancestors(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the parent of `obj`, its parent, and so on."""
    above = []
    while obj.parent is not None:
        obj = obj.parent
        above.append(obj)
    return above


def parent_matrix(obj: bpy.types.Object) -> Matrix:
    """Return the (4, 4) transform from the space of the parent of `obj` to the world, as `rest_matrix`."""
    if obj.parent is None:
        return Matrix.Identity(4)
    carried = rest_matrix(obj.parent)
    if (bone := _parent_bone(obj)) is not None:
        carried = carried @ bone.matrix_local @ Matrix.Translation((0.0, bone.length, 0.0))
    return carried @ obj.matrix_parent_inverse


def placed_scale(obj: bpy.types.Object) -> Vector:
    """Return the scale of `obj` relative to its parent, including its delta scale."""
    return obj.scale * obj.delta_scale


def _placed_rotation(obj: bpy.types.Object) -> Matrix:
    """Return the (3, 3) rotation of `obj` relative to its parent, including the user's delta rotation."""
    return own_pose(obj).rotation @ own_rotation(obj)


def own_rotation(obj: bpy.types.Object) -> Matrix:
    """Return the (3, 3) rotation of `obj` relative to its parent, without its delta rotation."""
    mode = own_mode(obj)
    return matrix_of(mode, getattr(obj, ROTATIONS.get(mode, "rotation_euler")))


def _root(owner: bpy.types.ID) -> bpy.types.ID | None:
    """Return the data-block at the top of the hierarchy that was overridden together with `owner`."""
    return None if owner.override_library is None else owner.override_library.hierarchy_root


def _reference(owner: bpy.types.ID) -> bpy.types.ID | None:
    """Return the linked data-block that `owner` overrides."""
    return None if owner.override_library is None else owner.override_library.reference


def _parent_bone(obj: bpy.types.Object) -> bpy.types.Bone | None:
    parent = obj.parent
    if obj.parent_type == "BONE" and parent is not None and parent.type == "ARMATURE":
        return rest_bones(parent).get(obj.parent_bone)
    return None


def _rigid(head: bpy.types.Object, kinds: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return `kinds` with the eyes that a bone of `head` turns as parts that ride on the head."""
    _, bones = read_bones(head)
    turned = [kind for kind, key in _EYE_BONES.items() if getattr(bones, key)]
    return np.where(np.isin(kinds, turned), np.int8(Part.ON_HEAD), kinds)


def _stacked(faces: list[NDArray[np.int32]]) -> NDArray[np.int32]:
    width = max(part.shape[1] for part in faces)
    return np.concatenate([np.pad(part, ((0, 0), (0, width - part.shape[1])), constant_values=-1) for part in faces])

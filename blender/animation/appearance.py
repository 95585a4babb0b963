"""Appearance of a head, for viewers outside Blender: its faces, colours and images, and its parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.heads.appearance import Appearance, AttachedPart, Material, Patch
from ..characters import members_of, objects_of, rest_matrix
from ..frames import from_blender, to_blender
from ..meshes import keys_of, mesh_of, read_faces, read_uv, read_vertices
from ..names import PART_PROPERTY, TONGUE_KEY
from ..surfaces import image_file, linked_image, principled
from .bake import EYE_PARTS, JAW_PARTS, has_tongue

_SIGNATURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF")
"""First bytes of the images that a browser shows: PNG, JPEG and WebP."""
_NEUTRAL = Material((0.8, 0.8, 0.8), 0.5)


def read_appearance(head: bpy.types.Object) -> Appearance:
    """Read the appearance of a head at rest; raises HeadError if one of its meshes is in Edit Mode."""
    surfaces: dict[bpy.types.Material | None, Material] = {}
    patches: list[Patch] = []
    members = members_of(head)
    for member in members:
        patches += _patches(member.obj, surfaces, member.part.start)
    moved = {member.obj for member in members}
    others = objects_of(head)
    children = [child for child in head.children if PART_PROPERTY in child and child.type == "MESH"]
    still = [obj for obj in dict.fromkeys([*others, *children]) if obj not in moved]
    parts = [_attached(head, obj, surfaces) for obj in still]
    return Appearance(head.name, tuple(patches), tuple(parts))


def _attached(
    head: bpy.types.Object, obj: bpy.types.Object, surfaces: dict[bpy.types.Material | None, Material]
) -> AttachedPart:
    kind = str(obj.get(PART_PROPERTY, ""))
    follows = "jaw" if kind in JAW_PARTS else kind if kind in EYE_PARTS else "head"
    to_head = rest_matrix(head).inverted_safe() @ rest_matrix(obj)
    vertices = read_vertices(mesh_of(obj))
    out = None
    if has_tongue(obj):
        flat = np.empty(3 * len(vertices), dtype=np.float32)
        keys_of(obj).key_blocks[TONGUE_KEY].points.foreach_get("co", flat)
        put_out = from_blender(flat.reshape(-1, 3))
        out = (_placed(to_head, put_out) - _placed(to_head, vertices)).astype(np.float32)
    return AttachedPart(
        follows,
        _placed(to_head, vertices),
        from_blender(np.array(to_head.translation)).astype(np.float32),
        tuple(_patches(obj, surfaces, 0)),
        out,
    )


def _placed(matrix: Matrix, points: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Transform (N, 3) points of the head frame by a matrix in Blender's axes."""
    move = np.array(matrix)
    return from_blender(to_blender(points) @ move[:3, :3].T + move[:3, 3]).astype(np.float32)


def _patches(obj: bpy.types.Object, surfaces: dict[bpy.types.Material | None, Material], first: int) -> Iterator[Patch]:
    """Yield the faces of a mesh by material; vertices are counted from `first`."""
    mesh = mesh_of(obj)
    faces = read_faces(mesh)
    numbers = np.empty(len(faces), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", numbers)
    uv = read_uv(mesh, faces)
    slots = [slot.material for slot in obj.material_slots] or [None]
    for number, material in enumerate(slots):
        own = np.minimum(numbers, len(slots) - 1) == number
        if own.any():
            surface = surfaces.setdefault(material, _surface(material))
            shifted = np.where(faces[own] >= 0, faces[own] + first, -1)
            yield Patch(surface, shifted, None if uv is None else uv[own])


def _surface(material: bpy.types.Material | None) -> Material:
    """Return the colour and image of a material, as its Principled BSDF or the viewport shows them."""
    if material is None:
        return _NEUTRAL
    image, alpha = b"", False
    if (shader := principled(material)) is not None:
        colour = shader.inputs["Base Color"]
        image, alpha = _encoded(linked_image(colour)), shader.inputs["Alpha"].is_linked
        if not image and not colour.is_linked:
            return Material(_rgb(colour.default_value[:]), float(shader.inputs["Roughness"].default_value))
    return Material(_rgb(material.diffuse_color[:]), float(material.roughness), image, alpha)


def _rgb(colour: Sequence[float]) -> tuple[float, float, float]:
    red, green, blue, *_ = colour
    return red, green, blue


def _encoded(node: bpy.types.ShaderNodeTexImage | None) -> bytes:
    """Return the file of an image that a browser can show; empty otherwise, such as for a generated one."""
    data = b"" if node is None or node.image is None else image_file(node.image)
    return data if data.startswith(_SIGNATURES) else b""

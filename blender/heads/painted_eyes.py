"""Eyes that turn in place of those painted on a head's skin, and skin around them in a copy of its texture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from ...core.errors import HeadError
from ...core.heads.appearance import Material, Patch
from ...core.heads.eyeballs import EYES, EyeOutline, eye_outline
from ...core.heads.painted_eyes import PaintedEye, skin_around_eyes
from ...core.numeric.arrays import IntArray
from ..meshes import driven_by_keys, mesh_of, object_of, read_faces, read_landmarks, read_uv, read_vertices
from ..surfaces import colour_node, image_file
from .binding import bind_head
from .eyeballs import put_eyeballs
from .openings import open_eyes

_QUALITY = 92


def replace_eyes(obj: bpy.types.Object | None) -> int:
    """Cut the lids of a head free of its painted eyes, and put eyeballs that turn behind them.

    Returns the number of eyes; raises HeadError as `open_eyes` does.
    """
    head = object_of(obj)
    painted = _painted(head, read_landmarks(head))
    count = open_eyes(head)
    put_eyeballs(head)
    for node, image in painted:
        node.image = image
    return count


def has_painted_skin(obj: bpy.types.Object | None) -> bool:
    """Return whether an image gives a mesh its colour."""
    materials = () if obj is None else (slot.material for slot in obj.material_slots)
    return any(material is not None and colour_node(material) is not None for material in materials)


def paint_skin_around_eyes(head: bpy.types.Object) -> None:
    """Replace what the textures of a head show around its painted eyes by skin, in packed copies of their images.

    The landmarks of a head that keys drive are found for that, and are not kept; without them nothing is replaced.
    """
    with suppress(HeadError):
        for node, image in _painted(head, _landmarks_found(head) if driven_by_keys(head) else read_landmarks(head)):
            node.image = image


def _painted(head: bpy.types.Object, landmarks: IntArray) -> list[tuple[bpy.types.ShaderNodeTexImage, bpy.types.Image]]:
    """Return the image nodes of a head whose images show its eyes, with the image that each gets."""
    vertices = read_vertices(mesh_of(head)).astype(np.float64)
    outlines = []
    for eye in EYES:
        with suppress(HeadError):  # without distinct corners there is no eye
            outlines.append(eye_outline(vertices, landmarks, eye))
    painted: dict[bpy.types.Image, bpy.types.Image | None] = {}
    found = []
    for node, eyes in _textured(head, outlines):
        assert node.image is not None, "colour_node returns nodes with an image"
        if node.image not in painted:
            painted[node.image] = _with_skin(node.image, eyes)
        if (image := painted[node.image]) is not None:
            found.append((node, image))
    return found


def _landmarks_found(obj: bpy.types.Object) -> IntArray:
    """Find the vertices (66,) of the landmarks of a mesh without binding it."""
    copy = obj.copy()
    copy.data = mesh_of(obj).copy()
    bpy.context.scene.collection.objects.link(copy)
    try:
        bind_head(copy)
        return read_landmarks(copy)
    finally:
        bpy.data.meshes.remove(mesh_of(copy))


def _textured(
    head: bpy.types.Object, outlines: list[EyeOutline]
) -> Iterator[tuple[bpy.types.ShaderNodeTexImage, list[PaintedEye]]]:
    """Yield the image nodes of a head's materials with the surface that each gives its colour."""
    mesh = mesh_of(head)
    faces, vertices = read_faces(mesh), read_vertices(mesh).astype(np.float64)
    if (uv := read_uv(mesh, faces)) is None:
        return
    numbers = np.empty(len(faces), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", numbers)
    slots = head.material_slots
    for number, slot in enumerate(slots):
        material = slot.material
        node = None if material is None or material.library is not None else colour_node(material)
        own = np.minimum(numbers, len(slots) - 1) == number
        if node is not None and own.any():
            corners, places = Patch(Material(), faces[own], uv[own]).triangles()
            surface = vertices[corners].reshape(-1, 3, 3), places.reshape(-1, 3, 2)
            yield node, [PaintedEye(outline, *surface) for outline in outlines]


def _with_skin(image: bpy.types.Image, eyes: list[PaintedEye]) -> bpy.types.Image | None:
    """Return a packed copy of an image with skin around the eyes; None if it shows none, or has not 8 bits."""
    data = np.frombuffer(image_file(image), dtype=np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if pixels is None or pixels.dtype != np.uint8 or pixels.ndim != 3:
        return None
    colour = np.ascontiguousarray(pixels[..., :3])
    skin = skin_around_eyes(colour, eyes)
    if np.array_equal(skin, colour):
        return None
    file = _encoded(np.concatenate([skin, pixels[..., 3:]], axis=-1))
    copy = bpy.data.images.new(f"{image.name} Skin", *image.size[:])
    copy.pack(data=file, data_len=len(file))
    copy.source = "FILE"
    if (of := copy.colorspace_settings) is not None and (space := image.colorspace_settings) is not None:
        of.name = space.name
    copy.alpha_mode = image.alpha_mode
    return copy


def _encoded(pixels: NDArray[np.uint8]) -> bytes:
    """Return an image as a file: JPEG, or PNG if it has an alpha."""
    if pixels.shape[2] == 3:
        return bytes(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
    return bytes(cv2.imencode(".png", pixels)[1])

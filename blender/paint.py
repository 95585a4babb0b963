"""The colours of a mesh for portraits: its images, its colour attribute, or the plain colours of its materials."""

from __future__ import annotations

from typing import cast

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.heads.portrait import Paint
from .meshes import mesh_of, read_faces, read_uv
from .surfaces import colour_node, principled

_SIDE = 768
"""Largest side of an image in pixels, about that of a face in a portrait times three: heads fill a third of theirs."""
_LEVELS = 256
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
"""Share of red, green and blue in the brightness (ITU-R BT.709)."""
_PLAIN = 0.8
"""Brightness of a face without a material."""


def read_paint(obj: bpy.types.Object) -> Paint | None:
    """Return the colours of a mesh, or None if it has neither images nor a colour attribute."""
    mesh = mesh_of(obj)
    faces = read_faces(mesh)
    numbers = np.empty(len(faces), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", numbers)
    slots = [slot.material for slot in obj.material_slots] or [None]
    numbers = np.minimum(numbers, len(slots) - 1)
    # The first row is a ramp from black to white, of which faces without an image show one place.
    tiles, uv = [np.arange(_LEVELS, dtype=np.uint8)[None]], np.zeros((*faces.shape, 2), dtype=np.float32)
    coordinates, colours = read_uv(mesh, faces), _colours(mesh, faces)
    found, top = colours is not None, 1
    for number, material in enumerate(slots):
        own = numbers == number
        if not own.any():
            continue
        node = None if material is None else colour_node(material)
        grey = None if node is None else _grey(node.image)
        if grey is None or coordinates is None:
            level = colours[own] if colours is not None else np.float32(_brightness(material))
            uv[own, :, 0] = (_LEVELS - 1) * level
            continue
        found = True
        height, width = grey.shape
        placed = coordinates[own]
        placed = placed - np.floor(placed.mean(axis=1, keepdims=True))  # tiled images repeat
        uv[own] = placed * (width - 1.0, 1.0 - height) + (0.0, top + height - 1.0)
        tiles.append(grey)
        top += height
    if not found:
        return None
    image = np.zeros((top, max(tile.shape[1] for tile in tiles)), dtype=np.uint8)
    top = 0
    for tile in tiles:
        image[top : top + len(tile), : tile.shape[1]] = tile
        top += len(tile)
    return Paint(image, uv)


def _grey(image: bpy.types.Image | None) -> NDArray[np.uint8] | None:
    """Return an image in grey, (H, W), of at most `_SIDE` pixels a side; None if its file is missing."""
    if image is None or (not image.has_data and not min(image.size)):
        return None
    small = image.copy()
    try:
        width, height = small.size
        factor = min(1.0, _SIDE / max(width, height))
        if factor < 1.0:
            small.scale(max(1, round(factor * width)), max(1, round(factor * height)))
        width, height = small.size
        values = np.empty(width * height * small.channels, dtype=np.float32)
        cast("bpy.types.bpy_prop_array[float]", small.pixels).foreach_get(values)
    finally:
        bpy.data.images.remove(small)
    rows = values.reshape(height, width, -1)[::-1]
    grey = rows[..., :3] @ _LUMINANCE if rows.shape[2] >= 3 else rows[..., 0]
    return np.asarray(np.clip(255.0 * grey, 0.0, 255.0), dtype=np.uint8)


def _colours(mesh: bpy.types.Mesh, faces: NDArray[np.int32]) -> NDArray[np.float32] | None:
    """Brightness (F, K) of the corners in the active colour attribute, 0 to 1, or None."""
    attribute = mesh.color_attributes.active_color
    if attribute is None or attribute.domain not in {"POINT", "CORNER"} or not len(attribute.data):
        return None
    flat = np.empty(4 * len(attribute.data), dtype=np.float32)
    attribute.data.foreach_get("color_srgb", flat)
    values = np.clip(flat.reshape(-1, 4)[:, :3] @ _LUMINANCE, 0.0, 1.0)
    if attribute.domain == "POINT":
        return np.where(faces >= 0, values[faces], np.float32(0.0))
    out = np.zeros(faces.shape, dtype=np.float32)
    out[faces >= 0] = values
    return out


def _brightness(material: bpy.types.Material | None) -> float:
    """Brightness of the plain colour of a material, encoded as in an image."""
    if material is None:
        return _PLAIN
    shader = principled(material)
    colour = material.diffuse_color if shader is None else shader.inputs["Base Color"].default_value
    linear = np.clip(np.array(colour[:3]) @ _LUMINANCE, 0.0, 1.0)
    return float(linear ** (1.0 / 2.2))

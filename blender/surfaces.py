"""Materials as they look: the image that gives a surface its colour."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import bpy

from ..core.files.reading import read_bytes
from .stubs import AlphaMode

_MAX_FILE = 32_000_000
"""Size of an image in bytes above which it is not read."""
_MAX_BETWEEN = 2
"""Number of nodes of colour correction that may lie between an image and the shader."""


def principled(material: bpy.types.Material | None) -> bpy.types.Node | None:
    """Return the first Principled BSDF of a material, or None."""
    tree = None if material is None else material.node_tree
    return next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None) if tree is not None else None


def linked_image(socket: bpy.types.NodeSocket) -> bpy.types.ShaderNodeTexImage | None:
    """Return the image node that a colour socket shows, also through some colour correction; None if there is none."""
    for _ in range(1 + _MAX_BETWEEN):
        if not socket.is_linked:
            return None
        node = socket.links[0].from_node
        if isinstance(node, bpy.types.ShaderNodeTexImage):
            return node
        assert node is not None
        socket = next((one for one in node.inputs if one.type == "RGBA"), socket)
    return None


def image_file(image: bpy.types.Image) -> bytes:
    """Return the file of an image, packed or not; empty if it is generated, too large, or cannot be read."""
    if image.source != "FILE":
        return b""
    if image.packed_file is not None:
        data = bytes(image.packed_file.data)
        return data if len(data) <= _MAX_FILE else b""
    try:
        return read_bytes(Path(bpy.path.abspath(image.filepath, library=image.library)), _MAX_FILE)
    except (OSError, ValueError):  # without its file, only the colour is shown, as in Blender's viewport
        return b""


def show_colour_images() -> None:
    """Let viewports that show textures display the image of the colour of each material of the file."""
    _show_images(bpy.data.materials)


class ShownColours:
    """The colours of some meshes as viewports show them in Solid shading, until `revert`.

    `kind` is how Solid shading has to colour objects, "TEXTURE" or "VERTEX"; "" if they have neither images nor
    colours.
    """

    def __init__(self, meshes: Iterable[bpy.types.Mesh]) -> None:
        meshes = list(meshes)
        materials = dict.fromkeys(material for mesh in meshes for material in mesh.materials if material is not None)
        self._before = _show_images(materials)
        textured = any(colour_node(material) is not None for material in materials)
        coloured = any(len(mesh.color_attributes) for mesh in meshes)
        self.kind: Literal["TEXTURE", "VERTEX", ""] = "TEXTURE" if textured else "VERTEX" if coloured else ""

    def revert(self) -> None:
        """Restore the active nodes of the materials, and the alpha of their images."""
        for name, node, image, alpha in self._before:
            material, picture = bpy.data.materials.get(name), bpy.data.images.get(image)
            nodes = None if material is None or material.node_tree is None else material.node_tree.nodes
            if nodes is not None and (found := nodes.get(node)) is not None:
                nodes.active = found
            if picture is not None:
                picture.alpha_mode = alpha
        self._before = []


def _show_images(materials: Iterable[bpy.types.Material]) -> list[tuple[str, str, str, AlphaMode]]:
    """Make the image of its colour the active one of each material; after an import that may be an image of normals.

    Returns the names of each material that was changed, its active node and its image, and the alpha of the image.
    """
    before: list[tuple[str, str, str, AlphaMode]] = []
    for material in materials:
        node = colour_node(material)
        if node is None or material.library is not None:
            continue
        nodes, image = material.node_tree.nodes, node.image
        active = nodes.active.name if nodes.active is not None else ""
        before.append((material.name, active, image.name, image.alpha_mode))
        nodes.active = node
        if node.outputs["Alpha"].is_linked:
            image.alpha_mode = "STRAIGHT"  # glTF's importer packs channels, whose alpha Workbench ignores
    return before


def colour_node(material: bpy.types.Material) -> bpy.types.ShaderNodeTexImage | None:
    """Return the node with the image of the colour of a material: that of its Principled BSDF, or the first that leads
    to the output of another shader, as in unlit materials of avatars; None without one.
    """
    shader = principled(material)
    node = None if shader is None else linked_image(shader.inputs["Base Color"])
    if node is None and material.node_tree is not None:
        nodes = material.node_tree.nodes
        outputs = [one for one in nodes if isinstance(one, bpy.types.ShaderNodeOutputMaterial)]
        waiting: list[bpy.types.Node] = [one for one in outputs if one.is_active_output]
        for one in waiting:
            if isinstance(one, bpy.types.ShaderNodeTexImage) and _shows_colour(one):
                return one
            behind = (link.from_node for socket in one.inputs for link in socket.links)
            waiting += [other for other in behind if other is not None and other not in waiting]
    return None if node is None or node.image is None else node


def lost_images(objects: Iterable[bpy.types.Object]) -> list[str]:
    """Return the names of files with colours of objects that cannot be read, in whose place Blender shows magenta."""
    materials = [slot.material for obj in objects for slot in obj.material_slots if slot.material is not None]
    images = [node.image for node in map(colour_node, materials) if node is not None and node.image is not None]
    lost = [image for image in images if _is_lost(image)]
    return sorted({Path(image.filepath).name or image.name for image in lost})


def _shows_colour(node: bpy.types.ShaderNodeTexImage) -> bool:
    """Return whether a node has an image of colours rather than of normals or other data."""
    space = None if node.image is None else node.image.colorspace_settings
    return space is not None and not space.is_data


def _is_lost(image: bpy.types.Image) -> bool:
    if image.source != "FILE" or image.packed_file is not None or image.has_data:
        return False
    return not os.path.isfile(bpy.path.abspath(image.filepath, library=image.library))

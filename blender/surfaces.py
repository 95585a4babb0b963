"""Materials as they look: the image that gives a surface its colour."""

from __future__ import annotations

import bpy

_MAX_BETWEEN = 2
"""Number of nodes of colour correction that may lie between an image and the shader."""


def principled(material: bpy.types.Material | None) -> bpy.types.ShaderNode | None:
    """Return the first Principled BSDF of a material, or None."""
    tree = None if material is None else material.node_tree
    return next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None) if tree is not None else None


def linked_image(socket: bpy.types.NodeSocket) -> bpy.types.ShaderNodeTexImage | None:
    """Return the image node that a colour socket shows, also through some colour correction; None if there is none."""
    for _ in range(1 + _MAX_BETWEEN):
        if not socket.is_linked:
            return None
        node = socket.links[0].from_node
        if node.type == "TEX_IMAGE":
            return node
        socket = next((one for one in node.inputs if one.type == "RGBA"), socket)
    return None


def show_colour_images() -> None:
    """Let viewports that show textures display the image of the colour of each material.

    They display the active image node, which after an import may be that of the normals or the emission.
    """
    for material in bpy.data.materials:
        if (shader := principled(material)) is None or material.library is not None:
            continue
        if (node := linked_image(shader.inputs["Base Color"])) is not None:
            material.node_tree.nodes.active = node
            if node.image is not None and shader.inputs["Alpha"].is_linked:
                node.image.alpha_mode = "STRAIGHT"  # glTF's importer packs channels, whose alpha Workbench ignores

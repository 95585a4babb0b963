"""Materials of the built-in head for Workbench, Eevee and Cycles.

Workbench shows only the active image texture, so that colour comes from the images in `assets/head`; the shaders add
subsurface scattering, pores and the gloss of the eyes.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ...core.errors import ModelError
from ...core.files.assets import ASSETS
from ...core.heads.built_in import MOUTH_COLOUR, MOUTH_ROUGHNESS
from ..names import UV_MAP

_TEXTURES = ASSETS / "head"

_SATURATION = 1.25
"""Factor of the saturation of skin and hair in Material Preview and renders."""
_BRIGHTNESS = 0.8
"""Factor of the brightness of skin and hair in Material Preview and renders."""

_WITH_ALPHA = {32, 64, 128}
"""Bits of a pixel of images with an alpha."""
_MOUTH = "Facemime Mouth"

Build = Callable[[bpy.types.NodeTree, bpy.types.Node], None]


def head_materials(*, woman: bool = False) -> dict[str, bpy.types.Material]:
    """Create the materials of "skin" and of the parts, by name."""
    own = "_woman" if woman else ""
    eye = eye_material(own)
    hair = _material("Facemime Hair", f"hair{own}.jpg", (0.05, 0.03, 0.02), 0.70, _strands)
    teeth = _material("Facemime Teeth", "teeth.jpg", (0.80, 0.76, 0.66), 0.18, _enamel)
    return {
        "skin": _material("Facemime Skin", f"skin{own}.jpg", (0.69, 0.45, 0.35), 0.46, _skin),
        "eye_left": eye,
        "eye_right": eye,
        "teeth_upper": teeth,
        "teeth_lower": teeth,
        "tongue": _material("Facemime Tongue", "tongue.jpg", (0.55, 0.20, 0.20), 0.30, _wet),
        "lashes": hair,
        "hair": hair,
    }


def eye_material(own: str = "") -> bpy.types.Material:
    """Create the material of an eyeball; `own` is what the names of a head's own images end with."""
    return _material("Facemime Eye", f"eye{own}.jpg", (0.85, 0.83, 0.80), 0.06, _wet)


def plain_material(name: str, colour: tuple[float, float, float], roughness: float) -> bpy.types.Material:
    """Create a Principled material of one linear RGB colour, also for viewports that do not use nodes."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    material.diffuse_color = (*colour, 1.0)
    material.roughness = roughness
    material.specular_intensity = 0.5 if roughness < 0.4 else 0.15
    shader = _shader(material)
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return material


def mouth_material() -> bpy.types.Material:
    """Return the dark material of the inside of a mouth, which all heads share."""
    return bpy.data.materials.get(_MOUTH) or plain_material(_MOUTH, MOUTH_COLOUR, MOUTH_ROUGHNESS)


def _tree(material: bpy.types.Material) -> bpy.types.ShaderNodeTree:
    assert material.node_tree is not None, "plain_material makes it"
    return material.node_tree


def _shader(material: bpy.types.Material) -> bpy.types.Node:
    return next(node for node in _tree(material).nodes if node.type == "BSDF_PRINCIPLED")


def _image_node(tree: bpy.types.ShaderNodeTree, image: bpy.types.Image) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeTexImage")
    assert isinstance(node, bpy.types.ShaderNodeTexImage)
    node.image = image
    return node


def _mapped(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeUVMap")
    assert isinstance(node, bpy.types.ShaderNodeUVMap)
    node.uv_map = UV_MAP
    return node


def _material(
    name: str, picture: str, colour: tuple[float, float, float], roughness: float, finish: Build
) -> bpy.types.Material:
    """Create a Principled material with an image; `colour` and `roughness` are for viewports without textures."""
    material = plain_material(name, colour, roughness)
    show_image(material, _image(picture))
    finish(_tree(material), _shader(material))
    return material


def show_image(material: bpy.types.Material, image: bpy.types.Image) -> None:
    """Give a material of `plain_material` the colour, and the alpha if it has one, of an image; viewports show it."""
    tree, shader = _tree(material), _shader(material)
    texture, coordinates = _image_node(tree, image), _mapped(tree)
    texture.location, coordinates.location = (-600.0, 300.0), (-850.0, 300.0)
    tree.links.new(coordinates.outputs["UV"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    if image.depth in _WITH_ALPHA:
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    for node in tree.nodes:
        node.select = False
    texture.select = True
    tree.nodes.active = texture


def _image(picture: str) -> bpy.types.Image:
    """Load an image, packed so that a saved file does not need the extension."""
    path = _TEXTURES / picture
    if not path.is_file():
        raise ModelError("The texture {path} is missing. Reinstall Facemime.", path=path)
    name = f"Facemime {path.stem.title()}"
    image = bpy.data.images.get(name)
    if image is None or tuple(image.size) == (0, 0):
        image = bpy.data.images.load(str(path))
        image.name = name
        image.pack()
    return image


def _skin(tree: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    """Add subsurface scattering, varying gloss, and pores."""
    shader.inputs["Subsurface Weight"].default_value = 0.12
    shader.inputs["Subsurface Radius"].default_value = (1.0, 0.35, 0.18)
    shader.inputs["Subsurface Scale"].default_value = 0.004
    shader.inputs["Specular IOR Level"].default_value = 0.35
    _saturate(tree, shader)
    patches = _noise(tree, 90.0, (-850.0, -50.0))
    gloss = tree.nodes.new("ShaderNodeMapRange")
    gloss.location = (-600.0, -50.0)
    gloss.inputs["To Min"].default_value, gloss.inputs["To Max"].default_value = 0.36, 0.58
    tree.links.new(patches.outputs[0], gloss.inputs["Value"])
    tree.links.new(gloss.outputs[0], shader.inputs["Roughness"])
    _bump(tree, shader, 1400.0, 0.10, 0.0004)


def _saturate(tree: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    """Deepen the colours of the image, which are made for viewports and would look pale in daylight under AgX."""
    colour = shader.inputs["Base Color"]
    node = tree.nodes.new("ShaderNodeHueSaturation")
    node.location = (-250.0, 300.0)
    node.inputs["Saturation"].default_value, node.inputs["Value"].default_value = _SATURATION, _BRIGHTNESS
    source = colour.links[0].from_socket
    assert source is not None, "the colour has an image"
    tree.links.new(source, node.inputs["Color"])
    tree.links.new(node.outputs[0], colour)


def _wet(_: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    shader.inputs["Coat Weight"].default_value = 0.6
    shader.inputs["Coat Roughness"].default_value = 0.03


def _strands(_: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    shader.inputs["Specular IOR Level"].default_value = 0.25


def _enamel(_: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    shader.inputs["Subsurface Weight"].default_value = 0.08
    shader.inputs["Subsurface Scale"].default_value = 0.002


def _noise(tree: bpy.types.NodeTree, scale: float, place: tuple[float, float]) -> bpy.types.Node:
    """Add noise that moves with the skin, as it uses the texture coordinates."""
    node = tree.nodes.new("ShaderNodeTexNoise")
    node.location = place
    node.inputs["Scale"].default_value = scale
    coordinates = next(other for other in tree.nodes if other.type == "UVMAP")
    tree.links.new(coordinates.outputs["UV"], node.inputs["Vector"])
    return node


def _bump(tree: bpy.types.NodeTree, shader: bpy.types.Node, scale: float, strength: float, distance: float) -> None:
    pores = _noise(tree, scale, (-850.0, -350.0))
    bump = tree.nodes.new("ShaderNodeBump")
    bump.location = (-300.0, -350.0)
    bump.inputs["Strength"].default_value = strength
    bump.inputs["Distance"].default_value = distance
    tree.links.new(pores.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])

"""The head's materials: painted textures for Workbench, and with them skin, eyes and teeth for Eevee and Cycles.

Workbench shows nothing but the active image texture, so that the look is in the pictures of `assets/head`; the shader
adds what pictures cannot: light under the skin, pores, the gloss of eyes.
"""

from __future__ import annotations

from pathlib import Path

import bpy

ASSETS = Path(__file__).parents[1] / "assets" / "head"

_SKIN_COLOUR = (0.62, 0.40, 0.30)


def head_materials() -> dict[str, bpy.types.Material]:
    """Materials by use: "skin" and the names of the parts. Each use of the head makes its own."""
    eye = _material("Facemime Eye", (0.85, 0.83, 0.80))
    teeth = _material("Facemime Teeth", (0.80, 0.76, 0.66))
    return {
        "skin": _material("Facemime Skin", _SKIN_COLOUR),
        "eye_left": eye,
        "eye_right": eye,
        "teeth_upper": teeth,
        "teeth_lower": teeth,
        "tongue": _material("Facemime Tongue", (0.55, 0.20, 0.20)),
    }


def _material(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.diffuse_color = (*colour, 1.0)
    return material

"""Pictures of the sets of shape keys made for the built-in head: `python -m lab.bench.key_pictures`.

They are written to `keys_vrm.jpg`, `keys_oculus.jpg` and `keys_facegen.jpg` in `docs/images`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.blender.heads.expression_keys import make_expression_keys
from facemime.blender.heads.new_heads import add_head
from facemime.blender.preview_scene import setup_preview
from facemime.blender.rendering import render_frames
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.tracking.overlay import draw_label

ROOT = Path(__file__).resolve().parents[2]
SETS = {"vrm": 6, "oculus": 5, "facegen": 8}
"""Sets that are drawn, and their numbers of columns."""
SIDE, QUALITY = 250, 85
_FACE = slice(50, 215), slice(48, 203)
"""Rows and columns of an image of a head that show its face."""

Image = NDArray[np.uint8]


def main() -> int:
    """Write a picture of each set; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "images", metavar="DIR")
    folder = parser.parse_args().output
    for name, columns in SETS.items():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        head = add_head(bpy.context)
        made = make_expression_keys(head, KEY_SETS[name])
        print(made.summary(), *made.findings, sep="\n")
        setup_preview(bpy.context.scene, head, (SIDE, SIDE))
        sheet = grid(pictures(head, KEY_SETS[name].names), columns)
        cv2.imwrite(str(folder / f"keys_{name}.jpg"), sheet, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return 0


def pictures(head: bpy.types.Object, names: tuple[str, ...]) -> list[Image]:
    """Render each key at 1, on the head and its parts."""
    meshes = [obj.data for obj in (head, *head.children) if obj.type == "MESH" and obj.data.shape_keys is not None]
    for mesh in meshes:
        for frame, name in enumerate(names):
            if (key := mesh.shape_keys.key_blocks.get(name)) is None:
                continue
            for at, value in ((frame - 1, 0.0), (frame, 1.0), (frame + 1, 0.0)):
                key.value = value
                key.keyframe_insert("value", frame=at)
    shown = render_frames(bpy.context.scene, range(len(names)), (SIDE, SIDE))
    return [draw_label(picture[_FACE], name) for picture, name in zip(shown, names, strict=True)]


def grid(tiles: list[Image], columns: int) -> Image:
    """Arrange tiles in rows."""
    blank = [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [*tiles, *blank]
    return np.vstack([np.hstack(rows[i : i + columns]) for i in range(0, len(rows), columns)])


if __name__ == "__main__":
    sys.exit(main())

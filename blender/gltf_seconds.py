"""Seconds in glTF files that Blender's add-on reads and writes, where the frame rate of the scene has a base.

The add-on multiplies the rate by its base instead of dividing by it, up to Blender 5.2 at least: 29.97 frames per
second count as 30.03.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import bpy

from .view_layers import set_for_now


@contextmanager
def inverted_base(scene: bpy.types.Scene) -> Iterator[None]:
    """Invert the base of the frame rate of `scene`, so that multiplying by it is right."""
    with ExitStack() as stack:
        set_for_now(stack, scene.render, "fps_base", 1.0 / scene.render.fps_base)
        yield


def base_is_right(scene: bpy.types.Scene, frames: float, seconds: float | None) -> bool:
    """Return whether an animation of some frames of `scene` takes as long as it should, after an inverted base.

    It does not if the add-on divides. An animation whose length is not known counts as right.
    """
    if not seconds:
        return True
    rate, base = scene.render.fps, scene.render.fps_base
    return abs(frames * base / rate - seconds) <= abs(frames / base / rate - seconds)

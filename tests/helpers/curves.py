"""Curves of animations in tests."""

import bpy


def curves_of(owner: bpy.types.ID) -> list[bpy.types.FCurve]:
    """Return the F-Curves of `owner` in any version of Blender."""
    data = owner.animation_data
    if not hasattr(data.action, "slots"):
        return list(data.action.fcurves)
    return list(data.action.layers[0].strips[0].channelbag(data.action_slot).fcurves)

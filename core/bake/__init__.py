"""Baking without Blender: shape keys and their weights, ARKit's coefficients, and caches (method.md, section 9)."""

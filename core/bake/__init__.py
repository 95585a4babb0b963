"""Baking without Blender: bases, weights of shape keys, tables, clean curves and caches (method.md, section 9)."""

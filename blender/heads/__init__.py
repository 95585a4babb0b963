"""Heads as Blender has them: built, bound, cut and painted."""

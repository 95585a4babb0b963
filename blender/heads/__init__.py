"""Heads in Blender: the built-in one, binding, cutting and painting."""
